"""The state machine: every state x command pair, timing, memory."""
from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vb_core.errors import CodedError
from vb_voice_wizard.interaction import (
    CANCEL,
    COMMANDS,
    DEFINE_BORDER,
    DEFINE_SEED,
    GUIDE_ROBOT,
    SAVE,
    Answer,
    Interaction,
    State,
    normalise,
    spoken,
)

ENTERING = {DEFINE_BORDER: State.BORDER, DEFINE_SEED: State.SEED, GUIDE_ROBOT: State.GUIDE}


def machine() -> Interaction:
    ids = (f"i{number}" for number in itertools.count(1))
    return Interaction(lambda: next(ids))


def after(*commands: str) -> Interaction:
    interaction = machine()
    for second, command in enumerate(commands):
        assert interaction.command(command, "test", float(second)).success
    return interaction


def situations():
    """Every state, with every set of states visited on the way there that is possible."""
    yield ()
    for length in (1, 2, 3):
        yield from itertools.permutations(ENTERING, length)


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("way", list(situations()))
def test_every_state_and_command_pair_is_answered(way, command):
    interaction = after(*way)
    state = ENTERING[way[-1]] if way else State.DEFAULT
    assert interaction.state == state
    kept = interaction.interaction_id, list(interaction.missing())

    answer = interaction.command(command, "test", 10.0)

    assert answer.message.endswith(".") and answer.code
    assert answer.success == (answer.code == "ok")
    if not interaction.saving:
        assert interaction.last_answer == answer and interaction.last_command == command
    if command in ENTERING:
        assert answer.success and interaction.state == ENTERING[command]
        if way:
            assert interaction.interaction_id == kept[0]
    elif command == CANCEL:
        assert answer.success and interaction.state == State.DEFAULT and interaction.interaction_id == ""
        record = interaction.take_record()
        assert (record is not None) == bool(way)
        if record:
            assert (record.outcome, record.border_id, record.interaction_id) == ("cancelled", "", kept[0])
    else:
        complete = DEFINE_BORDER in way and DEFINE_SEED in way
        expected = {
            (False, False): "missing_border_and_seed" if way else "nothing_to_save",
            (True, False): "missing_seed",
            (False, True): "missing_border",
            (True, True): "ok",
        }[(DEFINE_BORDER in way, DEFINE_SEED in way)]
        assert answer.code == expected and interaction.saving == complete
        # nothing is lost, whatever was answered
        assert interaction.state == state and (interaction.interaction_id, interaction.missing()) == kept
        for word in ("border", "seed"):
            if expected.startswith("missing") and word in expected:
                assert word in answer.message


@pytest.mark.parametrize("way", list(situations()))
def test_sensible_commands_are_accepted_and_lead_on(way):
    for command in after(*way).sensible_commands():
        assert after(*way).command(command, "test", 10.0).success
    sensible = after(*way).sensible_commands()
    assert len(set(sensible)) == len(sensible)
    assert (CANCEL in sensible) == bool(way)
    assert (SAVE in sensible) == (DEFINE_BORDER in way and DEFINE_SEED in way)


@pytest.mark.parametrize("command", ["", "  ", "open the door", "saved", "define", "\u00fc"])
@pytest.mark.parametrize("way", [(), (DEFINE_BORDER,)])
def test_unknown_commands_are_answered(way, command):
    interaction = after(*way)
    answer = interaction.command(command, "voice", 5.0)
    assert answer.code == "unknown_command" and not answer.success
    assert all(spoken(known) in answer.message for known in COMMANDS)
    assert interaction.state == (State.BORDER if way else State.DEFAULT)


def test_commands_as_people_write_them():
    for command in COMMANDS:
        assert normalise(spoken(command).upper() + " ") == command
        assert normalise(command.replace("_", "-")) == command


def test_while_saving_everything_else_waits_and_a_refusal_keeps_everything():
    interaction = after(DEFINE_BORDER, DEFINE_SEED)
    identity = interaction.interaction_id
    assert interaction.command(SAVE, "voice", 5.0).success
    for command in (*COMMANDS, "nonsense"):
        assert interaction.command(command, "wizard", 6.0).code == "busy"
    answer = interaction.refuse_save("no_service", "The map integrator does not answer.", 7.0)
    assert answer == Answer(False, "no_service", "The map integrator does not answer.")
    assert interaction.last_answer == answer and interaction.last_source == "voice"
    assert (interaction.state, interaction.interaction_id) == (State.SEED, identity)
    assert interaction.take_record() is None
    assert interaction.command(SAVE, "wizard", 8.0).success
    assert interaction.finish_save("b1", 9.0).success
    assert interaction.state == State.DEFAULT
    assert (interaction.last_outcome, interaction.last_border_id) == ("saved", "b1")
    record = interaction.take_record()
    assert (record.border_id, record.outcome, record.interaction_id) == ("b1", "saved", identity)
    assert record.sources == ("test", "voice", "wizard")
    assert interaction.take_record() is None


