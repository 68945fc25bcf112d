"""What a simulated room consists of, and the models' figures."""
