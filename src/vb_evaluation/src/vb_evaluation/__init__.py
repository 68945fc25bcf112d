"""Experiments and their measures."""
