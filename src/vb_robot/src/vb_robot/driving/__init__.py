"""Whether a robot may drive, and how it follows the spot and leaves a border."""
