"""The demonstration in the simulated lab."""
