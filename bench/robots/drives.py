#!/usr/bin/env python3
"""Drives with the real move_base: round each scenario's border, into it, and with a border put before the nose.

    make navigation                                                     once
    python3 bench/robots/drives.py --robot turtlebot2                    all that is missing in its file
    python3 bench/robots/drives.py --robot turtlebot2 --seconds 200      for at most about that long, then go on later
    python3 bench/robots/drives.py --repeat 1 --drives 10                For a comparison: ten drives, the same once more
    python3 bench/robots/drives.py --repeat 2 --drives 10                (--repeat 2), and in real time on a quiet computer.
    python3 bench/robots/drives.py --real-time --drives 10               They do not count in the table of all drives.

A robot type drives in the simulated lab (no cameras, no display) with move_base and AMCL as they are shipped here,
through its driver. The judge sees where the robot truly is. Goals are drawn by a seed: in each scenario a chain of
places chosen so that, where possible, the straight line from one to the next crosses the border's area, driven
forth and back, so that both directions come up.

The idea: simulated time waits for those who drive and for AMCL (the simulator's ~lockstep), so that it runs as
fast as this computer allows, and a busy one makes drives last longer without changing them. What would change
them is a cycle that move_base
misses: each drive's row says how many it reported. A border is put before the nose while time runs slowly, because the
services that put it there take real time; the row says how much simulated time that was.

Writes each drive to out/bench/robot_drives/, and the tables of all of them to docs/results/robots/navigation.md.
"""

import argparse
import functools
import itertools
import json
import math
import os
import sys
import tempfile
import threading
import time
from collections import deque
from pathlib import Path

import numpy as np
import rosgraph
import rospy
import yaml
from geometry_msgs.msg import PoseWithCovarianceStamped
from rosgraph_msgs.msg import Log
from scipy.spatial.distance import directed_hausdorff
from std_msgs.msg import Float64

from vb_core import names
from vb_core.errors import CodedError
from vb_core.grid_map import distance_to
from vb_core.ros import messages
from vb_core.ros.services import call
from vb_evaluation.goal_runs import GoalRunner
from vb_evaluation.observer import Observer, wait_until
from vb_evaluation.processes import free_port, roslaunch
from vb_evaluation.provenance import revision
from vb_evaluation.statistics import proportion
from vb_map_integration.border import VirtualBorder as Border
from vb_map_integration.integration import integrate
from vb_msgs.msg import DriverState, LabState, VirtualBorder
from vb_msgs.srv import AddBorder, AddBorderRequest, RemoveBorder, RemoveBorderRequest
from vb_robot.clearance_map import STOP_MARGIN, ClearanceMap, sample
from vb_robot.driving.workspace import PoseUncertainty
from vb_robot.navigation_parameters import PATH_MARGIN
from vb_sim.room.floor_plan import physical_map
from vb_sim.room.world import load_world

TOP = Path(__file__).resolve().parents[2]
OUT, TABLE = TOP / "out" / "bench" / "robot_drives", TOP / "docs" / "results" / "robots" / "navigation.md"
WORLDS = TOP / "src" / "vb_sim" / "worlds"
ROBOTS = ("turtlebot2", "turtlebot3_burger")
SCENARIOS = ("carpet", "corner", "room")
RADIUS = 0.18  # [m] of the larger robot: both drive to the same places
LIMIT_S = 120.0  # [s] of simulated time for one goal: 10 m at the slower robot's 0.2 m/s, twice
ROUNDS, NOSES = 40, 20  # goals round each border, and borders put before the nose
INSIDE = 2  # goals inside of each border
MIN_LEG = 0.6  # [m] between two places
FASTEST = 4.0  # simulated seconds per real second: more than two slow cores can do
SLOW = 0.5  # the same while a border is put before the nose
MISSED = "missed its desired rate"  # move_base's words, of its control loop and of its costmaps


class Pace:
    """How fast simulated time runs, and what move_base missed.

    Args:
        fastest: simulated seconds per real second, at most.
    """

    def __init__(self, fastest: float) -> None:
        self._fastest, self._missed = fastest, 0
        self._publisher = rospy.Publisher(names.PACE, Float64, queue_size=1, latch=True)
        self._subscriber = rospy.Subscriber("/rosout", Log, self._on_log, queue_size=100)
        self.hold(False)

    def _on_log(self, message: Log) -> None:
        self._missed += MISSED in message.msg

    def missed(self) -> int:
        """Returns how many cycles move_base has missed since this was asked last."""
        missed, self._missed = self._missed, 0
        return missed

    def hold(self, held: bool) -> None:
        """Lets simulated time run slowly, or as fast as it may."""
        self._publisher.publish(min(self._fastest, SLOW if held else self._fastest))


