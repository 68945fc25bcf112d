"""What the smart display shows."""
