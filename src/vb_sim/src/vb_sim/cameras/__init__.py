"""The simulated cameras: what they see, and when."""
