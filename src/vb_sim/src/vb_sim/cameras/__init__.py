"""The simulated cameras: their views, their errors, and the timing of their images."""
