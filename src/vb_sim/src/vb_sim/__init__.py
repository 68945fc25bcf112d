"""The simulated lab: cameras, robots, a participant, and a replacement for the navigation stack."""
