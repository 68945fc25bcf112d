"""Decides whether a robot may drive, and makes it follow the spot and get off what is too near."""
