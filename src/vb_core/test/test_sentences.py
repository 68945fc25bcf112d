"""Sentences, complete in every language; tables of commands, states and zones, whose rows must stay distinct."""

import string

import pytest

from vb_testing import assert_fields
from vb_core import sentences
from vb_core.errors import CodedError
from vb_core.capabilities import ConnectedRobot
from vb_core.interaction_tables import COMMANDS, STATES, command_name_from_text, state_by_name
from vb_core.sentences import words_of_name
from vb_core.zones import KEEP_OUT, ZONES, zone_by_number
from vb_msgs.msg import VirtualBorder


def placeholders(sentence):
    return {field for _, field, _, _ in string.Formatter().parse(sentence) if field}


@pytest.mark.parametrize("language", [language for language in sentences.languages() if language != sentences.ENGLISH])
def test_every_language_has_every_code_with_the_same_values(language):
    english, translated = sentences.catalog(), sentences.catalog(language)
    assert set(english) == set(translated)
    assert {code for code in english if placeholders(english[code]) != placeholders(translated[code])} == set()


CAUGHT = {"who_code": "the_robot", "border": "Rug"}
UNNAMED = {"who": "ada", "border_code": "border_without_name"}


@pytest.mark.parametrize(
    "code, values, language, beginning",
    [
        ("no_service", {"who": "border_fusion"}, "en", "border_fusion is not running."),
        # there is always a sentence, without its value, from the code alone or in an unknown language
        ("no_service", {}, "en", "(who) is not running."),
        ("of_a_newer_version", {}, "en", "of a newer version"),
        ("no_response", {"who": "x"}, "tlh", "x is not responding."),
        # a value may be a word in the reader's language, within a sentence or at its beginning
        ("no_service", {"who_code": "map_integrator"}, "en", "The map integrator is not running."),
        ("no_service", {"who_code": "map_integrator"}, "de", "Die Kartenverwaltung läuft nicht."),
        # whatever people call a robot or a border: no text is read as a code
        ("no_service", {"who": "$the_robot"}, "de", "$the_robot läuft nicht."),
        ("border_restored", {"borders": "$the_robot, the_robot"}, "de", "Wieder in der Karte: $the_robot, the_robot."),
        ("robot_caught_in_border", CAUGHT, "en", "The robot is inside Rug "),
        ("robot_caught_in_border", CAUGHT, "de", "Der Roboter "),
        ("robot_caught_in_border", {"border": "Rug", "who": "ada"}, "en", "ada is inside Rug "),
        ("robot_caught_in_border", UNNAMED, "de", "ada ist in Grenze ohne Namen "),
        ("robot_commands_unheard", {**CAUGHT, "topic": "/x"}, "en", "The velocities of the robot reach nobody"),
        # an unnamed border is numbered in the reader's language
        ("robot_caught_in_border", {"who": "ada", "border": "'border 3'"}, "de", "ada ist in 'Grenze 3' "),
        ("border_restored", {"borders": "border 3, wall 4, Rug"}, "de", "Wieder in der Karte: Grenze 3, Wand 4, Rug."),
        ("border_restored", {"borders": "border 3, Rug"}, "en", "In the map again: Border 3, Rug."),
        ("border_restored", {"borders": "my wall 3"}, "de", "Wieder in der Karte: my wall 3."),
    ],
)
def test_values_are_in_the_readers_language(code, values, language, beginning):
    assert sentences.translate(code, values, language).startswith(beginning)


def test_an_unknown_code_shows_the_messages_own_sentence():
    assert sentences.translate("of_a_newer_version", {}, "de", "Please update.") == "Please update."


def test_an_error_carries_its_values():
    error = CodedError("no_response", who="map_integrator")
    assert_fields(error, code="no_response", values={"who": "map_integrator"})
    assert str(error) == "map_integrator is not responding. [no_response]"
    assert CodedError("no_response", "in words of its own").message == "in words of its own"


# ------------------------------------------------------------------ tables
def test_nothing_is_done_in_an_unknown_state():
    assert all(state_by_name(name) is state for name, state in STATES.items())
    unknown = state_by_name("of_a_newer_version")
    assert unknown not in STATES.values()
    assert_fields(unknown, robots_act=False, collects="")


def test_rows_can_be_told_apart():
    for column in ("color", "tone"):
        assert len({getattr(state, column) for state in STATES.values()}) == len(STATES)
    lit = [state.led for state in STATES.values() if state.robots_act]
    assert len({*lit, "BLACK"}) == len(lit) + 1, "dark where spots are ignored"
    assert len({command.key for command in COMMANDS.values()}) == len(COMMANDS)
    assert {command.enters for command in COMMANDS.values()} - {""} <= set(STATES)
    phrases = [phrase for command in COMMANDS.values() for phrase in (words_of_name(command.name), *command.phrases)]
    assert len(set(phrases)) == len(phrases)


def test_commands_are_read_as_people_write_them():
    assert all(command_name_from_text(words_of_name(name).title()) == name for name in COMMANDS)


def test_the_message_names_the_same_zones():
    kinds = ("AUTO", "POLYGON", "SEPARATING_CURVE", "VIRTUAL_WALL")
    numbers = {name: value for name, value in vars(VirtualBorder).items() if name.isupper() and name not in kinds}
    assert numbers == {zone.name.upper(): zone.number for zone in ZONES.values()}


def test_robots_keep_out_of_an_unknown_zone():
    assert all(zone_by_number(zone.number) is zone for zone in ZONES.values())
    assert zone_by_number(77) is KEEP_OUT


@pytest.mark.parametrize("zone", ZONES.values(), ids=ZONES)
def test_a_zone_changes_the_map_or_limits_the_speed(zone):
    assert [zone.value(occupancy) for occupancy in (0.6, 0.0)] == [60 * zone.restricts, 0]
    assert zone.restricts or zone.limits_speed
    # a zone that may be crossed must not look like a wall in the map, every other one must
    assert (zone.occupancy < 1.0) == zone.soft
    assert not zone.is_respected_by(ConnectedRobot("idle"))


@pytest.mark.parametrize("language", sentences.languages())
def test_each_row_has_its_words(language):
    words = sentences.catalog(language)
    codes = {f"{prefix}_{name}" for prefix in ("state", "page_state") for name in STATES}
    codes |= {f"{prefix}_{name}" for prefix in ("command", "page_command") for name in COMMANDS}
    codes |= {f"{prefix}_{name}" for prefix in ("page_zone", "border_unkept") for name in ZONES}
    codes |= {state.prompt for state in STATES.values()} - {""}
    assert codes <= {code for code, sentence in words.items() if sentence}
