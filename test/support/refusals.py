"""Tests check a refusal by its code, not by its words."""

import contextlib

import pytest

from vb_core.errors import CodedError


@contextlib.contextmanager
def refused(code):
    """Expects the code in its block to be refused with a code; it yields an object with the refusal in `.value`."""
    with pytest.raises(CodedError) as caught:
        yield caught
    assert caught.value.code == code
