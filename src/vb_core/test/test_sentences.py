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


def test_a_sentence_names_its_values():
    assert sentences.translate("no_service", {"who": "border_fusion"}) == "border_fusion is not running."
    assert sentences.translate("no_service", {"who": "border_fusion"}, "de") == "border_fusion läuft nicht."


def test_a_sentence_is_never_lost():
    assert sentences.translate("no_service", {}) == "(who) is not running."
    assert sentences.translate("of_a_newer_version", {}, "de", "Please update.") == "Please update."
    assert sentences.translate("of_a_newer_version") == "of a newer version"
    assert sentences.translate("no_response", {"who": "x"}, "tlh") == "x is not responding."


def test_an_error_carries_its_values():
    error = CodedError("no_response", who="map_integrator")
    assert (error.code, error.values) == ("no_response", {"who": "map_integrator"})
    assert str(error) == "map_integrator is not responding. [no_response]"
    assert CodedError("no_response", "in words of its own").message == "in words of its own"


def test_a_value_may_be_a_word_of_the_readers_language():
    assert sentences.translate("no_service", {"who": "$map_integrator"}) == "The map integrator is not running."
    assert sentences.translate("no_service", {"who": "$map_integrator"}, "de") == "Die Kartenverwaltung läuft nicht."
    assert sentences.translate("no_service", {"who": "$"}) == "$ is not running."


def test_a_border_that_nobody_named_is_numbered_in_the_readers_language():
    assert sentences.border_name("border 3") == "Border 3" and sentences.border_name("border 3", "de") == "Grenze 3"
    assert sentences.border_name("Rug", "de") == "Rug" and sentences.border_name("", "de") == ""
    assert (
        sentences.translate("border_restored", {"borders": "border 3, wall 4, Rug"}, "de")
        == "Wieder in der Karte: Grenze 3, Wand 4, Rug."
    )
    assert "ist in 'Grenze 3' " in sentences.translate(
        "robot_caught_in_border", {"who": "ada", "border": "'border 3'"}, "de"
    )


def test_words_of_the_language_stand_within_a_sentence_and_at_its_beginning():
    code, values = "robot_caught_in_border", {"who": "$the_robot", "border": "Rug"}
    assert sentences.translate(code, values).startswith("The robot is inside Rug ")
    unheard = sentences.translate("robot_commands_unheard", {**values, "topic": "/cmd_vel"})
    assert unheard.startswith("The velocities of the robot reach nobody")
    assert sentences.translate(code, values, "de").startswith("Der Roboter ")
    unnamed = {"who": "ada", "border": "$border_without_name"}
    assert "Grenze ohne Namen" in sentences.translate(code, unnamed, "de")
    assert sentences.translate(code, {"who": "ada", "border": "Rug"}).startswith("ada is inside Rug ")
