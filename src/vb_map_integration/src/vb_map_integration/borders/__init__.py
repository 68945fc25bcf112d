"""What a border is, and how it is written, read, clicked and edited."""