@functools.lru_cache(maxsize=None)
def places(scenario: str, seed: int):
    """Places (x, y, yaw) [m, m, deg]: a chain round a scenario's border, and places inside of what it restricts.

    A robot of RADIUS has as much room there as the dispatcher gives one, and a path leads from each to the next.
    """
    world = load_world(str(WORLDS / "lab.yaml"))
    what, grid = world.scenarios[scenario], physical_map(world)
    posterior = integrate(grid, Border(np.array(what.border), np.array(what.seed), 1.0, what.closed)).posterior
    restricted = posterior.data > np.maximum(grid.data, 0)
    rng = np.random.default_rng([seed, SCENARIOS.index(scenario)])
    clearance_map = ClearanceMap(posterior, RADIUS, travel_margin=PATH_MARGIN + 0.03)
    cells = posterior.cell_to_world(np.argwhere(clearance_map.clearance >= RADIUS + STOP_MARGIN))
    yaws = rng.integers(-180, 180, 1000)
    chain = [(*cells[rng.integers(len(cells))], 0)]
    if scenario == "corner":  # what is not restricted may have other parts, as behind furniture
        chain = [(6.8, 4.2, 0)]
    while len(chain) <= ROUNDS // 2:
        here = np.array(chain[-1][:2])
        drawn = cells[rng.integers(len(cells), size=300)]
        drawn = drawn[
            (np.linalg.norm(drawn - here, axis=1) >= MIN_LEG)
            & np.isfinite(clearance_map.shortest_paths(here).lengths_to(drawn))
        ]
        if not len(drawn):
            chain[-1] = (*cells[rng.integers(len(cells))], 0)  # a place that nothing leads to
            continue
        lines = here + np.linspace(0.0, 1.0, 100)[None, :, None] * (drawn - here)[:, None, :]
        through = sample(posterior, restricted, lines.reshape(-1, 2)).reshape(len(drawn), -1).any(axis=1)
        chain.append((*drawn[int(np.argmax(through))], int(yaws[len(chain)])))
    inside = posterior.cell_to_world(
        np.argwhere(restricted & (distance_to(~restricted) * posterior.resolution > RADIUS))
    )
    inside = [(*inside[rng.integers(len(inside))], 0) for _ in range(INSIDE)]
    return [tuple(float(round(value, 3)) for value in place) for place in (*chain, *inside)]


