"""Sounds: their synthesis and playback."""
