"""The page that asks for a rectangle's corners on the floor: each refusal says what is wrong."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from vb_bringup.try_camera import CornerPage, _Floor
from vb_core.errors import CodedError

SHEET = {"corners": [[455, 340], [825, 340], [793, 223], [487, 223]], "width": 0.6, "depth": 0.6}


def answer(request, image=(720, 1280, 3)):
    written = {}
    page = object.__new__(CornerPage)
    page.picture = lambda: None if image is None else np.zeros(image, np.uint8)
    handler = SimpleNamespace(
        page=page, request=SimpleNamespace(body=json.dumps(request)), write=written.update, set_status=lambda code: None
    )
    _Floor.post(handler, "floor")
    return written


def test_a_rectangle_is_answered_with_lines_on_the_floor():
    found = answer(SHEET)
    assert "error" not in found and len(found["lines"]) > 4


@pytest.mark.parametrize(
    "changes, image",
    [
        ({"width": 20.0, "depth": 20.0}, (720, 1280, 3)),  # all visible floor would be far away
        ({"corners": [[1, 2]]}, (720, 1280, 3)),
        ({}, None),  # the camera is not open yet
    ],
)
def test_what_gives_no_floor_is_refused_with_a_sentence(changes, image):
    assert answer({**SHEET, **changes}, image) == {"error": CodedError("bad_rectangle").message}