def test_timing_runs_from_leaving_default_to_the_integration():
    interaction = machine()
    interaction.command(GUIDE_ROBOT, "a", 100.0)
    interaction.command(DEFINE_BORDER, "a", 110.0)
    interaction.command(DEFINE_SEED, "a", 130.0)
    interaction.command(DEFINE_BORDER, "a", 133.0)
    interaction.command(SAVE, "a", 140.0)
    interaction.finish_save("b", 141.5)
    record = interaction.take_record()
    assert (record.guide_s, record.border_s, record.seed_s) == (10.0, 28.5, 3.0)
    assert (record.started, record.ended, record.total_s) == (100.0, 141.5, 41.5)
    # in Default the figures of the interaction that ended stay
    assert interaction.durations(500.0)[State.BORDER] == 28.5
    interaction.command(DEFINE_BORDER, "a", 600.0)
    assert interaction.durations(601.0) == {State.GUIDE: 0.0, State.BORDER: 1.0, State.SEED: 0.0}


def test_time_that_jumps_back_takes_nothing_off():
    interaction = machine()
    interaction.command(DEFINE_BORDER, "a", 1000.0)
    interaction.advance(1010.0)
    interaction.advance(5.0)
    interaction.command(DEFINE_SEED, "a", 8.0)
    assert interaction.durations(9.0) == {State.GUIDE: 0.0, State.BORDER: 13.0, State.SEED: 1.0}
    assert interaction.started <= 5.0 and interaction.entered == 8.0


steps = st.lists(
    st.tuples(st.sampled_from(COMMANDS), st.floats(0, 100), st.sampled_from(["accept", "refuse"])), max_size=30
)


@settings(max_examples=200, deadline=None)
@given(steps)
def test_any_sequence_keeps_its_invariants_and_survives_a_restart(sequence):
    interaction, other, now, began = machine(), None, 50.0, None
    for command, pause, outcome in sequence:
        now += pause
        before = interaction.state
        if other is None:
            # the second machine is rebuilt from the first one's memory before each command
            other = Interaction.from_mapping(interaction.to_mapping(), lambda: "next")
        interaction.command(command, "s", now)
        other.command(command, "s", now)
        if before == State.DEFAULT and interaction.state != State.DEFAULT:
            began = now
        if interaction.saving:
            for one in (interaction, other):
                if outcome == "accept":
                    one.finish_save("b", now)
                else:
                    one.refuse_save("no", "No.", now)
        for one in (interaction, other):
            one.interaction_id = one.interaction_id and "same"
        assert interaction.to_mapping() == other.to_mapping()
        record = interaction.take_record()
        assert (record is None) == (not (before != State.DEFAULT and interaction.state == State.DEFAULT))
        if record:
            assert math.isclose(record.total_s, now - began, abs_tol=1e-6)
            assert record.ended == now and record.started == began
        if interaction.state != State.DEFAULT:
            assert math.isclose(sum(interaction.durations(now).values()), now - began, abs_tol=1e-6)
            assert interaction.started <= interaction.entered <= now
        other = None


def test_a_save_under_way_is_not_remembered_as_such():
    interaction = after(DEFINE_BORDER, DEFINE_SEED)
    interaction.command(SAVE, "a", 3.0)
    again = Interaction.from_mapping(interaction.to_mapping())
    assert not again.saving and again.state == State.SEED
    assert again.command(SAVE, "a", 4.0).success


@pytest.mark.parametrize(
    "damage",
    [
        lambda memory: memory.pop("state"),
        lambda memory: memory.update(state="flying"),
        lambda memory: memory.update(state=3),
        lambda memory: memory.update(started=float("nan")),
        lambda memory: memory.update(durations={"border": 1.0}),
        lambda memory: memory.update(durations={"border": -1.0, "seed": 0, "guide": 0}),
        lambda memory: memory.update(visited=["nowhere"]),
        lambda memory: memory.update(interaction_id=""),
        lambda memory: memory.clear(),
    ],
)
def test_a_damaged_memory_is_refused(damage):
    memory = after(DEFINE_BORDER).to_mapping()
    damage(memory)
    with pytest.raises(CodedError) as caught:
        Interaction.from_mapping(memory)
    assert caught.value.code == "bad_memory"


def test_no_memory_is_refused():
    with pytest.raises(CodedError):
        Interaction.from_mapping(None)
