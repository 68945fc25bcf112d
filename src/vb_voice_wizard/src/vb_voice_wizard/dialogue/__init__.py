"""What stands behind the interaction's commands: previews, services, and answers to repeated commands."""
