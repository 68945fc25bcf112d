"""The demonstration in the simulated lab, its figure, and the display's screenshots."""
