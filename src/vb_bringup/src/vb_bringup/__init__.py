"""The lab as a whole: whether it is ready, and a separate folder for it."""
