"""The content of the smart display."""
