"""Answers, services and previews behind the interaction's commands."""
