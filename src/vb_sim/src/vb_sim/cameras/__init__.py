"""The simulated cameras' nodes: their calibration errors, and the timing of their images."""
