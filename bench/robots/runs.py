#!/usr/bin/env python3
"""Robots over many interactions: collisions, borders entered, speed, waiting at the hand-over.

    python3 bench/robots/runs.py                                    every scenario and method, 20 seeds, in one process
    python3 bench/robots/runs.py --scenarios corner --methods nrs --seeds 1 2 3
    python3 bench/robots/runs.py --ros --scenarios corner --methods nrs --seeds 1 2 3     over ROS, about 60 s each
    python3 bench/robots/runs.py --resume                           only the runs that are missing in the file

In one process the same nodes run without a ROS master, in simulated time as fast as the processor goes
(vb_evaluation.virtual_ros). Once the border is saved navigation is sent to places on either side
of it and in it: it must go round or refuse. Over ROS the whole system is started with roslaunch under a master of its
own, and goes on for some seconds in which a robot that the border enclosed leaves it. Either way the judge sees the
lab's ground truth 50 times a second, none of what the robot believes.
Leaves out/bench/robot_runs.json (robot_runs_ros.json), one entry per run; bad runs stay in it; with --table also
docs/results/robots/runs.md. Exits non-zero if a run broke a rule.
"""

import argparse
import itertools
import json
import os
import shutil
import sys
import tempfile
import threading
import time
from pathlib import Path

import actionlib
import numpy as np
import rosgraph
import rospy
from actionlib_msgs.msg import GoalStatus
from move_base_msgs.msg import MoveBaseAction, MoveBaseGoal
from std_msgs.msg import String

from vb_core import names
from vb_core.errors import CodedError
from vb_core.grid_map import distance_to
from vb_core.ros.messages import OccupancyGridArray, grid_from_message, message_from_pose2d
from vb_evaluation.observer import wait_until
from vb_evaluation.processes import Child, free_port, roslaunch
from vb_evaluation.provenance import revision
from vb_evaluation.study import config
from vb_evaluation.study.result import RunTask
from vb_evaluation.study.runner import LiveRun
from vb_msgs.msg import DetectorStatus, InteractionState, LabState, LaserSpot
from vb_sim.room.world import load_world

TOP = Path(__file__).resolve().parents[2]
GUIDED_SPEED = 0.2  # [m/s] while a person leads the robot or draws with it alone
DRIVEN_SPEED = 0.5  # [m/s] under navigation
SPEED_TOLERANCE = 0.005  # [m/s] over ROS speeds are differences of positions
WAIT_GOAL_S = 10.0
READY_S, RUN_S, AFTER_S = 90.0, 600.0, 6.0
GOAL_S = 60.0  # [s] for navigation to reach a goal or to give it up
BAG_TOPICS = [
    names.SPOTS,
    names.LAB_STATE,
    names.STATE,
    names.PROGRESS,
    names.DETECTORS,
    names.NOTICES,
    names.DRIVERS,
    "/tf",
    "/tf_static",
    "/robot_dispatcher/viewpoint",
    "/spot_detector_robot/debug_image",
]


