"""The interaction between person and system: what each command does in each situation, and saving, time, pause and silence."""

import pytest
from hypothesis import given, settings, strategies as st

from interaction_situations import ALL_SITUATIONS, BEGUN, COMPLETE, SITUATIONS, in_all_situations
from interaction_situations import command_knowing_stops, drawing_of, interaction_after
from vb_testing import assert_fields
from vb_core import sentences
from vb_core.interaction_tables import BORDER, CANCEL, COMMANDS, CONTINUE, DEFAULT, DEFINE_BORDER, DEFINE_SEED, GUIDE
from vb_core.interaction_tables import GUIDE_ROBOT, PAUSE, PAUSED, REDO, RESUME, SAVE, SEED, STATES, STOP, UNDO
from vb_core.sentences import words_of_name
from vb_interaction.command_answers import Answer
from vb_interaction.interaction import MISSING_SPOT_DELAY, Interaction, InteractionParams

# the other commands, with answer and next state (None if the state stays) in Default and once something was begun
OTHER_COMMANDS = [
    (GUIDE_ROBOT, ("guide", GUIDE), ("guide", GUIDE)),
    (CANCEL, ("nothing_to_cancel", None), ("cancelled", DEFAULT)),
    (PAUSE, ("nothing_to_pause", None), ("paused", PAUSED)),
    (CONTINUE, ("not_paused", None), ("not_paused", None)),
    (STOP, ("stopped", None), ("stopped", None)),
    (RESUME, ("not_stopped", None), ("not_stopped", None)),
    (UNDO, ("changing", None), ("not_while_drawing", None)),
    (REDO, ("changing", None), ("not_while_drawing", None)),
]
REFUSALS = {"nothing_to_save", "missing_seed", "missing_border", "missing_border_and_seed", "nothing_to_pause"}
REFUSALS |= {"not_paused", "not_while_drawing"}

CASES = [(before, command) for before in ALL_SITUATIONS for command in COMMANDS]
for_all_commands_in_all_situations = pytest.mark.parametrize("before, command", CASES)


def answer_and_state(before: str, command: str):
    """Returns the code of the answer to a command in a situation, and the state after it."""
    interaction = interaction_after(before)
    return interaction.command(command, "test", 10.0).code, interaction.state


# ------------------------------------------------------------------ what each command does in each situation
@pytest.mark.parametrize("before, state, to_border, to_seed, to_save", SITUATIONS, ids=ALL_SITUATIONS)
def test_border_seed_and_save_are_answered_by_what_was_drawn_before(before, state, to_border, to_seed, to_save):
    assert answer_and_state(before, DEFINE_BORDER) == (to_border, BORDER)
    assert answer_and_state(before, DEFINE_SEED) == (to_seed, SEED)
    assert answer_and_state(before, SAVE) == (to_save, state)


@pytest.mark.parametrize("before, state", [row[:2] for row in SITUATIONS], ids=ALL_SITUATIONS)
@pytest.mark.parametrize("command, in_default, begun", OTHER_COMMANDS)
def test_other_commands_are_answered_by_whether_anything_was_begun(before, state, command, in_default, begun):
    code, next_state = begun if before else in_default
    assert answer_and_state(before, command) == (code, next_state or state)


@for_all_commands_in_all_situations
def test_a_refusal_changes_nothing(before, command):
    interaction = interaction_after(before)
    kept = drawing_of(interaction)
    answer = interaction.command(command, "test", 10.0)
    assert answer.success == (answer.code not in REFUSALS)
    if answer.code in REFUSALS:
        assert drawing_of(interaction) == kept
        assert interaction.pending == ""


@for_all_commands_in_all_situations
def test_an_answer_is_a_sentence_and_is_kept_as_the_newest(before, command):
    interaction = interaction_after(before)
    answer = interaction.command(command, "test", 10.0)
    assert_fields(interaction, last_command=command, last_answer=answer)
    assert answer.code in sentences.catalog()
    assert answer.message.endswith(".")
    assert answer.message == sentences.translate(answer.code, answer.values)


@for_all_commands_in_all_situations
def test_only_stop_stops_and_only_what_others_carry_out_is_pending(before, command):
    interaction = interaction_after(before)
    answer = interaction.command(command, "test", 10.0)
    assert interaction.latch.stopped == (command == STOP)
    assert interaction.pending == (command if answer.code in ("saving", "changing") else "")


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("before", BEGUN)
def test_only_cancel_ends_an_interaction(before, command):
    interaction = interaction_after(before)
    identity, _, missing = drawing_of(interaction)
    interaction.command(command, "test", 10.0)
    record = interaction.take_record()
    if command == CANCEL:
        assert_fields(record, outcome="cancelled", border_id="", interaction_id=identity)
        assert interaction.interaction_id == ""
    else:
        assert record is None
        assert interaction.interaction_id == identity
        assert interaction.missing_parts() == [part for part in missing if command != f"define_{part}"]


