"""The simulated lab: cameras, robot, participant, and a stand-in for the navigation stack."""
