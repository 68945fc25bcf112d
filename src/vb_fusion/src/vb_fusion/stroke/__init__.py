"""From spots to the stroke: which spots are the pointer's, in which order, and the pointer's true positions."""
