"""Only well-formed requests get through, whatever else a browser sends."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings

from hostile import GOOD, GOOD_DRAFT, hostile_messages
from refusals import refused
from vb_testing import assert_fields
from vb_core.errors import CodedError
from vb_web import action_parser
from vb_web.action_parser import ACTIONS

BOUNDS = (0.0, 0.0), (8.0, 5.0)


def parse_text(text, bounds=BOUNDS):
    return action_parser.check(*action_parser.parse(text), bounds)


def parse(**fields):
    return parse_text(json.dumps(fields))


@pytest.mark.parametrize("action", sorted(ACTIONS))
def test_good_requests_get_through(action):
    request = parse(do=action, id="a1", **GOOD[action])
    assert_fields(request, action=action, id="a1")
    assert set(request.values) == set(GOOD[action])


@pytest.mark.parametrize("action", sorted(ACTIONS))
def test_each_missing_or_additional_field_is_refused(action):
    whole = {"do": action, "id": "a1", **GOOD[action]}
    for key in whole:
        with pytest.raises(CodedError):
            parse(**{name: value for name, value in whole.items() if name != key})
    with pytest.raises(CodedError):
        parse(**whole, topic="/cmd_vel")


BAD = {  # values of a draft's fields
    "points": [[[0, 0]], [[1, 1]] * 501, [[1, 1], [99, 1]], [[1, 1], [1, "2"]], [[1, 1], [1, 2, 3]], {"0": [1, 1]}],
    "seed": [[1, None], [1, math.nan], [-math.inf, 1], [1, -1e308], 5],
    "kind": ["circle", 1],
    "zone": ["KEEP_OUT", "slow"],  # a slow zone without a speed
    "max_speed": [-0.1, "fast"],
    "name": ["x" * 61, "a\u202eb", "a\x00b", None],
    "topic": ["/x"],
}
BAD["points"] += [[[1, 1], [True, 1]], [[1, 1], [10**400, 1]]]


@pytest.mark.parametrize("field, value", [(field, value) for field, values in BAD.items() for value in values])
def test_a_draft_with_a_bad_value_is_refused(field, value):
    with refused("page_bad_request"):
        parse(do="add", id="a", draft={**GOOD_DRAFT, field: value})


def test_without_a_map_nothing_can_be_drawn():
    with refused("page_no_map"):
        parse_text(json.dumps({"do": "add", "id": "a", "draft": GOOD_DRAFT}), None)
    stop = json.dumps({"do": "command", "id": "a", "command": "stop", "seen_stop": "", "age": 0})
    assert parse_text(stop, None).values["command"] == "stop"


def test_a_message_that_is_too_long_or_too_deep_is_refused():
    long = json.dumps({"do": "rename", "id": "a", "name": "x" * 70000})
    for text in ("[" * 60000, long, "1" * 60000, b"{}", None, 5):
        with pytest.raises(CodedError):
            parse_text(text)


def test_what_gets_through_of_hostile_messages_is_harmless():
    passed = []

    @settings(max_examples=600)
    @given(hostile_messages())
    def check(text):
        try:
            request = parse_text(text)
        except CodedError:
            return
        passed.append(text)
        draft = request.values.get("draft")
        if draft is not None:
            assert np.abs(draft["points"]).max() <= 9.0
            assert math.isfinite(draft["max_speed"])
        for value in request.values.values():
            assert not isinstance(value, str) or (len(value) <= 300 and value.isprintable())

    check()
    assert passed, "they are near enough to good ones"
