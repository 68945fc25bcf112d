"""Where borders are kept."""
