"""What tests expect of a refusal: its code, not its words."""

from __future__ import annotations

import contextlib

import pytest

from vb_core.errors import CodedError


@contextlib.contextmanager
def refused(code):
    """Expects what is done within it to be refused with a code; the refusal is in `.value` of what it gives."""
    with pytest.raises(CodedError) as caught:
        yield caught
    assert caught.value.code == code
