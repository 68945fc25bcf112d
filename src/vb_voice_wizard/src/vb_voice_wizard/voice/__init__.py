"""Recording, endpointing and scoring of speech."""
