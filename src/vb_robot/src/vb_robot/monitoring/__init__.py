"""Finds out what is connected to the robots: whether their navigation respects borders, and which requests it obeys."""
