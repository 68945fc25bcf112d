"""Errors with a code for programs and a sentence for people."""

from __future__ import annotations

from typing import Any, Dict

from vb_core import sentences


class CodedError(Exception):
    """An error with a machine-readable code and a sentence for a person.

    Args:
        code: lower-case words joined by underscores, stable across releases.
        message: one English sentence that says what is wrong and what to do. Needed only if vb_core/languages has no
            sentence for the code.
        values: the values that the sentence contains, in any language.
    """

    def __init__(self, code: str, message: str = "", **values: Any) -> None:
        self.code = code
        self.values: Dict[str, Any] = values
        self.message = message or sentences.translate(code, values)
        super().__init__(self.message)

    def __str__(self) -> str:
        return f"{self.message} [{self.code}]"

    def without_traceback(self) -> CodedError:
        """Returns a copy without a traceback, for a variable that outlives the handler.

        A raised error references all frames of its stack, and one of them holds the variable. Without a copy that
        reference cycle, with every image in the frames, would stay in memory until the next garbage collection.
        """
        return CodedError(self.code, self.message, **self.values)


class ParameterError(CodedError):
    """A parameter, or a key of a YAML file, that is missing, unknown or out of range."""

    def __init__(self, key: str, message: str) -> None:
        super().__init__("bad_parameter", f"{key}: {message}")
        self.key = key
        self.args = key, message  # with these, pickle calls the constructor again
