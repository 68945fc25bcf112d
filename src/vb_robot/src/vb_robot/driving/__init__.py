"""Decides whether a robot may drive, makes it follow the spot, and drives it clear of what it is too near to."""
