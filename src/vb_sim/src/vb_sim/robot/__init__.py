"""The simulated robot and the replacement for its navigation stack."""