class Judge:
    """Watches one run by the ground truth and keeps what it is judged by. May be fed from several threads."""

    def __init__(self, radius: float, guided: bool) -> None:
        self._radius = radius
        self._guided_method = guided
        self._lock = threading.Lock()
        self._physical = self._map_with_borders = None
        self._obstacle_gap = self._border_gap = None
        self._before = None
        self._allowed_gap = np.inf
        self._seen_at = -np.inf
        self._lit_since = self._holds_since = None
        self.state = "default"
        self.outcome = ""
        self.doings = []  # (time [s], what the person began to do)
        self.figures = {
            "least_clearance_m": np.inf,
            "border_entered_m": 0.0,
            "max_guided_speed_m_s": 0.0,
            "max_speed_m_s": 0.0,
            "longest_hold_s": 0.0,
            "longest_unseen_s": 0.0,
            "way_m": 0.0,
        }

    def set_maps(self, physical=None, map_with_borders=None) -> None:
        """Takes the maps without and with borders."""
        with self._lock:
            if physical is not None:
                self._physical = physical
                self._obstacle_gap = distance_to(physical.data >= 65) * physical.resolution
            self._map_with_borders = map_with_borders if map_with_borders is not None else self._map_with_borders
            if self._physical is None or self._map_with_borders is None:
                return
            restricted = self._map_with_borders.data > np.maximum(self._physical.data, 0)
            self._border_gap = distance_to(restricted) * self._physical.resolution if restricted.any() else None
            # a border may be put where the robot stands: from then on it must not go deeper
            self._allowed_gap = np.inf

    def spot_seen(self, stamp: float) -> None:
        """Notes that some camera saw a spot at a time [s]."""
        with self._lock:
            self._seen_at = max(self._seen_at, stamp)

    def step(self, now: float, place, laser_on: bool, doing: str) -> None:
        """Notes how things truly are at a time [s]: the robot's (x, y) [m], the person's laser and what he does."""
        with self._lock:
            if doing and (not self.doings or self.doings[-1][1] != doing):
                self.doings.append((round(now, 2), doing))
            self._time_waits(now, laser_on, doing)
            if self._obstacle_gap is not None:
                self._watch_robot(now, np.array(place, dtype=float).reshape(1, 2))

    def _time_waits(self, now: float, laser_on: bool, doing: str) -> None:
        drawing = self.state == "border" and laser_on
        self._lit_since = (self._lit_since if self._lit_since is not None else now) if drawing else None
        holds = self.state == "border" and doing == "waits for the robot"
        self._holds_since = (self._holds_since if self._holds_since is not None else now) if holds else None
        if drawing:
            self._most("longest_unseen_s", now - max(self._seen_at, self._lit_since))
        if holds:
            self._most("longest_hold_s", now - self._holds_since)

    def _watch_robot(self, now: float, place: np.ndarray) -> None:
        figures = self.figures
        row, column = self._physical.world_to_cell(place)[0]
        clearance = float(self._obstacle_gap[row, column]) - self._radius
        figures["least_clearance_m"] = min(figures["least_clearance_m"], clearance)
        if self._border_gap is not None:
            gap = min(float(self._border_gap[row, column]) - self._radius, 0.0)
            # one that has left may not come back, one that was enclosed may not go deeper
            self._allowed_gap = gap if np.isinf(self._allowed_gap) else max(self._allowed_gap, gap)
            self._most("border_entered_m", self._allowed_gap - gap)
        if self._before is not None and now > self._before[0]:
            step = float(np.linalg.norm(place - self._before[1]))
            figures["way_m"] += step
            self._most("max_speed_m_s", step / (now - self._before[0]))
            if self.state == "guide" or (self._guided_method and self.state in ("border", "seed")):
                self._most("max_guided_speed_m_s", step / (now - self._before[0]))
        self._before = (now, place)

    def _most(self, key: str, value: float) -> None:
        self.figures[key] = max(self.figures[key], value)

    def result(self, cell: float) -> dict:
        """Figures and which rules were broken; places are known to a cell [m]."""
        f = self.figures
        rules = {
            "no border came out": self.outcome != "saved",
            "collision": f["least_clearance_m"] < -cell,
            "border entered": f["border_entered_m"] > 2.0 * cell,
            "too fast while guided": f["max_guided_speed_m_s"] > GUIDED_SPEED + SPEED_TOLERANCE,
            "too fast": f["max_speed_m_s"] > DRIVEN_SPEED + SPEED_TOLERANCE,
            f"the person waited more than {WAIT_GOAL_S:g} s": f["longest_hold_s"] > WAIT_GOAL_S,
        }
        figures = {key: round(value, 4) if np.isfinite(value) else None for key, value in f.items()}
        return {
            **figures,
            "outcome": self.outcome,
            "breaches": [rule for rule, broken in rules.items() if broken],
            "person": self.doings,
        }


# ----------------------------------------------------------------- in one process
def run_here(study, scenario: str, method: str, seed: int) -> dict:
    """Performs one run in one process; the seed is the participant's number."""
    began = time.monotonic()
    run = LiveRun(study, RunTask(seed, scenario, method))
    judge = Judge(study.world.robots[0].radius, method == "robot_only")
    goals_after = []

    def go_on() -> None:
        """What becomes of goals on either side of the border, and of one in the area it restricts."""
        proof = run.scenario.proof
        client = actionlib.SimpleActionClient("/move_base", MoveBaseAction)
        while client.action_client.last_status_msg is None:
            rospy.sleep(0.1)
        for place in [proof.start[:2], proof.goal[:2], run.scenario.seed]:
            goal = MoveBaseGoal()
            goal.target_pose.header.frame_id = names.MAP_FRAME
            goal.target_pose.pose = message_from_pose2d(float(place[0]), float(place[1]), 0.0)
            client.send_goal_and_wait(goal, rospy.Duration(GOAL_S), rospy.Duration(2.0))
            goals_after.append(GoalStatus.to_string(client.get_state()))

    result = run.run(lambda: watch(judge), go_on)
    judge.outcome = result.outcome or "time is up"
    figures = judge.result(study.world.room.resolution)
    if result.collisions and "collision" not in figures["breaches"]:
        figures["breaches"].append("collision")
    return {
        "scenario": scenario,
        "method": method,
        "seed": seed,
        **figures,
        "goals": result.goals,
        "goals_after": goals_after if result.saved else [],
        "tries": result.tries,
        "wall_s": round(time.monotonic() - began, 1),
    }


