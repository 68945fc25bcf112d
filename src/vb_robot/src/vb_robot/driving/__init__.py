"""Decides whether a robot may drive, makes it follow the spot, and drives it away from what is too near."""
