"""The interaction between person and system: a stop holds until it is resumed, and what may be misheard is asked about."""

import pytest

from interaction_situations import ALL_SITUATIONS, BEGUN, COMPLETE, SITUATIONS, in_all_situations
from interaction_situations import command_knowing_stops, drawing_of, interaction_after
from vb_testing import assert_fields
from vb_core.interaction_tables import CANCEL, COMMANDS, DEFAULT, DEFINE_BORDER, DEFINE_SEED, GUIDE_ROBOT, PAUSE
from vb_core.interaction_tables import PAUSED, REDO, RESUME, SAVE, STOP, UNDO, YES_ANSWERS
from vb_core.sentences import words_of_name
from vb_interaction.command_answers import Answer
from vb_interaction.interaction import CONFIRM_TIMEOUT, Interaction


# ------------------------------------------------------------------ stop
@in_all_situations
def test_a_stop_holds_whatever_else_is_said(before):
    interaction = interaction_after(before)
    interaction.command(STOP, "voice", 10.0, uncertain=True)
    for command in sorted(set(COMMANDS) - {RESUME}):
        interaction.command(command, "wizard", 11.0)
        if interaction.pending:
            interaction.finish_pending(Answer(True, "borders_changed"), 11.0)
        assert_fields(interaction.latch, stopped=True, stopped_by="voice")
        assert interaction.suggested_commands()[0] == RESUME


@in_all_situations
def test_only_a_resume_that_knows_of_the_stop_releases_it(before):
    interaction = interaction_after(f"{before} stop")
    assert interaction.command(RESUME, "wizard", 12.0).code == "resume_which_stop"
    assert interaction.latch.stopped
    assert command_knowing_stops(interaction, RESUME, "wizard", 12.0).success
    assert not interaction.latch.stopped
    assert STOP in interaction.suggested_commands()


@pytest.mark.parametrize("command", [name for name in COMMANDS if name != STOP])
def test_a_stop_voids_every_command_that_was_given_before_it(command):
    interaction = interaction_after(f"{COMPLETE} stop")
    seen = interaction.latch.number
    kept = drawing_of(interaction)
    interaction.command(STOP, "page", 10.0)
    answer = interaction.command(command, "wizard", 11.0, seen_stop=seen)
    assert_fields(answer, success=False, code="stopped_since")
    assert interaction.latch.stopped
    assert interaction.pending == ""
    assert drawing_of(interaction) == kept


def test_one_press_that_comes_by_topic_and_as_a_command_is_one_stop():
    interaction = Interaction()
    interaction.stop("press", "page 1a2b", 1.0)
    assert interaction.stop("press", "page", 20.0).code == "stopped"
    assert interaction.latch.stopped_by == "page 1a2b"
    assert_fields(interaction, last_source="page 1a2b", last_answered=1.0)


def test_a_press_that_comes_again_after_resume_stops_nothing():
    interaction = Interaction()
    interaction.stop("press", "page 1a2b", 1.0)
    assert command_knowing_stops(interaction, RESUME, "wizard", 21.0).success
    assert interaction.stop("press", "page", 22.0).code == "stop_released"
    assert not interaction.latch.stopped


# ------------------------------------------------------------------ doubt
for_all_doubtful_commands = pytest.mark.parametrize(
    "before, command", [(COMPLETE, SAVE), (COMPLETE, CANCEL), ("", UNDO), ("", REDO), ("stop", RESUME)]
)


def asked_about(before, command) -> Interaction:
    """Returns an interaction that asked the source "a" at 10 s whether it means a command."""
    interaction = interaction_after(before)
    assert not command_knowing_stops(interaction, command, "a", 10.0, uncertain=True).success
    return interaction


@for_all_doubtful_commands
def test_a_question_contains_the_words_that_confirm_it(before, command):
    interaction = asked_about(before, command)
    answer = interaction.last_answer
    code = "confirm_save" if command == SAVE else "confirm_command"
    assert answer.code == code
    assert interaction.question.command == command
    assert answer.values["answer"] == words_of_name("yes_" + command)
    assert answer.values["answer"] in answer.message


@for_all_doubtful_commands
@pytest.mark.parametrize(
    "meanwhile, source, waited, is_done",
    [
        ("", "a", 0.0, True),
        ("", "a", CONFIRM_TIMEOUT, True),
        ("", "a", CONFIRM_TIMEOUT + 0.1, False),
        ("", "somebody else", 1.0, False),
        ("nonsense", "a", 1.0, True),
        ("yes_guide_robot", "a", 1.0, False),
        (PAUSE, "a", 1.0, False),
        (STOP, "a", 1.0, False),
    ],
)
def test_only_a_timely_yes_of_who_was_asked_confirms(before, command, meanwhile, source, waited, is_done):
    interaction = asked_about(before, command)
    if meanwhile:
        command_knowing_stops(interaction, meanwhile, "a", 10.0)
    answer = command_knowing_stops(interaction, "yes_" + command, source, 10.0 + waited, uncertain=True)
    assert answer.success == is_done
    assert (answer.code != "nothing_asked") == is_done


