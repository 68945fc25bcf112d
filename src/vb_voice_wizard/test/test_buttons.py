"""Buttons to commands."""

import pytest
from hypothesis import given, settings, strategies as st

from vb_core.errors import ParameterError
from vb_voice_wizard.buttons import ButtonMap

FIVE = {"define_border": 0, "define_seed": 1, "guide_robot": 2, "save": 3, "cancel": [4, 6]}


@settings(max_examples=50, deadline=None)
@given(st.lists(st.lists(st.integers(0, 1), min_size=8, max_size=8), max_size=40))
def test_each_rising_edge_is_one_command(readings):
    buttons = ButtonMap(FIVE, {})
    before = [0] * 8
    given_commands = edges = 0
    for reading in readings:
        given_commands += len(buttons.update(reading, "border"))
        edges += sum(now > then for index, (now, then) in enumerate(zip(reading, before)) if index not in (5, 7))
        before = reading
    assert given_commands == edges


def test_three_buttons_mean_what_the_state_says():
    by_state = {"default": {"guide_robot": 2}, "border": {"define_seed": 1}, "seed": {"save": 1}}
    buttons = ButtonMap({"define_border": 0, "cancel": 2}, by_state)
    given_commands = []
    for state, press in (("default", 2), ("guide", 0), ("border", 1), ("seed", 1), ("seed", 2), ("nowhere", 2)):
        given_commands += buttons.update([int(index == press) for index in range(3)], state)
        assert buttons.update([0, 0, 0], state) == []
    assert given_commands == ["guide_robot", "define_border", "define_seed", "save", "cancel", "guide_robot"]


@pytest.mark.parametrize(
    "mapping, by_state, key",
    [
        ({"dance": 0}, {}, "mapping/dance"),
        ({"save": -1}, {}, "mapping/save"),
        ({"save": "x"}, {}, "mapping/save"),
        ({"save": True}, {}, "mapping/save"),
        ({"save": 1, "cancel": [0, 1]}, {}, "mapping/cancel"),
        (FIVE, {"flying": {"save": 1}}, "by_state/flying"),
        (FIVE, {"seed": 3}, "by_state/seed"),
        (FIVE, {"seed": {"save": [1.5]}}, "by_state/seed/save"),
    ],
)
def test_bad_mappings_name_the_key(mapping, by_state, key):
    with pytest.raises(ParameterError) as caught:
        ButtonMap(mapping, by_state)
    assert caught.value.key == key
