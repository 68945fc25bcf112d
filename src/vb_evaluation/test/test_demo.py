"""The demonstration's command line and its verdicts."""

import contextlib
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from geometry_msgs.msg import Pose2D
from rich.console import Console

from vb_evaluation import demo
from vb_evaluation.running_system.move_base_goals import GoalOutcome
from vb_msgs.msg import InteractionState, LabState
from vb_sim.room import floor_plan

TOP = Path(__file__).resolve().parents[3]


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
    assert word in text and text.count("\n") == 1 and "Traceback" not in text


OUT, IN, GOAL = (6.0, 0.5), (4.12, 1.425), (1.6, 1.6)  # beside the carpet, on it, beyond
ROUND = [OUT, (6.0, 0.3), (2.5, 0.3), GOAL]


@pytest.mark.parametrize(
    "code, at_save, first, driven, outcome, after",
    [
        ("went_round", OUT, [OUT], ROUND, "reached", ROUND),
        ("out_of_reach", OUT, [OUT], [OUT], "refused", []),
        ("no_border", OUT, None, [], "", []),
        ("way_crosses", OUT, [OUT], ROUND, "reached", [OUT, IN, GOAL]),
        ("robot_entered", OUT, [OUT], [OUT, IN, GOAL], "reached", ROUND),
        ("robot_entered", OUT, [OUT, IN], [IN], "refused", []),  # on the way to the start of the proof
        ("robot_entered", OUT, [IN], [IN], "refused", []),  # between the save and the first goal
        ("robot_entered", IN, [IN, OUT], [OUT, IN], "reached", ROUND),
        ("saved_over_robot", IN, [], [IN], "refused", []),
        ("saved_over_robot", IN, [IN], [IN, (4.2, 1.4)], "reached", ROUND),
        ("went_round", IN, [IN, OUT], ROUND, "reached", ROUND),
        ("went_round", IN, [IN], [IN, *ROUND], "reached", ROUND),
        ("goal_not_reached", OUT, [OUT], [OUT], "time_is_up", ROUND),
    ],
)
def test_verdict_distinguishes_entering_from_standing_inside(
    code, at_save, first, driven, outcome, after, tmp_path, capsys
):
    options = demo.parse(["--out", str(tmp_path)])
    prior = floor_plan.physical_map(options.world)
    restricted = floor_plan.ground_truth(options.world, options.scenario)
    posterior = prior.with_data(np.where(restricted, np.int8(100), prior.data))
    lab = LabState(robot_poses=[Pose2D(*at_save, 0.0)])
    observer = SimpleNamespace(state=InteractionState(), prior=prior, posterior=posterior, lab_at_save=lab)
    paths = [np.array(points, dtype=float).reshape(-1, 2) for points in (after, first or [], driven)]
    drives = [] if first is None else [GoalOutcome("refused", path=paths[1]), GoalOutcome(outcome, path=paths[2])]
    with contextlib.ExitStack() as stack:
        show = demo.Demo(options, Console(width=200), stack)
        status = show._conclude(observer, {"before": paths[2], "after": paths[0]}, drives)
    assert json.loads((tmp_path / "summary.json").read_text())["verdict"] == code
    assert status == (0 if code in ("went_round", "out_of_reach") else 1)
    assert demo.VERDICTS[code].format(drive_outcome=outcome) in capsys.readouterr().out
