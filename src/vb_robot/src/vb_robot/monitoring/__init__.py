"""Watches what is connected to the robots: what their navigation does with borders, and what it can be asked to do."""
