"""Renders what cameras see of the simulated room: bodies, floor, laser spot."""
