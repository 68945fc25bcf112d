"""Buttons to commands."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from vb_core.errors import ParameterError
from vb_voice_wizard.buttons import ButtonMap

FIVE = {"define_border": 0, "define_seed": 1, "guide_robot": 2, "save": 3, "cancel": [4, 6]}


@settings(max_examples=50, deadline=None)
@given(st.lists(st.lists(st.integers(0, 1), min_size=8, max_size=8), max_size=40))
def test_each_rising_edge_is_one_command(readings):
    buttons = ButtonMap(FIVE, {})
    command_count = sum(len(buttons.update(reading, "border")) for reading in readings)
    changes = np.diff([[0] * 8, *readings], axis=0)[:, [0, 1, 2, 3, 4, 6]]  # of the buttons that give commands
    assert command_count == (changes > 0).sum()


def test_three_buttons_mean_what_the_state_says():
    by_state = {"default": {"guide_robot": 2}, "border": {"define_seed": 1}, "seed": {"save": 1}}
    buttons = ButtonMap({"define_border": 0, "cancel": 2}, by_state)
    commands = []
    for state, pressed in (("default", 2), ("guide", 0), ("border", 1), ("seed", 1), ("seed", 2), ("nowhere", 2)):
        commands += buttons.update([int(index == pressed) for index in range(3)], state)
        assert buttons.update([0, 0, 0], state) == []
    assert commands == ["guide_robot", "define_border", "define_seed", "save", "cancel", "guide_robot"]


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
