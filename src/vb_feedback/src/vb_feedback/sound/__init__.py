"""The sounds: which one, when, and how it is played."""