@for_all_doubtful_commands
def test_a_word_that_was_misheard_once_is_asked_about_again(before, command):
    interaction = asked_about(before, command)
    question = interaction.last_answer
    assert command_knowing_stops(interaction, command, "a", 11.0, uncertain=True) == question


@for_all_doubtful_commands
@pytest.mark.parametrize("was_asked", [False, True])
def test_a_command_heard_with_certainty_is_carried_out(before, command, was_asked):
    interaction = asked_about(before, command) if was_asked else interaction_after(before)
    assert command_knowing_stops(interaction, command, "a", 11.0).success


def test_a_save_of_a_doubtful_drawing_is_confirmed_by_another_save():
    interaction = interaction_after(COMPLETE)
    asked = interaction.command(SAVE, "a", 10.0, doubtful_border=True)
    assert asked.code == "confirm_save"
    assert asked.values["answer"] == "save"
    assert interaction.pending == ""
    assert interaction.command(SAVE, "a", 11.0, doubtful_border=True).code == "saving"


def test_only_save_is_asked_about_for_a_doubtful_drawing():
    assert interaction_after(COMPLETE).command(CANCEL, "a", 10.0, doubtful_border=True).code == "cancelled"


for_all_words = pytest.mark.parametrize("command", [*COMMANDS, *YES_ANSWERS])


def interaction_after_mishearing(before, command, laser_on) -> Interaction:
    interaction = interaction_after(before)
    if laser_on:
        interaction.laser_seen_at = 9.9
    command_knowing_stops(interaction, command, "voice", 10.0, uncertain=True)
    return interaction


@pytest.mark.parametrize("laser_on", [False, True])
@for_all_words
@in_all_situations
def test_one_misheard_word_changes_no_map_and_releases_no_stop(before, command, laser_on):
    assert not interaction_after_mishearing(before, command, laser_on).pending
    assert interaction_after_mishearing(f"{before} stop", command, laser_on).latch.stopped


@pytest.mark.parametrize("laser_on", [False, True])
@for_all_words
@pytest.mark.parametrize("before", [before for before in BEGUN if before != "guide_robot"])
def test_one_misheard_word_loses_nothing_drawn(before, command, laser_on):
    interaction = interaction_after_mishearing(before, command, laser_on)
    assert interaction.interaction_id
    assert set(interaction.missing_parts()) <= set(interaction_after(before).missing_parts())


@for_all_words
@pytest.mark.parametrize("before, state", [row[:2] for row in SITUATIONS], ids=ALL_SITUATIONS)
def test_one_misheard_word_never_turns_a_line_into_something_else(before, state, command):
    """While the laser is on, a robot would follow it, or the line would become the seed."""
    new_state = interaction_after_mishearing(before, command, laser_on=True).state
    is_harmless_pause = command == PAUSE and new_state == PAUSED
    is_end_of_guiding = before == "guide_robot" and command == CANCEL and new_state == DEFAULT
    assert new_state == state or is_harmless_pause or is_end_of_guiding


@pytest.mark.parametrize(
    "command, at, uncertain, code",
    [
        (GUIDE_ROBOT, 10.5, True, "confirm_command"),
        (GUIDE_ROBOT, 10.5, False, "guide"),
        (GUIDE_ROBOT, 11.1, True, "guide"),  # the laser is off
        (DEFINE_SEED, 10.5, True, "confirm_command"),
        (DEFINE_BORDER, 10.5, True, "draw_border_again"),  # which is no other state
    ],
)
def test_another_state_is_asked_about_while_somebody_points(command, at, uncertain, code):
    interaction = interaction_after("define_border")
    interaction.laser_seen_at = 10.0
    assert interaction.command(command, "voice", at, uncertain).code == code


def test_a_yes_leads_to_the_other_state():
    interaction = interaction_after("define_border")
    interaction.laser_seen_at = 10.0
    assert interaction.command(GUIDE_ROBOT, "voice", 10.5, uncertain=True).values["answer"] == "yes guide robot"
    assert command_knowing_stops(interaction, "yes_guide_robot", "voice", 20.0, uncertain=True).code == "guide"
