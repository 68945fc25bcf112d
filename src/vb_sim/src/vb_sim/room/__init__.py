"""What a simulated room consists of."""