class Lab:
    """The running lab: borders, goals, and what truly happened."""

    def __init__(self, robot: str, start, folder: Path, fastest: float, seed: int, lockstep: bool) -> None:
        state = tempfile.mkdtemp(prefix="robot_drives")
        world = (
            yaml.safe_load((WORLDS / "burger.yaml").read_text())
            if robot == "turtlebot3_burger"
            else {"name": "lab", "robots": yaml.safe_load((WORLDS / "lab.yaml").read_text())["robots"]}
        )
        world["like"] = str(WORLDS / "lab.yaml")
        world["robots"][0]["start"] = [float(value) for value in start]
        path = Path(state) / "world.yaml"
        path.write_text(yaml.safe_dump(world))
        self.world = load_world(str(path))
        self.radius = self.world.robots[0].radius
        x, y, yaw = self.world.robots[0].start_pose()
        port = free_port()
        os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{port}"
        self.child = roslaunch(
            [Path(__file__).with_name("drives.launch")],
            folder / "roslaunch.txt",
            port,
            {**os.environ, "ROS_LOG_DIR": str(folder / "log")},
            world=path,
            state=state,
            robot_type=robot,
            amcl=True,
            seed=seed,
            lockstep=lockstep,
            x=x,
            y=y,
            yaw=yaw,
        )
        if not wait_until(rosgraph.is_master_online, 60.0):
            raise CodedError("not_ready", "no master")
        # before that this program would take wall time for the time of its node
        if not wait_until(lambda: rosgraph.Master("/robot_drives").hasParam("/use_sim_time"), 60.0):
            raise CodedError("not_ready", "roslaunch sets no parameters")
        rospy.init_node("robot_drives", anonymous=True, disable_signals=True, log_level=rospy.ERROR)
        self.observer, self.pace = Observer(), Pace(fastest)
        self.runner = GoalRunner()
        if not wait_until(lambda: self.observer.posterior is not None and self.observer.lab is not None, 60.0):
            raise CodedError("not_ready", f"no maps, see {folder}")
        # errors: with twice their standard deviation [m]
        self._truth, self._errors, self._late = (deque(maxlen=500), [], 0)
        self._subscribers = [
            rospy.Subscriber(names.LAB_STATE, LabState, self._on_lab),
            rospy.Subscriber("/amcl_pose", PoseWithCovarianceStamped, self._on_amcl),
            rospy.Subscriber(names.DRIVERS, DriverState, self._on_driver),
        ]

    def _on_lab(self, message) -> None:
        pose = message.robot_poses[0]
        self._truth.append((message.header.stamp.to_sec(), pose.x, pose.y))

    def _on_amcl(self, message) -> None:
        stamp, place = message.header.stamp.to_sec(), message.pose.pose.position
        truth = min(list(self._truth), key=lambda entry: abs(entry[0] - stamp), default=None)
        if truth is not None and abs(truth[0] - stamp) < 0.05:
            spread = np.linalg.eigvalsh(np.reshape(message.pose.covariance, (6, 6))[:2, :2])[-1]
            self._errors.append((math.dist((place.x, place.y), truth[1:]), 2.0 * math.sqrt(max(spread, 0.0))))

    def _on_driver(self, message) -> None:
        self._late += message.code.endswith("_lost") or message.code == "clock_stopped"

    def drive(self, goal):
        """Sends the robot to a goal; returns what was driven, and the row of results that all drives have."""
        self.pace.missed(), self._errors.clear()
        self._late, began = 0, time.monotonic()
        driven = self.runner.drive((goal[0], goal[1], math.radians(goal[2])), LIMIT_S)
        return driven, {
            "goal": goal,
            "outcome": driven.outcome,
            "false_reports": driven.false_reports,
            "text": driven.text,
            "length_m": round(driven.length, 2),
            "seconds": round(driven.seconds, 1),
            "wall_s": round(time.monotonic() - began, 1),
            "localised_m": round(max((error for error, _ in self._errors), default=math.nan), 3),
            "errors": np.round(self._errors, 3).tolist(),
            "missed": self.pace.missed(),
            "late": self._late,
            "path": np.round(driven.path[::5], 3).tolist(),
        }

    def pose(self):
        pose = self.observer.lab.robot_poses[0]
        return pose.x, pose.y, pose.theta

    def add(self, points, seed, closed) -> str:
        border = VirtualBorder(
            name="drive",
            kind=VirtualBorder.POLYGON if closed else VirtualBorder.SEPARATING_CURVE,
            occupancy=1.0,
            enabled=True,
            points=messages.points_from_array(np.array(points)),
        )
        border.seed = messages.points_from_array(np.array([seed]))[0]
        before = self.observer.posterior
        reply = call(names.ADD_BORDER, AddBorder, AddBorderRequest(border=border, source="bench"), "map_integrator")
        if not reply.success:
            raise CodedError(reply.code, reply.message)
        wait_until(lambda: self.observer.posterior is not before, 10.0)
        return reply.id

    def remove(self, border: str) -> None:
        before = self.observer.posterior
        call(names.REMOVE_BORDER, RemoveBorder, RemoveBorderRequest(id=border), "map_integrator")
        wait_until(lambda: self.observer.posterior is not before, 10.0)

    def entered(self, path) -> float:
        """Returns how deep [m] the footprint came into what borders restrict, beyond a cell's diagonal; 0 or less is fine."""
        prior, posterior = self.observer.prior, self.observer.posterior
        restricted = posterior.data > np.maximum(prior.data, 0)
        if not len(path) or not restricted.any():
            return -math.inf
        cells = prior.world_to_cell(path)
        gap = distance_to(restricted)[cells[:, 0], cells[:, 1]] * prior.resolution
        return float(self.radius - gap.min() - 1.5 * prior.resolution)


