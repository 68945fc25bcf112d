"""From sound to a command."""