@for_all_commands_in_all_situations
def test_what_has_no_effect_is_not_asked_about(before, command):
    answer = interaction_after(before).command(command, "test", 10.0)
    if answer.code in (*REFUSALS, "nothing_to_cancel", "not_stopped"):
        assert interaction_after(before).command(command, "test", 10.0, uncertain=True) == answer


@pytest.mark.parametrize("command", ["", "  ", "open the door", "saved", "define", "\u00fc"])
@pytest.mark.parametrize("before, state", [("", DEFAULT), ("define_border", BORDER)])
def test_an_unknown_command_is_answered_with_all_that_are_known(before, state, command):
    interaction = interaction_after(before)
    answer = interaction.command(command, "voice", 5.0)
    assert_fields(answer, code="unknown_command", success=False)
    assert interaction.state == state
    assert all(words_of_name(known) in answer.message for known in COMMANDS)


# ------------------------------------------------------------------ suggestions
@in_all_situations
def test_each_suggestion_succeeds_and_the_last_is_stop(before):
    suggested = interaction_after(before).suggested_commands()
    assert all(interaction_after(before).command(command, "test", 10.0).success for command in suggested)
    assert suggested[-1] == STOP
    assert len(set(suggested)) == len(suggested)


@pytest.mark.parametrize("before, _state, _border, _seed, to_save", SITUATIONS, ids=ALL_SITUATIONS)
def test_cancel_and_save_are_suggested_where_they_have_an_effect(before, _state, _border, _seed, to_save):
    suggested = interaction_after(before).suggested_commands()
    assert (CANCEL in suggested) == (before != "")
    assert (SAVE in suggested) == (to_save == "saving")


@pytest.mark.parametrize("available", [[], [UNDO], [REDO], [UNDO, REDO]])
def test_undo_and_redo_are_suggested_if_available_and_stop_stays_among_the_first_four(available):
    interaction = Interaction()
    interaction.undo_redo = available
    suggested = interaction.suggested_commands()
    assert [command for command in suggested if command in (UNDO, REDO)] == available
    assert STOP in suggested[:4]


def test_undo_and_redo_are_not_suggested_while_somebody_draws():
    interaction = interaction_after("define_border")
    interaction.undo_redo = [UNDO, REDO]
    assert not {UNDO, REDO} & set(interaction.suggested_commands())


@pytest.mark.parametrize("before", ["", "define_border", COMPLETE, f"{COMPLETE} save"])
def test_without_a_robot_nobody_is_offered_to_guide_one(before):
    assert GUIDE_ROBOT not in interaction_after(before, robot=False).suggested_commands()


def test_without_a_robot_guiding_one_is_refused():
    answer = interaction_after("", robot=False).command("guide_robot", "test", 1.0)
    assert_fields(answer, success=False, code="no_robot_to_guide")


# ------------------------------------------------------------------ saving
@pytest.fixture
def saving() -> Interaction:
    """An interaction that the source "voice" is saving."""
    interaction = interaction_after(COMPLETE)
    assert interaction.command(SAVE, "voice", 5.0).success
    return interaction


@pytest.mark.parametrize("command", [*sorted(set(COMMANDS) - {STOP, RESUME}), "nonsense"])
def test_a_save_under_way_blocks_other_commands(saving, command):
    assert saving.command(command, "wizard", 6.0).code == "busy"


def test_a_save_under_way_does_not_end_by_silence(saving):
    assert not saving.end_if_idle(1000.0)
    assert saving.pending == SAVE


def test_a_stop_is_obeyed_during_a_save_and_holds_after_it(saving):
    assert saving.command(STOP, "page", 8.5).success
    assert saving.finish_pending(Answer(True, "saved"), 9.0, "b1").success
    assert saving.latch.stopped


def test_a_refused_save_is_reported_to_its_source_and_keeps_the_drawing(saving):
    kept = drawing_of(saving)
    answer = saving.finish_pending(Answer(False, "no_service", {"who_code": "map_integrator"}), 7.0)
    assert answer.message == "The map integrator is not running."
    assert_fields(saving, last_source="voice", last_answer=answer)
    assert drawing_of(saving) == kept
    assert saving.command(SAVE, "wizard", 8.0).success
    assert saving.take_record() is None


def test_a_save_ends_the_interaction_and_is_recorded_once(saving):
    identity = saving.interaction_id
    saving.finish_pending(Answer(True, "saved"), 9.0, "b1")
    assert_fields(saving, state=DEFAULT, last_outcome="saved", last_border_id="b1")
    record = saving.take_record()
    assert_fields(record, border_id="b1", outcome="saved", ended=9.0, interaction_id=identity)
    assert saving.take_record() is None


