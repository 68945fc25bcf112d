"""From a command to what the system does."""
