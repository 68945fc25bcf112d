"""Errors that a program can tell apart and a person can act on."""
from __future__ import annotations


class CodedError(Exception):
    """An error with a machine-readable code and a sentence for a person.

    Args:
        code: lower-case words joined by underscores, stable across releases.
        message: one sentence that says what is wrong and what to do.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code
        self.message = message

    def __str__(self) -> str:
        return f"{self.message} [{self.code}]"


class ParameterError(CodedError):
    """A parameter, or a key of a YAML file, that is missing, unknown or out of range."""

    def __init__(self, key: str, message: str) -> None:
        super().__init__("bad_parameter", f"{key}: {message}")
        self.key = key
