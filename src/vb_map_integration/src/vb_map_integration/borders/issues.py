"""The issues that a border's check reports, and the error that refuses it."""
from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Dict, Iterable, Mapping, Optional, Tuple

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


class IntegrationError(CodedError):
    """A border that is refused. Nothing was changed.

    Attributes:
        issues: all that was found up to the refusal; the last one is the refusal itself.
    """

    def __init__(
        self, code: str, message: str = "", issues: Iterable[Issue] = (), values: Optional[Dict[str, Any]] = None
    ) -> None:
        super().__init__(code, message, **(values or {}))
        text = {key: str(value) for key, value in self.values.items()}
        self.issues: Tuple[Issue, ...] = tuple(issues) + (Issue(ERROR, code, self.message, text),)
