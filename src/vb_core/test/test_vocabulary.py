"""The tables of commands, states and zones against what must stay apart: messages, and words in each language."""

import pytest

from vb_core import sentences
from vb_core.offer import ConnectedRobot
from vb_core.sentences import spelled_out
from vb_core.vocabulary import COMMANDS, STATES, normalize, state_of
from vb_core.zones import KEEP_OUT, ZONES, zone_of
from vb_msgs.msg import VirtualBorder


def test_nothing_is_done_in_an_unknown_state():
    assert all(state_of(name) is state for name, state in STATES.items())
    unknown = state_of("of_a_newer_version")
    assert unknown not in STATES.values() and not unknown.robots_act and not unknown.collects


def test_rows_can_be_told_apart():
    for column in ("color", "tone"):
        assert len({getattr(state, column) for state in STATES.values()}) == len(STATES)
    lit = [state.led for state in STATES.values() if state.robots_act]
    assert len({*lit, "BLACK"}) == len(lit) + 1, "dark where spots are ignored"
    assert len({command.key for command in COMMANDS.values()}) == len(COMMANDS)
    assert {command.enters for command in COMMANDS.values()} - {""} <= set(STATES)
    phrases = [phrase for command in COMMANDS.values() for phrase in (spelled_out(command.name), *command.phrases)]
    assert len(set(phrases)) == len(phrases)


def test_commands_are_read_as_people_write_them():
    assert all(normalize(spelled_out(name).title()) == name for name in COMMANDS)


def test_the_message_names_the_same_zones():
    kinds = ("AUTO", "POLYGON", "SEPARATING_CURVE", "VIRTUAL_WALL")
    numbers = {name: value for name, value in vars(VirtualBorder).items() if name.isupper() and name not in kinds}
    assert numbers == {zone.name.upper(): zone.number for zone in ZONES.values()}


def test_robots_keep_out_of_an_unknown_zone():
    assert all(zone_of(zone.number) is zone for zone in ZONES.values()) and zone_of(77) is KEEP_OUT


def test_a_zone_changes_the_map_or_limits_the_speed():
    for zone in ZONES.values():
        assert (zone.value(0.6), zone.value(0.0)) == (60 * zone.restricts, 0)
        assert zone.restricts or zone.limits_speed
        # what may be crossed must not be drawn as a wall, and the rest must be
        assert (zone.occupancy < 1.0) == zone.soft
        assert not zone.kept_by(ConnectedRobot("idle"))


@pytest.mark.parametrize("language", sentences.languages())
def test_each_row_has_its_words(language):
    known = sentences.catalog(language)
    for name in STATES:
        assert known[f"state_{name}"] and known[f"page_state_{name}"]
    for name in COMMANDS:
        assert known[f"command_{name}"] and known[f"page_command_{name}"]
    assert {state.prompt for state in STATES.values()} - {""} <= set(known)
    assert all(known[f"page_zone_{name}"] and known[f"border_unkept_{name}"] for name in ZONES)
