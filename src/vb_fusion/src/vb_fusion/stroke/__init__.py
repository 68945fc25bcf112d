"""From spots to the stroke: which are the pointer's, in which order, and where it really was."""