def watch(judge: Judge) -> list:
    """Subscribes a judge to what it judges by."""

    def on_map(message: OccupancyGridArray, which: str) -> None:
        judge.set_maps(**{which: grid_from_message(message)})

    def on_lab(message: LabState) -> None:
        if message.robot_poses:
            pose = message.robot_poses[0]
            judge.step(message.header.stamp.to_sec(), (pose.x, pose.y), message.laser_on, message.participant_doing)

    return [
        rospy.Subscriber(names.PHYSICAL_MAP, OccupancyGridArray, on_map, "physical"),
        rospy.Subscriber(names.MAP_WITH_BORDERS, OccupancyGridArray, on_map, "map_with_borders"),
        rospy.Subscriber(names.STATE, InteractionState, lambda m: setattr(judge, "state", m.name)),
        rospy.Subscriber(names.SPOTS, LaserSpot, lambda m: judge.spot_seen(m.header.stamp.to_sec())),
        rospy.Subscriber(names.LAB_STATE, LabState, on_lab),
    ]


# ----------------------------------------------------------------- over ROS
def run_ros(world_path: Path, scenario: str, method: str, seed: int, log: Path, record: bool) -> dict:
    """Performs one run through ROS. To be called once per process: rospy takes one node name."""
    world = load_world(str(world_path))
    cameras = [camera.name for camera in world.cameras] if method == "nrs" else []
    judge = Judge(world.robots[0].radius, method == "robot_only")
    detectors, seen = set(), {"lab": 0}
    state, port = tempfile.mkdtemp(prefix="robot_runs"), free_port()
    os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{port}"
    environment = {
        **os.environ,
        "ROS_LOG_DIR": str(log / "ros"),
        "ROSCONSOLE_FORMAT": "[${severity}] [${time}] [${node}]: ${message}",
    }

    def on_detector(message: DetectorStatus) -> None:
        if message.processed:
            detectors.add(message.camera)

    def on_lab(_message: LabState) -> None:
        seen["lab"] += 1

    task = {"world": world_path, "method": method, "seed": seed}
    launched = roslaunch(
        [TOP / "launch" / "simulation.launch"],
        log / "roslaunch.txt",
        port,
        environment,
        **task,
        cameras=" ".join(cameras) or "none",
        state=state,
        rviz=False,
        page=False,
    )
    person = bag = None
    try:
        if not wait_until(rosgraph.is_master_online, READY_S):
            raise CodedError("not_ready", "the ROS master did not come up")
        rospy.init_node("robot_runs", anonymous=True, disable_signals=True, log_level=rospy.ERROR)
        subscribers = [
            *watch(judge),
            rospy.Subscriber(names.LAB_STATE, LabState, on_lab),
            rospy.Subscriber(
                names.PARTICIPANT_DONE,
                String,
                lambda m: setattr(judge, "outcome", json.loads(m.data).get("outcome", "")),
            ),
            rospy.Subscriber(names.DETECTORS, DetectorStatus, on_detector),
        ]
        if not wait_until(lambda: detectors >= set(cameras) | {"robot"} and seen["lab"] > 0, READY_S):
            raise CodedError("not_ready", f"not all detectors came up, only {sorted(detectors)}; see {log}")
        if record:
            bag = Child(["rosbag", "record", "-O", str(log / "run.bag"), *BAG_TOPICS], log / "rosbag.txt", environment)
        file = TOP / "launch" / "parts" / "participant.launch"
        person = roslaunch([file], log / "participant.txt", port, environment, **task, scenario=scenario)
        wait_until(lambda: judge.outcome or not launched.running, RUN_S)
        until = rospy.get_time() + AFTER_S  # a robot that the border enclosed leaves it now
        wait_until(lambda: rospy.get_time() >= until, 30.0)
        for subscriber in subscribers:
            subscriber.unregister()
    finally:
        for child in (bag, person, launched):
            if child is not None:
                child.stop()
        shutil.rmtree(state, ignore_errors=True)
    return {"scenario": scenario, "method": method, "seed": seed, **judge.result(world.room.resolution)}


def in_child(world: Path, scenario: str, method: str, seed: int, folder: Path, record: bool) -> dict:
    """Performs a run over ROS in a forked process, since a process can be one ROS node only."""
    log = folder / f"{scenario}_{method}_{seed}"
    log.mkdir(parents=True, exist_ok=True)
    result = log / "run.json"
    result.unlink(missing_ok=True)
    child = os.fork()
    if child == 0:
        status = 1
        try:
            result.write_text(json.dumps(run_ros(world, scenario, method, seed, log, record)))
            status = 0
        except CodedError as error:
            print(error, file=sys.stderr)
        finally:
            os._exit(status)
    os.waitpid(child, 0)
    if not result.exists():
        return {
            "scenario": scenario,
            "method": method,
            "seed": seed,
            "breaches": ["no border came out: the run failed"],
            "longest_hold_s": 0.0,
            "longest_unseen_s": 0.0,
            "least_clearance_m": 0.0,
        }
    return json.loads(result.read_text())


