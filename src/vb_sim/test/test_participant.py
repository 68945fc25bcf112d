"""The simulated person, with a small stand-in for the system."""

from pathlib import Path
from typing import Any, Dict, NamedTuple, Sequence

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from shapely.geometry import Point, Polygon

from vb_core import geometry
from vb_sim.person.hand import Stroke, Tremor, perceive_border, load_styles
from vb_sim.person.walking import distance_to_chain
from vb_sim.model_params import ParticipantModel
from vb_sim.person.participant_methods import choose_order, make_script
from vb_sim.person.person import Person
from vb_sim.world import load_world
from closed_loop import DT, System

WORLD = load_world(str(Path(__file__).resolve().parents[1] / "worlds" / "lab.yaml"))
DRAWN = ["define_border", "define_seed", "save"]
SLIPS = ParticipantModel(slip=1.0)
EVERYWHERE, NOWHERE = (lambda spot: True), (lambda spot: False)


def chain_of(border, closed):
    return np.vstack([border, border[:1]]) if closed else border


def make_system(key="carpet", method="nrs", seed=1, covered=EVERYWHERE, model=ParticipantModel(), **options):
    script = make_script(WORLD, WORLD.scenario(key), model, method, seed)
    return System(script, WORLD.robots[0].start_pose(), covered, **{"follows": method != "nrs", **options})


def check_drawing(key, sim):
    """Checks that the seen spots lie on the border and cover it."""
    scenario = WORLD.scenario(key)
    border = np.array(sim.border)
    chain = chain_of(scenario.border, scenario.closed)
    assert max(distance_to_chain(spot, chain) for spot in border[::5]) < 0.12
    missed = [distance_to_chain(place, border[::3]) for place in geometry.resample_chain(chain, 0.05)]
    assert max(missed) < 0.10


class Situation(NamedTuple):
    """Who draws which scenario in which time [s], what `make_system` gets, and the commands before a smooth drawing's."""

    key: str
    method: str = "nrs"
    limit: float = 200.0
    system: Dict[str, Any] = {}
    commands_before: Sequence[str] = ()


SCENARIOS = ("room", "carpet", "corner")
END_HIDDEN, BEGINNING_HIDDEN = (lambda spot: spot[0] < 7.0), (lambda spot: spot[1] < 4.2)
ALONE, LED = dict(covered=NOWHERE, dispatch_after=1e9, follows=True), ("guide_robot",)
SITUATIONS = {
    **{key: Situation(key, limit=120.0) for key in SCENARIOS},
    **{f"{key} by robot": Situation(key, "robot_only", 280.0, dict(covered=NOWHERE), LED) for key in SCENARIOS},
    "end not covered": Situation("corner", system=dict(covered=END_HIDDEN, dispatch_after=4.0)),
    "beginning not covered": Situation("corner", system=dict(covered=BEGINNING_HIDDEN, dispatch_after=4.0)),
    "no camera": Situation("room", limit=280.0, system=ALONE, commands_before=["define_border", *LED]),
    "slips": Situation("room", system=dict(model=SLIPS), commands_before=["define_border", "cancel"]),
    "slips by robot": Situation(
        "room", "robot_only", 200.0, dict(model=SLIPS), [*LED, "define_border", "cancel", *LED]
    ),
}


@pytest.mark.parametrize("situation", SITUATIONS.values(), ids=SITUATIONS)
def test_whatever_happens_the_whole_border_is_drawn(situation):
    sim = make_system(situation.key, situation.method, **situation.system)
    assert sim.run(situation.limit) == "saved"
    assert sim.commands == [*situation.commands_before, *DRAWN]
    # a robot is led with its buttons, and without cameras there is no other input
    assert ("buttons" in sim.sources) == ("guide_robot" in situation.commands_before)
    assert ("participant" in sim.sources) == (situation.method == "nrs")
    check_drawing(situation.key, sim)
    if "buttons" not in sim.sources:
        assert np.linalg.norm(np.mean(sim.seed, axis=0) - WORLD.scenario(situation.key).seed) < 0.03


def test_a_robot_left_behind_stops_no_drawing():
    sim = make_system("corner", "robot_only", covered=NOWHERE)
    drive = sim._drive
    # it follows while it is led, but not during drawing
    sim._drive = lambda action, dt: None if sim.perception.state == "border" else drive(action, dt)
    assert sim.run(280.0) == "saved"
    check_drawing("corner", sim)


