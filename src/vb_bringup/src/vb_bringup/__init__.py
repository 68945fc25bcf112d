"""The lab as a whole: whether it is ready, and a folder of one's own for it."""
