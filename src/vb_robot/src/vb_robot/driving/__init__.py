"""Decides whether a robot may drive, and makes it follow the spot and leave a border."""
