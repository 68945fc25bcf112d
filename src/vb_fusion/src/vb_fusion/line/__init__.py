"""From the stroke to the line: its straight sides, and whether it is closed."""
