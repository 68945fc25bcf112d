"""The state machine: every pair of state and command, timing, memory."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vb_core import sentences
from vb_core.sentences import spelled_out
from vb_core.vocabulary import ANSWERS, BORDER, COMMANDS, DEFAULT, GUIDE, PAUSED, SEED
from vb_core.vocabulary import CANCEL, CONTINUE, DEFINE_BORDER, DEFINE_SEED, GUIDE_ROBOT, PAUSE, REDO, RESUME, SAVE
from vb_core.vocabulary import STOP, UNDO
from vb_voice_wizard.dialogue.command_answers import Answer
from vb_voice_wizard.interaction import CONFIRM_WITHIN, UNSEEN_AFTER, Interaction, InteractionParams

ENTERING = {DEFINE_BORDER: BORDER, DEFINE_SEED: SEED, GUIDE_ROBOT: GUIDE}


def machine(**params) -> Interaction:
    return Interaction(InteractionParams(**params))


def say(interaction, said, source, now, uncertain=False, doubtful=False):
    """Gives a command, or the answer that confirms one, as a person who knows of every stop."""
    number, name = interaction.latch.number, ANSWERS.get(said, said)
    return interaction.command(name, source, now, uncertain, doubtful, said in ANSWERS, seen_stop=number)


def after(*commands: str, **params) -> Interaction:
    interaction = machine(**params)
    for second, command in enumerate(commands):
        assert say(interaction, command, "test", float(second)).success
    # these tests are about commands; others test whether spots were seen
    interaction.set_spot_counts(3, 2, 1, float(len(commands)))
    return interaction


def situations():
    """Yields command sequences to every state, with every possible set of states visited on the way."""
    yield ()
    for length in (1, 2, 3):
        yield from itertools.permutations(ENTERING, length)


def expected(way, command):
    """Returns the answer's code for a command after others, whether it is carried out, and the resulting state."""
    state = ENTERING[way[-1]] if way else DEFAULT
    if command in ENTERING:
        entered = ENTERING[command]
        return entered.prompt + "_again" * (command in way and entered != GUIDE), True, entered
    missing = "_and_".join(ENTERING[part].collects for part in (DEFINE_BORDER, DEFINE_SEED) if part not in way)
    in_default, drawing = {
        CANCEL: (("nothing_to_cancel", True, DEFAULT), ("cancelled", True, DEFAULT)),
        STOP: (("stopped", True, state),) * 2,
        RESUME: (("not_stopped", True, state),) * 2,
        PAUSE: (("nothing_to_pause", False, state), ("paused", True, PAUSED)),
        CONTINUE: (("not_paused", False, state),) * 2,
        **dict.fromkeys((UNDO, REDO), (("changing", True, state), ("not_while_drawing", False, state))),
        SAVE: (
            ("nothing_to_save", False, state),
            (f"missing_{missing}", False, state) if missing else ("saving", True, state),
        ),
    }[command]
    return drawing if way else in_default


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("way", list(situations()))
def test_every_state_and_command_pair_is_answered(way, command):
    interaction = after(*way)
    identity, missing = interaction.interaction_id, interaction.missing()
    answer = interaction.command(command, "test", 10.0)
    assert (answer.code, answer.success, interaction.state) == expected(way, command)
    assert answer.message == sentences.translate(answer.code, answer.values) and answer.message.endswith(".")
    assert answer.code in sentences.catalog()
    assert interaction.last_answer == answer and interaction.last_command == command
    assert interaction.pending == (command if answer.code in ("saving", "changing") else "")
    assert interaction.latch.stopped == (command == STOP)
    record = interaction.take_record()
    if answer.code == "cancelled":
        assert (record.outcome, record.border_id, record.interaction_id) == ("cancelled", "", identity)
        assert interaction.interaction_id == ""
    else:
        # nothing is lost, whatever the answer
        entered = ENTERING[command].collects if command in ENTERING else ""
        assert record is None and interaction.missing() == [part for part in missing if part != entered]
        assert interaction.interaction_id == identity or (not way and command in ENTERING)
    assert bool(interaction.interaction_id) == (interaction.state != DEFAULT)
    if not answer.success or answer.code.startswith(("not", "nothing")):
        assert (
            after(*way).command(command, "test", 10.0, uncertain=True) == answer
        ), "what has no effect is not asked about"


