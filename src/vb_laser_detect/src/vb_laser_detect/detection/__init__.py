"""From an image to spots, in the order of the stages: proposals, features, tracking."""