@pytest.mark.parametrize(
    "sent, unanswered_before, code, unanswered, answer_code",
    [
        (True, False, "no_response", True, "save_unanswered"),
        (True, False, "no_service", False, "no_service"),
        (True, True, "no_service", True, "save_unanswered"),
        (True, True, "too_few_points", False, "too_few_points"),
        (True, False, "internal_error", True, "internal_error"),
        (False, True, "too_few_spots", True, "too_few_spots"),
        (False, True, "no_response", True, "save_unanswered"),
        (False, False, "no_response", False, "no_response"),
    ],
)
def test_a_failed_save_says_if_it_may_have_arrived(saving, sent, unanswered_before, code, unanswered, answer_code):
    saving.unanswered_save = unanswered_before
    answer = saving.finish_pending(Answer(False, code, {"who_code": "map_integrator"}), 6.0, is_sent=sent)
    assert_fields(answer, code=answer_code, success=False)
    assert_fields(saving, state=SEED, pending="", unanswered_save=unanswered)


def test_cancel_after_an_unanswered_save_does_not_say_that_the_map_stays_unchanged(saving):
    saving.unanswered_save = True
    saving.finish_pending(Answer(False, "save_unanswered", {"who_code": "map_integrator"}), 6.0)
    answer = saving.command(CANCEL, "a", 7.0)
    assert answer.code == "cancelled_unanswered"
    assert "stays" not in answer.message
    assert saving.take_record().outcome == saving.last_outcome == "unanswered"
    saving.command(DEFINE_BORDER, "a", 8.0)
    assert saving.command(CANCEL, "a", 9.0).code == "cancelled", "in the next interaction nothing is unanswered"


# ------------------------------------------------------------------ time
@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(list(COMMANDS)), st.floats(0, 100), st.booleans()), max_size=30))
def test_durations_add_up_to_the_time_passed_in_each_state(steps):
    """The oracle adds up the pauses before commands by the state that each was spent in; others need 1.5 s to answer."""
    interaction = Interaction()
    began = now = 50.0
    spent = dict.fromkeys(STATES.values(), 0.0)
    for command, pause, accepted in steps:
        before = interaction.state
        now += pause
        spent[before] += pause
        command_knowing_stops(interaction, command, "test", now)
        if before == DEFAULT and interaction.state != DEFAULT:
            began = now
            spent = dict.fromkeys(spent, 0.0)
        if interaction.pending:
            now += 1.5
            spent[before] += 1.5
            code, border_id = ("saved", "b") if accepted else ("busy", "")
            interaction.finish_pending(Answer(accepted, code), now, border_id)
        expected = {state: pytest.approx(spent[state]) for state in (GUIDE, BORDER, SEED)}
        assert interaction.durations(now) == expected
        record = interaction.take_record()
        assert (record is not None) == (before != DEFAULT and interaction.state == DEFAULT)
        if record:
            assert [record.guide_s, record.border_s, record.seed_s] == list(expected.values())
            assert record.total_s == pytest.approx(record.guide_s + record.border_s + record.seed_s)
            assert_fields(record, started=began, ended=now)
        if interaction.state != DEFAULT:
            assert interaction.started_at == began
            assert began <= interaction.state_entered_at <= now


def test_a_record_names_who_gave_commands_but_not_who_only_stopped():
    interaction = Interaction()
    given_by = [(CANCEL, "too early"), (DEFINE_BORDER, "b"), (SAVE, "refused")]
    for command, source in [*given_by, (STOP, "only stops"), (GUIDE_ROBOT, "b"), (CANCEL, "a")]:
        command_knowing_stops(interaction, command, source, 1.0)
    assert interaction.take_record().sources == ("b", "refused", "a")


def test_time_that_jumps_back_takes_nothing_off():
    interaction = Interaction()
    interaction.command(DEFINE_BORDER, "a", 1000.0)
    interaction.advance(1010.0)
    interaction.advance(5.0)
    interaction.command(DEFINE_SEED, "a", 8.0)
    assert interaction.durations(9.0) == {GUIDE: 0.0, BORDER: 13.0, SEED: 1.0}
    assert interaction.started_at <= 5.0
    assert interaction.state_entered_at == 8.0
    interaction.advance(2.0)
    assert interaction.last_answered == 2.0
    assert [interaction.end_if_idle(now) for now in (301.0, 303.0)] == [False, True]