@pytest.mark.parametrize("way", list(situations()))
def test_sensible_commands_are_accepted_and_lead_on(way):
    for command in after(*way).suggested_commands():
        assert after(*way).command(command, "test", 10.0).success
    sensible = after(*way).suggested_commands()
    assert len(set(sensible)) == len(sensible) and sensible[-1] == STOP
    assert (CANCEL in sensible) == bool(way)
    assert (SAVE in sensible) == (DEFINE_BORDER in way and DEFINE_SEED in way)


@pytest.mark.parametrize("undo_redo", [[], [UNDO], [REDO], [UNDO, REDO]])
def test_undo_and_redo_are_suggested_only_if_available(undo_redo):
    interaction = machine()
    interaction.undo_redo = undo_redo
    suggested = interaction.suggested_commands()
    assert [command for command in suggested if command in (UNDO, REDO)] == undo_redo
    assert STOP in suggested[:4]  # displays show the first four
    interaction.command(DEFINE_BORDER, "test", 1.0)
    assert not {UNDO, REDO} & set(interaction.suggested_commands())  # they are refused while somebody draws


@pytest.mark.parametrize("command", ["", "  ", "open the door", "saved", "define", "\u00fc"])
@pytest.mark.parametrize("way", [(), (DEFINE_BORDER,)])
def test_unknown_commands_are_answered(way, command):
    interaction = after(*way)
    answer = interaction.command(command, "voice", 5.0)
    assert answer.code == "unknown_command" and not answer.success
    assert all(spelled_out(known) in answer.message for known in COMMANDS)
    assert interaction.state == (BORDER if way else DEFAULT)


def test_saving_blocks_other_commands_and_refusal_keeps_the_drawing():
    interaction = after(DEFINE_BORDER, DEFINE_SEED)
    identity = interaction.interaction_id
    assert interaction.command(SAVE, "voice", 5.0).success
    for command in (*COMMANDS, "nonsense"):
        if command not in (STOP, RESUME):
            assert interaction.command(command, "wizard", 6.0).code == "busy"
    assert not interaction.end_if_idle(1000.0) and interaction.pending == SAVE
    interaction.advance(6.0)
    answer = interaction.finish(Answer(False, "no_service", {"who": "$map_integrator"}), 7.0)
    assert answer.message == "The map integrator is not running."
    assert interaction.last_answer == answer and interaction.last_source == "voice"
    assert (interaction.state, interaction.interaction_id) == (SEED, identity)
    assert interaction.take_record() is None
    assert interaction.command(SAVE, "wizard", 8.0).success
    assert interaction.command(STOP, "page", 8.5).success
    assert interaction.finish(Answer(True, "saved"), 9.0, "b1").success
    assert (interaction.state, interaction.latch.stopped, interaction.last_source) == (DEFAULT, True, "wizard")
    assert (interaction.last_outcome, interaction.last_border_id) == ("saved", "b1")
    record = interaction.take_record()
    assert (record.border_id, record.outcome, record.interaction_id) == ("b1", "saved", identity)
    assert record.sources == ("test", "voice", "wizard")
    assert interaction.take_record() is None


def test_time_that_jumps_back_takes_nothing_off():
    interaction = machine()
    interaction.command(DEFINE_BORDER, "a", 1000.0)
    interaction.advance(1010.0)
    interaction.advance(5.0)
    interaction.command(DEFINE_SEED, "a", 8.0)
    assert interaction.durations(9.0) == {GUIDE: 0.0, BORDER: 13.0, SEED: 1.0}
    assert interaction.started <= 5.0 and interaction.entered == 8.0
    interaction.advance(2.0)
    assert interaction.last_answered == 2.0 and not interaction.end_if_idle(301.0) and interaction.end_if_idle(303.0)


steps = st.lists(
    st.tuples(st.sampled_from(list(COMMANDS)), st.sampled_from("ab"), st.floats(0, 100), st.booleans()), max_size=30
)


