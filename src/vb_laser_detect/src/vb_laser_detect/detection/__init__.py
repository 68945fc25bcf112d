"""From an image to spots, in the order of the stages: format, proposals, features, tracking."""
