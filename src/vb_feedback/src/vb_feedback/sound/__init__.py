"""Sounds: their choice, synthesis and playback."""
