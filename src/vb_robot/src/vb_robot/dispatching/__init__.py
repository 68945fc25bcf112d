"""Decides which robot goes to which position to see the spot."""
