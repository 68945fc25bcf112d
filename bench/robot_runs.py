#!/usr/bin/env python3
"""Robots over many interactions: collisions, borders entered, speed, waiting at the hand-over.

    python3 bench/robot_runs.py                                      every scenario and method, 20 seeds: about 3 h
    python3 bench/robot_runs.py --scenarios corner --methods nrs --seeds 1 2 3
    python3 bench/robot_runs.py --resume                             only the runs that are missing in the file

Each run starts the whole simulated system, from camera images to the saved border, with roslaunch under a master of
its own. The judge sees the lab's ground truth 50 times a second, none of what the robot believes. Leaves
out/bench/robot_runs.json, one entry per run; bad runs stay in it. Exits non-zero if a run broke a rule.
"""
import argparse
import json
import os
import shutil
import sys
import tempfile
import threading
from pathlib import Path

import numpy as np
import rosgraph
import rospy
from std_msgs.msg import String

from vb_core import names
from vb_core.errors import CodedError
from vb_core.grid_map import distance_to
from vb_core.ros.messages import OccupancyGridArray, grid_from_message
from vb_evaluation.observer import wait_until
from vb_evaluation.processes import Child, free_port
from vb_msgs.msg import DetectorStatus, InteractionState, LabState, LaserSpot
from vb_sim.world import load_world

TOP = Path(__file__).resolve().parent.parent
GUIDED_SPEED = 0.2  # [m/s] while a person leads the robot or draws with it alone
DRIVEN_SPEED = 0.5  # [m/s] under navigation
SPEED_TOLERANCE = 0.005  # [m/s] controllers differentiate poses too
WAIT_GOAL_S = 10.0
READY_S, RUN_S, AFTER_S = 90.0, 600.0, 6.0


class Judge:
    """Watches one run and keeps what it is judged by. Fed from several threads."""

    def __init__(self, radius: float, guided: bool) -> None:
        self._radius = radius
        self._guided_method = guided
        self._lock = threading.Lock()
        self._physical = self._posterior = None
        self._obstacle_gap = self._border_gap = None
        self._before = None
        self._allowed_gap = np.inf
        self._state = "default"
        self._seen_at = -np.inf
        self._lit_since = None
        self._waits_since = None
        self.detectors = set()
        self.lab_states = 0
        self.outcome = None
        self.events = []
        self.figures = {
            "least_clearance_m": np.inf, "least_border_gap_m": np.inf, "border_entered_m": 0.0, "max_guided_speed_m_s": 0.0,
            "max_speed_m_s": 0.0, "longest_hold_s": 0.0, "longest_unseen_s": 0.0, "way_m": 0.0,
        }

    def on_map(self, message, which: str) -> None:
        grid = grid_from_message(message)
        with self._lock:
            if which == "physical":
                self._physical = grid
                self._obstacle_gap = distance_to(grid.data >= 65) * grid.resolution
            else:
                self._posterior = grid
            if self._physical is None or self._posterior is None:
                return
            restricted = self._posterior.data > np.maximum(self._physical.data, 0)
            self._border_gap = distance_to(restricted) * self._physical.resolution if restricted.any() else None
            # a border may be put where the robot stands: from then on it must not go deeper
            self._allowed_gap = np.inf

    def on_state(self, message: InteractionState) -> None:
        with self._lock:
            self._state = message.name

    def on_spot(self, message: LaserSpot) -> None:
        with self._lock:
            self._seen_at = max(self._seen_at, message.header.stamp.to_sec())

    def on_done(self, message: String) -> None:
        self.outcome = json.loads(message.data)

    def on_lab(self, message: LabState) -> None:
        now = message.header.stamp.to_sec()
        with self._lock:
            self.lab_states += 1
            self._time_waits(now, message)
            if message.participant_doing and (not self.events or self.events[-1][1] != message.participant_doing):
                self.events.append((round(now, 2), message.participant_doing))
            if message.robot_poses and self._obstacle_gap is not None:
                self._watch_robot(now, message.robot_poses[0])

    def _time_waits(self, now: float, message: LabState) -> None:
        drawing = self._state == "border" and message.laser_on
        self._lit_since = (self._lit_since if self._lit_since is not None else now) if drawing else None
        unseen = now - max(self._seen_at, self._lit_since) if drawing else 0.0
        holds = self._state == "border" and message.participant_doing == "waits for the robot"
        self._waits_since = (self._waits_since if self._waits_since is not None else now) if holds else None
        hold = now - self._waits_since if holds else 0.0
        self.figures["longest_unseen_s"] = max(self.figures["longest_unseen_s"], unseen)
        self.figures["longest_hold_s"] = max(self.figures["longest_hold_s"], hold)

    def _watch_robot(self, now: float, pose) -> None:
        figures, place = self.figures, np.array([[pose.x, pose.y]])
        row, column = self._physical.world_to_cell(place)[0]
        figures["least_clearance_m"] = min(figures["least_clearance_m"], float(self._obstacle_gap[row, column]) - self._radius)
        if self._border_gap is not None:
            gap = float(self._border_gap[row, column]) - self._radius
            figures["least_border_gap_m"] = min(figures["least_border_gap_m"], gap)
            # how much nearer than it ever was allowed to be; a robot that has left may not come back
            self._allowed_gap = min(gap, 0.0) if np.isinf(self._allowed_gap) else max(self._allowed_gap, min(gap, 0.0))
            figures["border_entered_m"] = max(figures["border_entered_m"], self._allowed_gap - gap)
        if self._before is not None and now > self._before[0]:
            step = float(np.linalg.norm(place[0] - self._before[1]))
            speed = step / (now - self._before[0])
            figures["way_m"] += step
            figures["max_speed_m_s"] = max(figures["max_speed_m_s"], speed)
            if self._state == "guide" or (self._guided_method and self._state in ("border", "seed")):
                figures["max_guided_speed_m_s"] = max(figures["max_guided_speed_m_s"], speed)
        self._before = (now, place[0])

    def breaches(self, cell: float) -> list:
        """Which rules were broken; places are known to a cell [m]."""
        f = self.figures
        rules = {
            "no border came out": not self.outcome or self.outcome.get("outcome") != "saved",
            "collision": f["least_clearance_m"] < -cell,
            "border entered": f["border_entered_m"] > 2.0 * cell,
            "too fast while guided": f["max_guided_speed_m_s"] > GUIDED_SPEED + SPEED_TOLERANCE,
            "too fast": f["max_speed_m_s"] > DRIVEN_SPEED + SPEED_TOLERANCE,
            f"the person waited more than {WAIT_GOAL_S:g} s": f["longest_hold_s"] > WAIT_GOAL_S,
        }
        return [rule for rule, broken in rules.items() if broken]


