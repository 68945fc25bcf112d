"""The issues that a border's check reports, and the error that refuses a border."""

from __future__ import annotations

from typing import Any, Tuple

from vb_core.errors import CodedError
from vb_core.notices import Notice, Severity


def warning(code: str, **values: Any) -> Notice:
    """Makes a warning: a border with this issue can still be added."""
    return Notice.from_error(CodedError(code, **values), Severity.WARNING)


class IntegrationError(CodedError):
    """Raised when a border is refused. Nothing was changed.

    Attributes:
        warnings: those found before the error.
    """

    warnings: Tuple[Notice, ...] = ()
