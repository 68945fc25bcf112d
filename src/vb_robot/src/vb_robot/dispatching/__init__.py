"""Which robot goes where to see the spot."""
