"""Robots as they are connected: what their own navigation does with borders, and what can be asked of it."""