# ----------------------------------------------------------------- all of them
def summarize(runs: list) -> str:
    """Makes a table with one line per scenario and method."""
    lines = [
        f"{'scenario':9} {'method':10} {'runs':>4} {'saved':>5} {'collisions':>10} {'entries':>7} {'too fast':>8} "
        f"{'hold median':>11} {'hold max':>8} {'unseen max':>10} {'clearance':>9}"
    ]
    for scenario, method in sorted({(run["scenario"], run["method"]) for run in runs}):
        group = [run for run in runs if (run["scenario"], run["method"]) == (scenario, method)]

        def count(word: str) -> int:
            return sum(any(word in breach for breach in run["breaches"]) for run in group)

        holds = [run["longest_hold_s"] for run in group]
        lines.append(
            f"{scenario:9} {method:10} {len(group):4d} {len(group) - count('no border'):5d} {count('collision'):10d} "
            f"{count('entered'):7d} {count('too fast'):8d} "
            f"{np.median(holds):9.1f} s {max(holds):6.1f} s "
            f"{max(run['longest_unseen_s'] for run in group):8.1f} s "
            f"{min(run['least_clearance_m'] for run in group):7.3f} m"
        )
    return "\n".join(lines)


def page(runs: list) -> str:
    """Writes the table with what made it, and every run that broke a rule."""
    keys = {
        key: " ".join(str(value) for value in sorted({run[key] for run in runs}))
        for key in ("scenario", "method", "seed")
    }
    command = f"bench/robots/runs.py --scenarios {keys['scenario']} --methods {keys['method']} --seeds {keys['seed']}"
    lines = [
        "# Simulated people and a robot",
        "",
        f"`python3 {command}`, {time.strftime('%Y-%m-%d', time.gmtime())}, "
        f"revision {revision()}. *Hold*: the longest time that a person waited for the robot while drawing.",
        "",
        "```",
        summarize(runs),
        "```",
        "",
        "Longest hold of each run, in order of its seed [s]:",
        "",
    ]
    for scenario, method in sorted({(run["scenario"], run["method"]) for run in runs}):
        group = sorted(
            (run for run in runs if (run["scenario"], run["method"]) == (scenario, method)), key=lambda run: run["seed"]
        )
        lines.append(
            f"- {scenario}, {method}: " + ", ".join(f"{run['seed']}: {run['longest_hold_s']:.1f}" for run in group)
        )
    lines += ["", "Rules broken:", ""]
    lines += [
        f"- {run['scenario']}, {run['method']}, seed {run['seed']}: {'; '.join(run['breaches'])}"
        for run in runs
        if run["breaches"]
    ] or ["- none"]
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenarios", nargs="+", default=["room", "carpet", "corner"])
    parser.add_argument("--methods", nargs="+", default=["nrs", "robot_only"], choices=["nrs", "robot_only"])
    parser.add_argument("--seeds", nargs="+", type=int, default=list(range(1, 21)))
    parser.add_argument("--ros", action="store_true", help="over ROS, with all nodes")
    parser.add_argument("--world", type=Path, default=TOP / "src" / "vb_sim" / "worlds" / "lab.yaml", help="with --ros")
    parser.add_argument("--record", action="store_true", help="with --ros: a bag of each run, some 300 MB")
    parser.add_argument("--out", type=Path, help="the file of results")
    parser.add_argument("--resume", action="store_true", help="keep the runs that the file has")
    parser.add_argument("--only-print", action="store_true", help="the table of the runs that the file has")
    parser.add_argument("--table", action="store_true", help="write the table of results")
    arguments = parser.parse_args()
    out = arguments.out or TOP / "out" / "bench" / ("robot_runs_ros.json" if arguments.ros else "robot_runs.json")
    runs = json.loads(out.read_text()) if (arguments.resume or arguments.only_print) and out.exists() else []
    out.parent.mkdir(parents=True, exist_ok=True)
    study = config.load()
    todo = itertools.product(arguments.scenarios, arguments.methods, arguments.seeds)
    done = {(run["scenario"], run["method"], run["seed"]) for run in runs}
    for task in [task for task in todo if task not in done and not arguments.only_print]:
        if arguments.ros:
            runs.append(in_child(arguments.world.resolve(), *task, out.with_suffix(""), arguments.record))
        else:
            runs.append(run_here(study, *task))
        out.write_text(json.dumps(runs, indent=1) + "\n")
        print({key: value for key, value in runs[-1].items() if key != "person"}, flush=True)
    if not runs:
        print("no runs")
        return 1
    print(summarize(runs))
    if arguments.table:
        (TOP / "docs" / "results" / "robots" / "runs.md").write_text(page(runs))
    return int(any(run["breaches"] for run in runs))


if __name__ == "__main__":
    sys.exit(main())