@settings(max_examples=200, deadline=None)
@given(steps)
def test_any_sequence_is_timed_by_state_and_a_stop_holds(sequence):
    interaction, now, began, stopped, sources = machine(), 50.0, 0.0, False, []
    spent = {GUIDE: 0.0, BORDER: 0.0, SEED: 0.0}

    def pass_time(seconds):
        if interaction.state in spent:
            spent[interaction.state] += seconds
        return now + seconds

    for command, source, pause, accepted in sequence:
        now, before = pass_time(pause), interaction.state
        say(interaction, command, source, now)
        if before == DEFAULT and interaction.state != DEFAULT:
            began, sources = now, []
            spent.update(dict.fromkeys(spent, 0.0))
        if command != STOP and source not in sources:  # a person who only stops does not take part
            sources.append(source)
        if interaction.pending:
            now = pass_time(1.5)  # the other nodes take their time
            interaction.finish(Answer(accepted, "saved" if accepted else "busy"), now, "b" if accepted else "")
        stopped = command == STOP or (stopped and command != RESUME)
        assert interaction.latch.stopped == stopped
        # in Default, the durations of the last interaction remain
        assert interaction.durations(now) == pytest.approx(spent)
        record = interaction.take_record()
        assert (record is None) == (not (before != DEFAULT and interaction.state == DEFAULT))
        if record:
            found = [record.guide_s, record.border_s, record.seed_s, record.total_s]
            assert found == pytest.approx([*spent.values(), sum(spent.values())])
            assert (record.started, record.ended, list(record.sources)) == (began, now, sources)
        if interaction.state != DEFAULT:
            assert began == interaction.started <= interaction.entered <= now


# ------------------------------------------------------------------ pause
@pytest.mark.parametrize("way", [*filter(None, situations()), (DEFINE_BORDER, DEFINE_SEED, DEFINE_BORDER)])
def test_a_pause_keeps_everything_until_the_person_goes_on(way):
    def paused(interaction):
        assert interaction.command(PAUSE, "test", 10.0).code == "paused" and interaction.state == PAUSED
        assert not interaction.state.robots_act and not interaction.unseen
        # a night later it is still there, and the night does not count as working time
        assert not interaction.end_if_idle(40000.0) and interaction.ends_at == 0.0
        return interaction

    interaction = after(*way)
    state, spent = interaction.state, interaction.durations(10.0)
    kept = interaction.interaction_id, interaction.missing()
    assert paused(interaction).suggested_commands()[0] == CONTINUE and PAUSE not in interaction.suggested_commands()
    for command in interaction.suggested_commands():
        other = paused(after(*way))
        assert other.command(command, "test", 40001.0).success and (other.pending == SAVE) == (command == SAVE)
    assert interaction.command(PAUSE, "test", 40001.0).code == "paused"
    assert interaction.command(CONTINUE, "test", 40002.0).success
    assert interaction.state == state and (interaction.interaction_id, interaction.missing()) == kept
    assert interaction.durations(40002.0) == spent
    # after the pause, silence ends the interaction again
    assert not interaction.end_if_idle(40002.0 + 299.0) and interaction.end_if_idle(40002.0 + 301.0)


# ------------------------------------------------------------------ stop
@pytest.mark.parametrize("way", list(situations()))
def test_stop_holds_until_resume_whatever_else_is_said(way):
    interaction = after(*way)
    assert interaction.command(STOP, "voice", 10.0, uncertain=True).success
    for command in (c for c in COMMANDS if c != RESUME):
        interaction.command(command, "wizard", 11.0)
        if interaction.pending:
            interaction.finish(Answer(True, "borders_changed"), 11.0)
        assert interaction.latch.stopped and interaction.latch.by == "voice"
        assert interaction.suggested_commands()[0] == RESUME
    assert interaction.command(RESUME, "wizard", 12.0).code == "resume_which_stop" and interaction.latch.stopped
    assert say(interaction, RESUME, "wizard", 12.0).success
    assert not interaction.latch.stopped and STOP in interaction.suggested_commands()


def test_one_press_that_comes_by_topic_and_as_a_command_is_one_stop():
    interaction = machine()
    interaction.command(STOP, "page 1a2b", 1.0, identity="press")
    before = (interaction.latch.by, interaction.last_source, interaction.last_answered)
    assert interaction.command(STOP, "page", 20.0, identity="press").code == "stopped"
    assert (interaction.latch.by, interaction.last_source, interaction.last_answered) == before
    assert say(interaction, RESUME, "wizard", 21.0).success
    assert interaction.command(STOP, "page", 22.0, identity="press").code == "stop_released"
    assert not interaction.latch.stopped