def test_a_person_gives_up_where_no_camera_sees_the_spot():
    sim = make_system("room", covered=NOWHERE, dispatch_after=1e9, model=ParticipantModel(time_limit=40.0))
    assert sim.run(60.0) == "gave_up"
    assert sim.commands[-1] == "cancel"
    assert sim.perception.state == "default"
    assert sim.actions[-1].laser is None


@pytest.mark.parametrize(
    "refusal, retry", [("no_seed", DRAWN[1:]), ("no_separation", ["cancel", *DRAWN]), ("confirm_save", ["save"])]
)
def test_a_person_mends_what_a_refusal_names_and_saves_again(refusal, retry):
    sim = make_system("room", refuse_saves=[refusal])
    sim.perception.state = "border"  # a state that somebody else left
    assert sim.run(120.0) == "saved"
    assert sim.commands == ["cancel", *DRAWN, *retry]


def test_the_person_gives_up_after_some_tries():
    sim = make_system("room", refuse_saves=["no_separation"] * 9, model=ParticipantModel(tries=2))
    assert sim.run(200.0) == "gave_up"
    assert sim.commands.count("save") == 2
    assert "no_separation" in sim.script.reason


def test_mistakes_are_drawn_for_each_run():
    """A person may err with one method and not with the other; the same run is always the same."""

    def errs(seed, method):
        scenario, model = WORLD.scenario("carpet"), ParticipantModel(wrong_side=0.5)
        return bool(np.any(Person(WORLD, scenario, model, method, seed).seed != scenario.seed))

    errors = [(errs(seed, "nrs"), errs(seed, "robot_only")) for seed in range(40)]
    assert errors[:5] == [(errs(seed, "nrs"), errs(seed, "robot_only")) for seed in range(5)]
    assert len(set(errors)) == 4


@pytest.mark.parametrize("key", SCENARIOS)
def test_a_person_may_show_the_seed_on_the_wrong_side(key):
    sim = make_system(key, model=ParticipantModel(wrong_side=1.0))
    assert sim.run(120.0) == "saved"
    side = Polygon(WORLD.scenario(key).region)
    seeds = (np.mean(sim.seed, axis=0), WORLD.scenario(key).seed)
    assert [side.contains(Point(seed)) for seed in seeds] == [False, True]


def test_a_person_walks_clear_of_walls_and_robot():
    sim = make_system("carpet", "robot_only", covered=NOWHERE)
    sim.run(280.0)
    people = np.array([action.pose for action in sim.actions])[:, :2]
    steps = np.linalg.norm(np.diff(people, axis=0), axis=1)
    assert steps.max() <= 1.0 * DT + 1e-6
    assert sim.script.person.is_floor(people).all()
    distances = np.linalg.norm(people - np.array(sim.robots)[:, :2], axis=1)
    assert distances[1:][steps > 0].min() > 0.35


# ------------------------------------------------------------ hand
def test_tremor_has_its_strength_and_band():
    rng = np.random.default_rng(0)
    tremors = [Tremor(0.01, (0.3, 3.0), rng) for _ in range(30)]
    times = np.arange(0.0, 20.0, 0.02)
    tracks = np.array([[tremor.at(time) for time in times] for tremor in tremors])
    assert np.sqrt((tracks**2).sum(axis=2).mean()) == pytest.approx(0.01, rel=0.1)
    spectrum = (np.abs(np.fft.rfft(tracks - tracks.mean(axis=1, keepdims=True), axis=1)) ** 2).sum(axis=(0, 2))
    frequencies = np.fft.rfftfreq(len(times), 0.02)
    assert spectrum[frequencies > 4.0].sum() < 0.02 * spectrum.sum()


SQUARE = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.25], [0.0, 1.25]])


def draw(border, closed, model, seed=0, style=load_styles()[0], is_floor=lambda points: np.ones(len(points), bool)):
    return Stroke(border, closed, model, np.random.default_rng(seed), is_floor, style)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.booleans())
def test_a_careful_stroke_stays_at_the_border(seed, closed):
    border = SQUARE + np.random.default_rng(seed).normal(0.0, 0.1, (4, 2))
    stroke = draw(border, closed, ParticipantModel(), seed)
    chain = chain_of(border, closed)
    places = np.array([stroke.at(arc) for arc in np.linspace(stroke.start, stroke.length, 200)])
    assert max(distance_to_chain(place, chain) for place in places) < 0.06
    assert max(distance_to_chain(place, places) for place in geometry.resample_chain(chain, 0.05)) < 0.15