def tasks(seed: int):
    """Lists what is to be driven: (kind, scenario, number, from, to). In turns, so that each part tells of all."""
    for begin in range(0, ROUNDS, 10):
        for scenario in SCENARIOS:
            chain, inside = places(scenario, seed)[:-INSIDE], places(scenario, seed)[-INSIDE:]
            both = chain + chain[-2::-1]
            yield from (("round", scenario, i, both[i], both[i + 1]) for i in range(begin, begin + 10))
            if begin == 0:
                yield from (("inside", scenario, i, both[10], goal) for i, goal in enumerate(inside))
        share = NOSES * 10 // ROUNDS
        yield from (
            ("nose", "", i, (7.0, 0.9, 180), None) for i in range(begin // 10 * share, (begin // 10 + 1) * share)
        )


def drive_scenario(lab, scenario, todo, keep) -> None:
    """Brings the robot to where the first drive begins, adds the border, drives."""
    what, start = lab.world.scenarios[scenario], todo[0][3]
    if math.dist(lab.pose()[:2], start[:2]) > 0.2:
        lab.drive(start)
    border = lab.add(what.border, what.seed, what.closed)
    try:
        for kind, _, number, _, goal in todo:
            driven, row = lab.drive(goal)
            keep(
                {
                    "kind": kind,
                    "scenario": scenario,
                    "number": number,
                    **row,
                    "entered_m": round(lab.entered(driven.path), 3),
                }
            )
    finally:
        lab.remove(border)


def drive_nose(lab, number, seed, keep) -> None:
    """Measures a border drawn across the path of a robot under way, 0.25 to 0.6 m before its nose."""
    rng = np.random.default_rng([seed, 1000 + number])
    ends = [(7.0, 0.9, 180), (1.6, 1.6, 0)]
    here = lab.pose()
    goal = max(ends, key=lambda end: math.dist(end[:2], here[:2]))
    gap, driven_before = float(rng.uniform(0.25, 0.6)), float(rng.uniform(1.0, 3.0))
    put = {}

    def watch():
        start = lab.pose()
        try:
            if not wait_until(lambda: math.dist(lab.pose()[:2], start[:2]) > driven_before, 120.0, 0.02):
                return
            x, y, yaw = lab.pose()
            ahead, half = lab.radius + gap, 0.3
            along = half * np.array([math.cos(yaw), math.sin(yaw)])
            across = half * np.array([-math.sin(yaw), math.cos(yaw)])
            middle = np.array([x, y]) + (ahead + half) / half * along
            corners = [
                middle - along - across,
                middle + along - across,
                middle + along + across,
                middle - along + across,
            ]
            called = rospy.get_time()
            put["id"] = lab.add(corners, middle, True)
            put["at"], put["after_s"], until = (x, y), round(rospy.get_time() - called, 2), rospy.get_time() + 3.0
            wait_until(lambda: rospy.get_time() > until, 60.0)
        except CodedError as error:
            put["error"] = error.code
        finally:
            lab.pace.hold(False)

    lab.pace.hold(True)
    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    driven, row = lab.drive(goal)
    thread.join(130.0)
    path = driven.path
    if "at" in put and len(path):
        path = path[int(np.argmin(np.linalg.norm(path - put["at"], axis=1))) :]
    keep(
        {
            "kind": "nose",
            "scenario": "",
            "number": number,
            **row,
            "gap_m": round(gap, 2),
            "after_s": put.get("after_s"),
            "border": put.get("error", "added" if "id" in put else "none"),
            "entered_m": round(lab.entered(path), 3) if "id" in put else None,
        }
    )
    if "id" in put:
        lab.remove(put["id"])


def _interval(good: int, count: int) -> str:
    if not count:
        return "-"
    share = proportion(good, count)
    return f"{100 * share.low:.0f} to {100 * share.high:.0f} %"


WANTED = {"round": ("reached",), "inside": ("refused",), "nose": ("reached", "refused", "time_is_up")}
TITLES = {"round": "past the border", "inside": "into it", "nose": "border put before the nose"}


def table(every) -> str:
    """Writes the results as Markdown."""
    runs = [run for run in every if run.get("lockstep", True) and not run.get("repeat")]
    lines = [
        "# Driving with the real move_base",
        "",
        f"`python3 bench/robots/drives.py --robot ...`, {time.strftime('%Y-%m-%d', time.gmtime())}; goals by seeds, of which "
        "each belongs to other code, see the revisions. ros-planning/navigation at 9ad6441 with AMCL, "
        "parameters of `vb_bringup/config/navigation` and the robot's profile, through `robot_driver`; simulated lab, "
        "truth judged. As wanted: reached; into a border: refused; before the nose: not entered. *Entered*: the footprint "
        "more than one and a half cells inside of what a border restricts; *deepest*: by how much, negative: by how much it "
        "was missed. From seed 14 on a goal counts as reached only if the robot is truly within 0.5 m of it. Seeds up to "
        "5: before robots kept off borders by what the localisation may be off. *Pace*: simulated seconds "
        "per real second, in "
        "the mean. *Missed*: control or costmap cycles that move_base reported as late, per simulated minute. "
        "*Late*: reports of the driver that an input was too old.",
        "",
        "| seed | revisions | robot | drives | scenario | done | as wanted | 95 % interval of that | entered | deepest | "
        "localisation off, at most | median time | longest | pace | missed | late |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for key in sorted({(run["seed"], run["robot"], run["kind"], run["scenario"]) for run in runs}):
        seed, robot, kind, scenario = key
        group = [run for run in runs if (run["seed"], run["robot"], run["kind"], run["scenario"]) == key]
        counted = [run for run in group if kind != "nose" or run["border"] == "added"]
        good = sum(_as_wanted(run) for run in counted)
        entered = sum((run["entered_m"] or -1.0) > 0.0 for run in counted)
        seconds = [run["seconds"] for run in counted] or [0.0]
        off = max([run["localised_m"] for run in counted if run["localised_m"] > 0] or [0.0])
        revisions = ", ".join(sorted({run["revision"] for run in group}))
        lines.append(
            f"| {seed} | {revisions} | {robot} | {TITLES[kind]} | {scenario or '-'} | {len(counted)} | {good} | "
            f"{_interval(good, len(counted))} | {entered} | "
            f"{1000 * max(run['entered_m'] for run in counted):.0f} mm | {off:.2f} m | {np.median(seconds):.0f} s | {max(seconds):.0f} s | "
            f"{sum(seconds) / max(sum(run['wall_s'] for run in counted), 1e-9):.2f} | "
            f"{sum(run['missed'] for run in counted) / max(sum(seconds) / 60.0, 1e-9):.2f} | "
            f"{sum(run['late'] for run in counted)} |"
        )
    bad = [run for run in runs if not _as_wanted(run)]
    lines += ["", "Not as wanted:" if bad else "Every drive went as wanted.", ""]
    lines += [
        f"- seed {run['seed']}, {run['robot']}, {run['kind']} {run['scenario']} {run['number']}, goal "
        f"{tuple(run['goal'])}: {run['outcome']} after {run['seconds']:.0f} s, {run['length_m']:.1f} m, entered "
        f"{run['entered_m']} m, {run.get('border', '')} {run['text']}"
        for run in bad
    ]
    noses = [run for run in runs if run["kind"] == "nose" and run["border"] == "added"]
    if noses:
        lines += [
            "",
            "Before the nose: "
            + ", ".join(f"{sum(run['outcome'] == outcome for run in noses)} {outcome}" for outcome in WANTED["nose"])
            + ".",
        ]
    return "\n".join(lines + localization(runs) + comparison(every)) + "\n"


def localization(runs):
    """Lines: how far off AMCL was, how far its particles were spread, and how often what robots keep off was enough."""
    runs = [run for run in runs if run.get("errors")]
    if not runs:
        return []
    enough = []
    for run in runs:
        uncertainty = PoseUncertainty()
        for error, spread in run["errors"]:
            uncertainty.add(np.eye(2) * (0.5 * spread) ** 2)
            enough.append(error <= uncertainty.meters)
    errors, spreads = np.vstack([run["errors"] for run in runs]).T
    share = proportion(sum(enough), len(enough))
    return [
        "",
        "## The localisation",
        "",
        f"{len(enough)} updates of AMCL in {len(runs)} drives of the seeds {sorted({run['seed'] for run in runs})}. Its pose was off by "
        f"{np.median(errors):.3f} m in the median, {np.quantile(errors, 0.95):.3f} m at 95 %, {errors.max():.3f} m at most; the "
        f"standard deviation of its particles was {np.median(spreads) / 2:.3f} m in the median. What robots keep off borders "
        f"was enough in {100 * sum(enough) / len(enough):.1f} % (95 % interval {100 * share.low:.1f} to {100 * share.high:.1f} %, as if "
        "updates were independent).",
    ]


def comparison(runs):
    """Lines: the same drives in lockstep, in lockstep once more, and in real time."""
    drives = {}
    for run in runs:
        if "path" in run and len(run["path"]) > 1:
            way = {(True, 1): "lockstep", (True, 2): "again", (False, 0): "real time"}.get(
                (run["lockstep"], run["repeat"])
            )
            drives.setdefault((run["robot"], run["kind"], run["scenario"], run["number"], run["seed"]), {})[way] = run
    ways = ("lockstep", "again", "real time")
    drives = {key: found for key, found in drives.items() if all(way in found for way in ways)}
    if not drives:
        return []
    lines = [
        "",
        "## Lockstep and real time",
        "",
        "The same drives three times; revisions "
        + ", ".join(sorted({run["revision"] for found in drives.values() for run in found.values()}))
        + ". *Apart*: the largest distance of a place on one path to the other path.",
        "",
        "| robot | drive | outcome | length | time | missed | late | apart: lockstep twice | apart: lockstep, real time |",
        "|---|---|---|---|---|---|---|---|---|",
    ]

    def all_of(found, name, form="{}"):
        return " / ".join(form.format(found[way][name]) for way in ways)

    def apart(found, way):
        one, other = (np.array(found[each]["path"]) for each in ("lockstep", way))
        return max(directed_hausdorff(one, other)[0], directed_hausdorff(other, one)[0])

    again, real = ([apart(found, way) for found in drives.values()] for way in ("again", "real time"))
    for (robot, kind, scenario, number, _), found in drives.items():
        lines.append(
            f"| {robot} | {TITLES[kind]}, {scenario} {number} | {all_of(found, 'outcome')} | "
            f"{all_of(found, 'length_m', '{:.1f}')} m | {all_of(found, 'seconds', '{:.0f}')} s | {all_of(found, 'missed')} | "
            f"{all_of(found, 'late')} | {apart(found, 'again'):.2f} m | {apart(found, 'real time'):.2f} m |"
        )
    return lines + [
        "",
        f"Median apart: {np.median(again):.2f} m in lockstep twice, {np.median(real):.2f} m in lockstep and "
        "real time.",
    ]


def _as_wanted(run) -> bool:
    return run["outcome"] in WANTED[run["kind"]] and (run["entered_m"] or -1.0) <= 0.0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default=ROBOTS[0], choices=ROBOTS)
    parser.add_argument("--seed", type=int, default=2, help="of the goals and of the simulated noise")
    parser.add_argument("--pace", type=float, default=FASTEST, help="simulated seconds per real second, at most")
    parser.add_argument("--real-time", action="store_true", help="time does not wait for anybody; pace 1")
    parser.add_argument("--repeat", type=int, default=0, help="another time, in another file")
    parser.add_argument("--kinds", nargs="+", default=list(TITLES), choices=list(TITLES), help="of drives")
    parser.add_argument("--drives", type=int, default=1000, help="how many at most")
    parser.add_argument("--seconds", type=float, default=math.inf, help="of wall time, then go on another time")
    parser.add_argument("--only-write", action="store_true", help="the table of what the files have")
    arguments = parser.parse_args()
    OUT.mkdir(parents=True, exist_ok=True)
    how = {
        "pace": 1.0 if arguments.real_time else arguments.pace,
        "lockstep": not arguments.real_time,
        "repeat": arguments.repeat,
    }
    out = OUT / (
        f"{arguments.robot}-{arguments.seed}-{how['pace']:g}"
        + ("-real" if arguments.real_time else "")
        + (f"-{arguments.repeat}" if arguments.repeat else "")
        + ".json"
    )
    runs = json.loads(out.read_text()) if out.exists() else []
    until = time.monotonic() + arguments.seconds
    done = {(run["kind"], run["scenario"], run["number"]) for run in runs}
    todo = [task for task in tasks(arguments.seed) if task[:3] not in done and task[0] in arguments.kinds]
    todo = todo[: max(0, arguments.drives - len(done))]
    if todo and not arguments.only_write:
        lab = Lab(arguments.robot, todo[0][3], OUT / out.stem, how["pace"], arguments.seed, how["lockstep"])

        def keep(run) -> None:
            runs.append({"robot": arguments.robot, "revision": revision(), "seed": arguments.seed, **how, **run})
            out.write_text(json.dumps(runs, indent=1) + "\n")
            print({key: value for key, value in run.items() if key not in ("path", "errors")}, flush=True)
            if time.monotonic() > until:
                raise TimeoutError

        try:
            for scenario, part in itertools.groupby(todo, key=lambda task: task[1]):
                if scenario:
                    drive_scenario(lab, scenario, list(part), keep)
                else:
                    for task in part:
                        drive_nose(lab, task[2], arguments.seed, keep)
        except TimeoutError:
            print("time is up: call it again to go on")
        finally:
            lab.child.stop()
    TABLE.parent.mkdir(parents=True, exist_ok=True)
    TABLE.write_text(table([run for path in sorted(OUT.glob("*.json")) for run in json.loads(path.read_text())]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
