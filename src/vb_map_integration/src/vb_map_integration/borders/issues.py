"""The issues that a border's check reports, and the error that refuses it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Mapping, Tuple

from vb_core import sentences
from vb_core.errors import CodedError

WARNING = 0
ERROR = 1


@dataclass(frozen=True)
class Issue:
    """An issue that a border's check reports.

    Attributes:
        severity: WARNING (the border can still be added) or ERROR (it is refused).
        code: machine readable, for instance "no_separation".
        message: a sentence that a person can act on.
        values: those in the sentence.
    """

    severity: int
    code: str
    message: str
    values: Mapping[str, str] = field(default_factory=dict)


def make_issue(severity: int, code: str, **values: Any) -> Issue:
    """Makes an issue with the English sentence for its code."""
    words = {key: str(value) for key, value in values.items()}
    return Issue(severity, code, sentences.translate(code, words), words)


class IntegrationError(CodedError):
    """Raised when a border is refused. Nothing was changed.

    Args:
        code, values: as of `CodedError`; its sentence is the one for this code.

    Attributes:
        issues: all that was found up to the refusal; the last one is the refusal itself.
    """

    def __init__(self, code: str, **values: Any) -> None:
        super().__init__(code, **values)
        self.issues: Tuple[Issue, ...] = (make_issue(ERROR, code, **values),)
