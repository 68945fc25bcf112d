"""Recording, endpointing, scoring and recognition of speech."""
