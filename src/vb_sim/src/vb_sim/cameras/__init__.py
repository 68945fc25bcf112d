"""What the simulated cameras see, and when."""
