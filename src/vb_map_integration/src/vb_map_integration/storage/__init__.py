"""Storage of borders on disk."""
