"""The simulated robot and its stand-in for the navigation stack."""