@pytest.mark.parametrize("command", [name for name in COMMANDS if name != STOP])
def test_a_stop_voids_every_command_that_was_given_before_it(command):
    interaction = after(DEFINE_BORDER, DEFINE_SEED, STOP)
    seen = interaction.latch.number
    interaction.command(STOP, "page", 10.0)
    before = (interaction.state, interaction.interaction_id, interaction.missing())
    answer = interaction.command(command, "wizard", 11.0, seen_stop=seen)
    assert (answer.success, answer.code) == (False, "stopped_since")
    assert interaction.latch.stopped and not interaction.pending
    assert (interaction.state, interaction.interaction_id, interaction.missing()) == before


# ------------------------------------------------------------------ asked about
ASKED_ABOUT = {(DEFINE_BORDER, DEFINE_SEED): (SAVE, CANCEL), (): (UNDO, REDO), (STOP,): (RESUME,)}


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_doubtful_command_needs_a_timely_answer_in_other_words(data):
    way = data.draw(st.sampled_from(list(ASKED_ABOUT)))
    words = [*ASKED_ABOUT[way], *("yes_" + name for name in ASKED_ABOUT[way]), PAUSE, STOP, "nonsense"]
    pauses = st.floats(0.0, 1.2 * CONFIRM_WITHIN)
    step = st.tuples(st.sampled_from(words), st.sampled_from("ab"), st.booleans(), st.booleans(), pauses)
    interaction, now, asked = after(*way), 10.0, ("", "", 0.0)
    for said, source, uncertain, doubtful, pause in data.draw(st.lists(step, max_size=20)):
        now += pause
        name, stopped = ANSWERS.get(said, said), interaction.latch.stopped
        answer = say(interaction, said, source, now, uncertain, doubtful)
        if said == "nonsense":
            assert answer.code == "unknown_command"
            continue  # an unknown command leaves the question open
        meant = asked[:2] == (name, source) and now - asked[2] <= CONFIRM_WITHIN
        asked = ("", "", 0.0)  # any other command closes the question
        if said in ANSWERS:
            done, code = meant, "nothing_asked"
        else:
            # a misheard word may be misheard again: the same word is an answer only if it was recognised with certainty
            done = said in (PAUSE, STOP) or (not uncertain and (meant or not (doubtful and said == SAVE)))
            code = "confirm_save" if said == SAVE else "confirm_command"
        if done:
            assert answer.code not in ("nothing_asked", "confirm_save", "confirm_command")
            if said not in (PAUSE, STOP):
                assert answer.success
                return
        else:
            assert (answer.code, answer.success) == (code, False)
            assert not interaction.pending and interaction.latch.stopped == stopped
            assert bool(interaction.interaction_id) == (SAVE in words), "the drawing is still there"
            if said not in ANSWERS:
                asked = (name, source, now)
                assert answer.values["answer"] == spelled_out("yes_" + name if uncertain else name)
                assert answer.values["answer"] in answer.message
        assert interaction.question.command == asked[0]


@pytest.mark.parametrize("laser_on", [False, True])
@pytest.mark.parametrize("command", [*COMMANDS, *ANSWERS])
@pytest.mark.parametrize("way", [(*way, *stop) for way in situations() for stop in ((), (STOP,))])
def test_one_misheard_word_does_no_harm(way, command, laser_on):
    interaction = after(*way)
    drawing, missing, state = interaction.interaction_id, interaction.missing(), interaction.state
    if laser_on:
        interaction.see_laser(9.9)
    say(interaction, command, "voice", 10.0, uncertain=True)
    assert not interaction.pending and (interaction.latch.stopped or STOP not in way)
    assert set(interaction.missing()) <= set(missing)
    assert drawing in ("", interaction.interaction_id) or len(missing) == 2, "only where nothing is drawn"
    if laser_on:
        # else a robot would follow the laser, or the line become the seed; without a drawing, cancelling only ends the
        # guiding, and a pause keeps everything drawn
        assert interaction.state == state or command == PAUSE or (command == CANCEL and len(missing) == 2)


def test_another_state_is_asked_about_while_somebody_points():
    interaction = after(DEFINE_BORDER)
    interaction.see_laser(10.0)
    assert interaction.command(GUIDE_ROBOT, "voice", 10.5, uncertain=True).values["answer"] == "yes guide robot"
    assert interaction.command(DEFINE_BORDER, "voice", 10.6, uncertain=True).code == "draw_border_again"
    interaction.see_laser(11.0)
    assert interaction.command(GUIDE_ROBOT, "voice", 11.1, uncertain=True).code == "confirm_command"
    assert say(interaction, "yes_guide_robot", "voice", 20.0, uncertain=True).code == "guide"
    assert interaction.command(DEFINE_SEED, "voice", 20.0, uncertain=True).code == "point_seed", "nobody points"
    interaction.see_laser(21.0)
    assert interaction.command(DEFINE_BORDER, "voice", 21.0).code == "draw_border_again", "beyond doubt"