# ------------------------------------------------------------------ pause
def pause(interaction) -> Interaction:
    """Pauses an interaction at 10 s and lets a night pass."""
    assert interaction.command(PAUSE, "test", 10.0).code == "paused"
    assert interaction.state == PAUSED
    interaction.advance(40000.0)
    return interaction


in_all_pauses = pytest.mark.parametrize("before", [*BEGUN, f"{COMPLETE} define_border"])


@in_all_pauses
def test_continue_brings_back_all_that_was_before_the_pauses(before):
    interaction = interaction_after(before)
    kept = drawing_of(interaction)
    spent = interaction.durations(10.0)
    assert pause(pause(interaction)).command(CONTINUE, "test", 40002.0).success
    assert drawing_of(interaction) == kept
    assert interaction.durations(40002.0) == spent


@in_all_pauses
def test_silence_ends_no_paused_interaction_but_one_that_goes_on(before):
    paused = pause(interaction_after(before))
    assert paused.ends_at == 0.0
    assert not paused.end_if_idle(40000.0)
    paused.command(CONTINUE, "test", 40002.0)
    assert [paused.end_if_idle(40002.0 + silence) for silence in (299.0, 301.0)] == [False, True]


@in_all_pauses
def test_no_robot_acts_and_no_spot_is_awaited_in_a_pause(before):
    paused = pause(interaction_after(before))
    assert not paused.state.robots_act
    assert not paused.is_spot_missing


@in_all_pauses
def test_each_suggestion_in_a_pause_succeeds_and_the_first_is_continue(before):
    suggested = pause(interaction_after(before)).suggested_commands()
    assert suggested[0] == CONTINUE
    assert PAUSE not in suggested
    for command in suggested:
        paused = pause(interaction_after(before))
        assert paused.command(command, "test", 40001.0).success
        assert (paused.pending == SAVE) == (command == SAVE)


# ------------------------------------------------------------------ nobody there, or nothing to be seen
def border_begun_at(now, **params) -> Interaction:
    interaction = Interaction(InteractionParams(**params))
    interaction.command(DEFINE_BORDER, "a", now)
    return interaction


@pytest.mark.parametrize(
    "newest_spot, now, ends_at",
    [(1000.0, 1039.0, 0.0), (1000.0, 1050.0, 1100.0), (1000.0, 1099.0, 1100.0), (1090.0, 1100.0, 0.0)],
)
def test_people_are_warned_before_silence_ends_an_interaction(newest_spot, now, ends_at):
    interaction = border_begun_at(1000.0, idle_timeout=100.0)
    interaction.set_spot_counts(1, 0, 0, newest_spot)
    assert not interaction.end_if_idle(now)
    assert interaction.ends_at == ends_at


def test_an_abandoned_interaction_ends_and_is_recorded():
    interaction = border_begun_at(1000.0, idle_timeout=100.0)
    assert interaction.end_if_idle(1100.0)
    assert interaction.state == DEFAULT
    assert interaction.last_answer.code == "abandoned"
    assert interaction.take_record().outcome == interaction.last_outcome == "abandoned"


def test_silence_ends_nothing_that_was_not_begun():
    assert not Interaction().end_if_idle(1e6)
    assert Interaction().ends_at == 0.0


@pytest.mark.parametrize(
    "spots, next_command, waited, missing",
    [
        ((0, 0, 0), "", MISSING_SPOT_DELAY - 0.1, False),
        ((0, 0, 0), "", MISSING_SPOT_DELAY, True),
        ((7, 0, 0), "", MISSING_SPOT_DELAY, False),
        ((7, 0, 0), DEFINE_SEED, MISSING_SPOT_DELAY, True),  # spots of the border do not count
        ((7, 0, 0), GUIDE_ROBOT, 60.0, False),  # nothing is drawn
    ],
)
def test_a_laser_that_no_camera_sees_is_noticed_after_a_while(spots, next_command, waited, missing):
    interaction = border_begun_at(100.0)
    interaction.set_spot_counts(*spots, 100.0)
    if next_command:
        interaction.command(next_command, "test", 100.0)
    interaction.advance(100.0 + waited)
    assert interaction.is_spot_missing is missing


@pytest.mark.parametrize("spots, code", [((0, 0, 0), "missing_spots"), ((7, 0, 0), "missing_seed")])
def test_a_save_without_any_spot_reports_that_instead_of_a_missing_seed(spots, code):
    interaction = border_begun_at(100.0)
    interaction.set_spot_counts(*spots, 116.0)
    assert interaction.command(SAVE, "test", 117.0).code == code


def test_the_next_interaction_begins_without_spots():
    interaction = interaction_after("define_border")
    for command in (CANCEL, DEFINE_BORDER):
        interaction.command(command, "test", 202.0)
    assert interaction.command(SAVE, "test", 203.0).code == "missing_spots"
