"""Drives the robot of a running lab or simulation, and checks that its plans respect the borders."""
