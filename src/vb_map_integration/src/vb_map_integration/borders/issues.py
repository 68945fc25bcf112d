"""The issues that a border's check reports, and the error that refuses it."""

from __future__ import annotations

from typing import Any, Tuple

from vb_core.errors import CodedError
from vb_core.notices import Notice, Severity


def warning(code: str, **values: Any) -> Notice:
    """Makes an issue with which a border can still be added."""
    return Notice.from_error(CodedError(code, **values), Severity.WARNING)


class IntegrationError(CodedError):
    """Raised when a border is refused. Nothing was changed.

    Attributes:
        warnings: what was found before.
    """

    warnings: Tuple[Notice, ...] = ()
