"""Finds laser spots in camera images and projects them to the floor."""