def test_real_strokes_move_as_people_do():
    """For all people of the resource: stops at corners, peaks between them, the same mean speed, uneven sides."""
    slow, fast, deviations = [], [], []
    for style in load_styles():
        stroke = draw(SQUARE, True, ParticipantModel(stroke_scale=1.0), style=style)
        arcs = np.arange(0.0, stroke.length, 0.01)
        pace = np.array([stroke.pace(arc) for arc in arcs])
        # the whole takes about as long as at the mean speed, tempo included
        assert 0.5 < np.sum(0.01 / pace) / stroke.length < 2.0
        slow.append(pace.min())
        fast.append(pace.max())
        chain = chain_of(SQUARE, True)
        deviations.append(np.sqrt(np.mean([distance_to_chain(stroke.at(arc), chain) ** 2 for arc in arcs[::10]])))
    assert np.median(slow) < 0.25
    assert np.median(fast) > 2.0
    # errors of centimetres, as people make on the floor, not the millimetres of a ruler
    assert 0.02 < np.median(deviations) < 0.25


def test_closed_strokes_have_gaps_and_overlaps():
    exact = ParticipantModel(stroke_scale=1.0, overlap=0.0, aim_sigma=0.0)
    ends = np.array([draw(SQUARE, True, exact, style=style).points[-1] for style in load_styles()])
    gap = np.linalg.norm(ends - SQUARE[0], axis=1) / np.linalg.norm(np.ptp(SQUARE, axis=0))
    assert 0.02 < np.median(gap) < 0.15 < gap.max()


def test_the_ends_of_open_strokes_are_missed_like_any_corner():
    """A doorway's line has only its two ends: without errors there, its index would be 1.000 by construction."""
    door = np.array([[3.2, 3.18], [3.2, 3.88]])
    model = ParticipantModel(aim_sigma=0.03)
    strokes = [draw(door, False, model, seed) for seed in range(200)]
    ends = np.array([stroke.points[[0, -1]] for stroke in strokes])
    assert np.sqrt(np.mean((ends[:, :, 0] - 3.2) ** 2)) == pytest.approx(0.03 / np.sqrt(2.0), rel=0.2)


def test_open_strokes_end_where_the_floor_ends():
    border = np.array([[0.0, 0.0], [0.0, 2.0]])
    model = ParticipantModel(late_start=0.0)
    stroke = draw(border, False, model, is_floor=lambda p: (p[:, 1] > 0.1) & (p[:, 1] < 1.8))
    assert stroke.at(0.0)[1] == pytest.approx(0.11, abs=0.02)
    assert stroke.at(stroke.length)[1] == pytest.approx(1.79, abs=0.02)


def test_marks_on_the_floor_lie_beside_the_map():
    border = perceive_border(SQUARE, True, (0.03, -0.01), 0.0, 0.05)
    assert np.allclose(border, SQUARE + (0.03, -0.01) + 0.05 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]))
    assert np.allclose(perceive_border(SQUARE[::-1], True, (0.0, 0.0), 0.0, 0.05)[::-1], border - (0.03, -0.01))
    turned = perceive_border(SQUARE, False, (0.0, 0.0), np.pi / 2, 0.05)
    x, y = (SQUARE - SQUARE.mean(axis=0)).T
    assert np.allclose(turned - turned.mean(axis=0), np.column_stack([-y, x]))


@pytest.mark.parametrize("method", ["nrs", "robot_only"])
def test_wrong_words_are_noticed_on_the_display(method):
    right = make_system("room", method, seed=3, model=ParticipantModel(wrong_word=0.0, tries=6))
    wrong = make_system("room", method, seed=3, model=ParticipantModel(wrong_word=0.9, tries=6))
    assert right.run(200.0) == "saved"
    assert wrong.run(290.0) in ("saved", "gave_up")
    assert len(wrong.commands) > len(right.commands)
    assert wrong.perception.now > right.perception.now


# ------------------------------------------------------------ thinking
def test_the_spot_is_drawn_away_from_the_robot():
    border = np.array([[0.0, 0.0], [3.0, 0.0]])
    assert np.allclose(choose_order(border, False, np.array([-1.0, 0.0])), border)
    assert np.allclose(choose_order(border, False, np.array([4.0, 0.0])), border[::-1])
