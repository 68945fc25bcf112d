"""Sentences: complete in every language, naming the same values, never lost."""

import string

import pytest

from vb_core import sentences
from vb_core.errors import CodedError

OTHERS = [language for language in sentences.languages() if language != sentences.ENGLISH]


def placeholders(sentence):
    return {field for _, field, _, _ in string.Formatter().parse(sentence) if field}


@pytest.mark.parametrize("language", OTHERS)
def test_every_language_has_every_code_with_the_same_values(language):
    english, other = sentences.catalog(), sentences.catalog(language)
    assert set(english) == set(other)
    assert {code for code in english if placeholders(english[code]) != placeholders(other[code])} == set()


CAUGHT = {"who": "$the_robot", "border": "Rug"}


@pytest.mark.parametrize(
    "code, values, language, beginning",
    [
        ("no_service", {"who": "border_fusion"}, "en", "border_fusion is not running."),
        ("no_service", {"who": "border_fusion"}, "de", "border_fusion läuft nicht."),
        # a sentence is never lost: without its value, by its code alone, in a language that nobody has
        ("no_service", {}, "en", "(who) is not running."),
        ("of_a_newer_version", {}, "en", "of a newer version"),
        ("no_response", {"who": "x"}, "tlh", "x is not responding."),
        # a value may be a word of the reader's language, within a sentence and at its beginning
        ("no_service", {"who": "$map_integrator"}, "en", "The map integrator is not running."),
        ("no_service", {"who": "$map_integrator"}, "de", "Die Kartenverwaltung läuft nicht."),
        ("no_service", {"who": "$"}, "en", "$ is not running."),
        ("robot_caught_in_border", CAUGHT, "en", "The robot is inside Rug "),
        ("robot_caught_in_border", CAUGHT, "de", "Der Roboter "),
        ("robot_caught_in_border", {**CAUGHT, "who": "ada"}, "en", "ada is inside Rug "),
        (
            "robot_caught_in_border",
            {"who": "ada", "border": "$border_without_name"},
            "de",
            "ada ist in Grenze ohne Namen ",
        ),
        ("robot_commands_unheard", {**CAUGHT, "topic": "/x"}, "en", "The velocities of the robot reach nobody"),
        # a border that nobody named is numbered in the reader's language
        ("robot_caught_in_border", {"who": "ada", "border": "'border 3'"}, "de", "ada ist in 'Grenze 3' "),
        ("border_restored", {"borders": "border 3, wall 4, Rug"}, "de", "Wieder in der Karte: Grenze 3, Wand 4, Rug."),
        ("border_restored", {"borders": "border 3, Rug"}, "en", "In the map again: Border 3, Rug."),
    ],
)
def test_values_are_in_the_readers_language(code, values, language, beginning):
    assert sentences.translate(code, values, language).startswith(beginning)


def test_an_unknown_code_shows_the_messages_own_sentence():
    assert sentences.translate("of_a_newer_version", {}, "de", "Please update.") == "Please update."


def test_an_error_carries_its_values():
    error = CodedError("no_response", who="map_integrator")
    assert (error.code, error.values) == ("no_response", {"who": "map_integrator"})
    assert str(error) == "map_integrator is not responding. [no_response]"
    assert CodedError("no_response", "in words of its own").message == "in words of its own"