BAG_TOPICS = [names.SPOTS, names.LAB_STATE, names.STATE, names.PROGRESS, names.DETECTORS, "/tf", "/tf_static",
              "/robot_dispatcher/viewpoint", "/spot_detector_robot/debug_image"]


def run_ros(world_path: Path, scenario: str, method: str, seed: int, log: Path, record: bool = False) -> dict:
    """One run through ROS. To be called once per process: rospy takes one node name."""
    world = load_world(str(world_path))
    cameras = [camera.name for camera in world.cameras] if method == "nrs" else []
    judge = Judge(world.robots[0].radius, method == "robot_only")
    state, port = tempfile.mkdtemp(prefix="robot_runs"), free_port()
    os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{port}"
    environment = {**os.environ, "ROS_LOG_DIR": str(log / "ros"),
                   "ROSCONSOLE_FORMAT": "[${severity}] [${time}] [${node}]: ${message}"}
    launched = Child(
        ["roslaunch", "-p", str(port), str(TOP / "launch" / "simulation.launch"), f"world:={world_path}", f"seed:={seed}",
         f"cameras:={' '.join(cameras) or 'none'}", f"method:={method}", f"state:={state}", "rviz:=false"],
        log / "roslaunch.txt", environment)
    person = bag = None
    try:
        if not wait_until(rosgraph.is_master_online, READY_S):
            raise CodedError("not_ready", "the ROS master did not come up")
        rospy.init_node("robot_runs", anonymous=True, disable_signals=True, log_level=rospy.ERROR)
        subscribers = [
            rospy.Subscriber(names.PHYSICAL_MAP, OccupancyGridArray, judge.on_map, "physical"),
            rospy.Subscriber(names.VIRTUAL_MAP, OccupancyGridArray, judge.on_map, "posterior"),
            rospy.Subscriber(names.STATE, InteractionState, judge.on_state),
            rospy.Subscriber(names.SPOTS, LaserSpot, judge.on_spot),
            rospy.Subscriber(names.LAB_STATE, LabState, judge.on_lab),
            rospy.Subscriber(names.PARTICIPANT_DONE, String, judge.on_done),
            rospy.Subscriber(names.DETECTORS, DetectorStatus,
                             lambda m: judge.detectors.add(m.camera) if m.processed else None),
        ]
        wanted = set(cameras) | {"robot"}
        if not wait_until(lambda: judge.detectors >= wanted and judge._border_gap is None and judge.lab_states, READY_S):
            raise CodedError("not_ready", f"not all detectors came up, only {sorted(judge.detectors)}; see {log}")
        if record:
            bag = Child(["rosbag", "record", "-O", str(log / "run.bag"), *BAG_TOPICS], log / "rosbag.txt", environment)
        person = Child(
            ["roslaunch", "-p", str(port), str(TOP / "launch" / "parts" / "participant.launch"), f"world:={world_path}",
             f"scenario:={scenario}", f"method:={method}", f"seed:={seed}"], log / "participant.txt", environment)
        wait_until(lambda: judge.outcome is not None or not launched.running, RUN_S)
        until = rospy.get_time() + AFTER_S
        wait_until(lambda: rospy.get_time() >= until, 30.0)
        for subscriber in subscribers:
            subscriber.unregister()
    finally:
        for child in (bag, person, launched):
            if child is not None:
                child.stop()
        shutil.rmtree(state, ignore_errors=True)
    figures = {key: round(value, 4) if np.isfinite(value) else None for key, value in judge.figures.items()}
    return {"scenario": scenario, "method": method, "seed": seed, **figures, "outcome": judge.outcome,
            "breaches": judge.breaches(world.room.resolution), "participant": judge.events}


