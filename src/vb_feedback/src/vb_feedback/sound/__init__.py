"""Sounds: which one to play when, their synthesis, and playback."""
