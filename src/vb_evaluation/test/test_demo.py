"""The demonstration's command line and its verdicts."""

import contextlib
import json
from types import SimpleNamespace
from typing import NamedTuple, Optional

import numpy as np
import pytest
from geometry_msgs.msg import Pose2D
from rich.console import Console

from vb_evaluation import demo
from vb_evaluation.navigation_check.move_base_goals import GoalOutcome
from vb_msgs.msg import InteractionState, LabState
from vb_sim import floor_plan


@pytest.mark.parametrize(
    "arguments, word",
    [
        (["--scenario", "garden"], "SCENARIO"),
        (["--method", "magic"], "METHOD"),
        (["--seed", "one"], "SEED"),
        (["--world", "/nowhere/world.yaml"], "/nowhere/world.yaml"),
        # faulty worlds; the message names the key
        ("robots: []", "robots"),
        ("rooms: {}", "rooms"),
        ("robots: [{name: a}]\nroom: {size: [8.0, -5.0]}", "room/size"),
        ("robots: [{name: a}]\ncameras: [{name: c, heigth: 2}]", "cameras[0]/heigth"),
        ("robots: [{name: a}]\nscenarios: {carpet: {closed: true}}", "scenarios/carpet/border"),
        ("robots: [{name: a", "line 1"),
        ("just text", "world"),
    ],
)
def test_a_wrong_argument_or_world_is_one_line_and_status_2(arguments, word, tmp_path, capfd):
    if isinstance(arguments, str):
        (tmp_path / "a.yaml").write_text(arguments)
        arguments = ["--world", str(tmp_path / "a.yaml")]
    assert demo.main(arguments) == 2
    text = capfd.readouterr().err
    assert word in text
    assert text.count("\n") == 1
    assert "Traceback" not in text


OUT, IN, GOAL = (6.0, 0.5), (4.12, 1.425), (1.6, 1.6)  # beside the carpet, on it, beyond
ROUND = [OUT, (6.0, 0.3), (2.5, 0.3), GOAL]


class Proof(NamedTuple):
    """The robot's place when a border was saved, its path to the start and the goal of the proof, and the verdict."""

    verdict: str
    saved_at: tuple = OUT
    to_start: list = [OUT]
    to_goal: Optional[list] = ROUND  # None if no border was saved
    outcome: str = "reached"
    plan: list = ROUND


PROOFS = [
    Proof("went_round"),
    Proof("out_of_reach", to_goal=[OUT], outcome="refused", plan=[]),
    Proof("no_border", to_goal=None, outcome="", plan=[]),
    Proof("way_crosses", plan=[OUT, IN, GOAL]),
    Proof("robot_entered", to_goal=[OUT, IN, GOAL]),
    Proof("robot_entered", to_start=[OUT, IN], to_goal=[IN], outcome="refused", plan=[]),
    Proof("robot_entered", to_start=[IN], to_goal=[IN], outcome="refused", plan=[]),  # before the first drive
    Proof("robot_entered", saved_at=IN, to_start=[IN, OUT], to_goal=[OUT, IN]),
    Proof("saved_over_robot", saved_at=IN, to_start=[], to_goal=[IN], outcome="refused", plan=[]),
    Proof("saved_over_robot", saved_at=IN, to_start=[IN], to_goal=[IN, (4.2, 1.4)]),
    Proof("went_round", saved_at=IN, to_start=[IN, OUT]),
    Proof("went_round", saved_at=IN, to_start=[IN], to_goal=[IN, *ROUND]),
    Proof("goal_not_reached", to_goal=[OUT], outcome="time_is_up"),
]


@pytest.mark.parametrize("proof", PROOFS, ids=lambda proof: proof.verdict)
def test_verdict_distinguishes_entering_from_standing_inside(proof, tmp_path, capsys):
    options = demo.parse_arguments(["--out", str(tmp_path)])
    prior = floor_plan.physical_map(options.world)
    restricted = floor_plan.ground_truth(options.world, options.scenario)
    posterior = prior.with_data(np.where(restricted, np.int8(100), prior.data))
    lab = LabState(robot_poses=[Pose2D(*proof.saved_at, 0.0)])
    observer = SimpleNamespace(state=InteractionState(), prior=prior, posterior=posterior, lab_at_save=lab)
    places = (proof.to_start, proof.to_goal or [], proof.plan)
    to_start, to_goal, plan = (np.reshape(path, (-1, 2)) for path in places)
    drives = [GoalOutcome("refused", path=to_start), GoalOutcome(proof.outcome, path=to_goal)]
    show = demo.Demo(options, Console(width=200), contextlib.ExitStack())
    status = show._conclude(observer, {"before": plan, "after": plan}, [] if proof.to_goal is None else drives)
    assert json.loads((tmp_path / "summary.json").read_text())["verdict"] == proof.verdict
    assert status == (0 if proof.verdict in ("went_round", "out_of_reach") else 1)
    assert demo.VERDICTS[proof.verdict].format(drive_outcome=proof.outcome) in capsys.readouterr().out
