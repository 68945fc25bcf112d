"""Answers, borders and previews behind the interaction's commands."""
