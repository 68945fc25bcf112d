"""Decides which robot goes where to see the spot."""
