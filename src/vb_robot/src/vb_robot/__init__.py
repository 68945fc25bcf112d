"""Robots that go to the spot, follow it and stay out of the borders."""
