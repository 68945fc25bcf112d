"""Which spots belong to an interaction, and the file that they are restored from."""
