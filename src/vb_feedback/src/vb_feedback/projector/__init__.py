"""What a projector shows on the floor."""