def summarise(runs: list) -> str:
    """A table with one line per scenario and method."""
    lines = [f"{'scenario':9} {'method':10} {'runs':>4} {'saved':>5} {'collisions':>10} {'entries':>7} {'too fast':>8} "
             f"{'hold median':>11} {'hold max':>8} {'unseen max':>10} {'clearance':>9}"]
    for scenario, method in sorted({(run["scenario"], run["method"]) for run in runs}):
        group = [run for run in runs if (run["scenario"], run["method"]) == (scenario, method)]

        def count(word: str) -> int:
            return sum(any(word in breach for breach in run["breaches"]) for run in group)

        holds = [run["longest_hold_s"] for run in group]
        lines.append(
            f"{scenario:9} {method:10} {len(group):4d} {len(group) - count('no border'):5d} {count('collision'):10d} "
            f"{count('entered'):7d} {count('too fast'):8d} {np.median(holds):9.1f} s {max(holds):6.1f} s "
            f"{max(run['longest_unseen_s'] for run in group):8.1f} s {min(run['least_clearance_m'] for run in group):7.3f} m")
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--world", type=Path, default=TOP / "src" / "vb_sim" / "worlds" / "lab.yaml")
    parser.add_argument("--scenarios", nargs="+", default=["room", "carpet", "corner"])
    parser.add_argument("--methods", nargs="+", default=["nrs", "robot_only"], choices=["nrs", "robot_only"])
    parser.add_argument("--seeds", nargs="+", type=int, default=list(range(1, 21)))
    parser.add_argument("--out", type=Path, default=TOP / "out" / "bench" / "robot_runs.json")
    parser.add_argument("--resume", action="store_true", help="keep the runs that the file has")
    parser.add_argument("--record", action="store_true", help="a bag of each run beside its log, some 300 MB")
    parser.add_argument("--only-print", action="store_true", help="the table of the runs that the file has")
    arguments = parser.parse_args()
    runs = json.loads(arguments.out.read_text()) if (arguments.resume or arguments.only_print) and arguments.out.exists() else []
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    for scenario in arguments.scenarios if not arguments.only_print else []:
        for method in arguments.methods:
            for seed in arguments.seeds:
                if any((run["scenario"], run["method"], run["seed"]) == (scenario, method, seed) for run in runs):
                    continue
                runs.append(in_child(arguments.world.resolve(), scenario, method, seed, arguments.out.with_suffix(""), arguments.record))
                arguments.out.write_text(json.dumps(runs, indent=1) + "\n")
                print({key: value for key, value in runs[-1].items() if key != "participant"}, flush=True)
    if not runs:
        print("no runs")
        return 1
    print(summarise(runs))
    return int(any(run["breaches"] for run in runs))


def in_child(world: Path, scenario: str, method: str, seed: int, folder: Path, record: bool) -> dict:
    """A run in a forked process, since a process can be one ROS node only."""
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
        return {"scenario": scenario, "method": method, "seed": seed, "breaches": ["no border came out: the run failed"],
                "longest_hold_s": 0.0, "longest_unseen_s": 0.0, "least_clearance_m": 0.0}
    return json.loads(result.read_text())


if __name__ == "__main__":
    sys.exit(main())