# ------------------------------------------------------------------ a save without an answer, and nobody there
@pytest.mark.parametrize(
    "sent, before, code, in_doubt, answered",
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
def test_whether_an_unanswered_border_may_be_in_the_map_is_known(sent, before, code, in_doubt, answered):
    interaction = after(DEFINE_BORDER, DEFINE_SEED)
    interaction.unanswered_save = before
    interaction.command(SAVE, "a", 3.0)
    if sent:
        interaction.mark_save_sent()
        assert interaction.unanswered_save, "while it is under way"
    answer = interaction.finish(Answer(False, code, {"who": "$map_integrator"}), 4.0)
    assert (interaction.unanswered_save, answer.code, answer.success) == (in_doubt, answered, False)
    assert interaction.state == SEED and not interaction.pending


def test_cancel_after_unanswered_save_promises_no_unchanged_map():
    interaction = after(DEFINE_BORDER, DEFINE_SEED)
    interaction.command(SAVE, "a", 3.0)
    interaction.unanswered_save = True
    interaction.finish(Answer(False, "save_unanswered", {"who": "$map_integrator"}), 4.0)
    answer = interaction.command(CANCEL, "a", 5.0)
    assert answer.code == "cancelled_unanswered" and "stays" not in answer.message
    assert interaction.take_record().outcome == interaction.last_outcome == "unanswered"
    interaction.command(DEFINE_BORDER, "a", 6.0)
    assert interaction.command(CANCEL, "a", 7.0).code == "cancelled"


def test_an_abandoned_interaction_ends_after_a_warning():
    interaction = machine(idle_timeout=100.0)
    assert not interaction.end_if_idle(1e6) and interaction.ends_at == 0.0
    interaction.command(DEFINE_BORDER, "a", 1000.0)
    assert not interaction.end_if_idle(1039.0) and interaction.ends_at == 0.0
    assert not interaction.end_if_idle(1050.0) and interaction.ends_at == 1100.0
    interaction.set_spot_counts(1, 0, 0, 1090.0)
    assert not interaction.end_if_idle(1100.0) and interaction.ends_at == 0.0
    assert interaction.end_if_idle(90000.0)
    assert interaction.state == DEFAULT and interaction.last_answer.code == "abandoned"
    assert interaction.take_record().outcome == interaction.last_outcome == "abandoned"


def test_without_a_robot_nobody_is_offered_to_guide_one():
    for way in ((), (DEFINE_BORDER,), (DEFINE_BORDER, DEFINE_SEED), (DEFINE_BORDER, DEFINE_SEED, SAVE)):
        assert GUIDE_ROBOT not in after(*way, robot=False).suggested_commands()
    answer = machine(robot=False).command(GUIDE_ROBOT, "test", 1.0)
    assert (answer.success, answer.code) == (False, "no_robot_to_guide")


def test_unseen_laser_is_reported_instead_of_a_missing_seed():
    interaction = machine()
    interaction.command(DEFINE_BORDER, "test", 100.0)
    interaction.advance(100.0 + UNSEEN_AFTER - 0.1)
    assert not interaction.unseen
    interaction.advance(100.0 + UNSEEN_AFTER)
    assert interaction.unseen
    assert interaction.command(SAVE, "test", 115.0).code == "missing_spots"

    interaction.set_spot_counts(7, 0, 0, 116.0)
    assert not interaction.unseen
    assert interaction.command(SAVE, "test", 117.0).code == "missing_seed"

    # spots of the border do not count for the seed
    interaction.command(DEFINE_SEED, "test", 120.0)
    interaction.advance(120.0 + UNSEEN_AFTER)
    assert interaction.unseen
    # in Guide nothing is drawn, and the next interaction begins without spots
    interaction.command(GUIDE_ROBOT, "test", 140.0)
    interaction.advance(200.0)
    assert not interaction.unseen
    interaction.command(CANCEL, "test", 201.0)
    interaction.command(DEFINE_BORDER, "test", 202.0)
    assert interaction.command(SAVE, "test", 203.0).code == "missing_spots"
