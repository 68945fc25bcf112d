#!/usr/bin/env python3
"""Drives with the real move_base: round each scenario's border, into it, and with a border put before the nose.

    make navigation                                                     once
    python3 bench/robot_drives.py --robot turtlebot2                    all that is missing in its file
    python3 bench/robot_drives.py --robot turtlebot2 --seconds 200      for at most about that long, then go on later

A robot type drives in the simulated lab (no cameras, no display) with move_base and AMCL as they are shipped here,
through its driver, in simulated time. The judge sees where the robot truly is. Goals: GOALS below, from one to the next
and back again, so that both directions are driven, until there are ROUNDS. Writes each drive to
out/bench/robot_drives/, and the tables of all of them to docs/results/robots_navigation.md.
"""
import argparse
import itertools
import json
import math
import os
import subprocess
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

from vb_core.errors import CodedError
from vb_core.grid_map import distance_to
from vb_core.ros import messages
from vb_core.ros.services import call
from vb_core import names
from vb_evaluation.goal_runs import GoalRunner
from vb_evaluation.observer import Observer, wait_until
from vb_evaluation.processes import Child, free_port
from vb_evaluation.statistics import proportion
from vb_msgs.msg import LabState, VirtualBorder
from vb_msgs.srv import AddBorder, AddBorderRequest, RemoveBorder, RemoveBorderRequest
from vb_sim.room.world import load_world

TOP = Path(__file__).resolve().parent.parent
OUT, TABLE = TOP / "out" / "bench" / "robot_drives", TOP / "docs" / "results" / "robots_navigation.md"
ROBOTS = ("turtlebot2", "turtlebot3_burger")
LIMIT_S = 100.0  # [s] of simulated time for one goal
# places on either side of each border, [m, m, deg]: the robot drives from each to the next
GOALS = {
    "carpet": [(7.4, 0.6, 180), (1.6, 1.6, 180), (4.2, 2.5, 0), (7.0, 1.5, 0), (2.6, 0.5, 180), (5.7, 0.6, 0),
               (1.6, 1.6, 90)],
    "corner": [(6.8, 4.2, 0), (7.5, 3.9, 0), (6.5, 4.6, 180), (7.3, 4.5, 90)],
    "room": [(7.4, 0.6, 180), (4.0, 3.5, 180), (1.6, 1.6, 0), (4.0, 3.5, 0)],
}
ROUNDS = 40  # goals round each border
INSIDE = {"carpet": [(4.1, 1.4, 0), (3.6, 1.1, 0)], "room": [(1.6, 3.6, 0), (0.8, 4.2, 0)],
          "corner": [(4.0, 2.6, 0), (2.0, 1.6, 0)]}


class Lab:
    """The running lab: borders, goals, and what truly happened."""

    def __init__(self, robot: str, start, folder: Path) -> None:
        state = tempfile.mkdtemp(prefix="robot_drives")
        worlds = TOP / "src" / "vb_sim" / "worlds"
        world = yaml.safe_load((worlds / "burger.yaml").read_text()) if robot == "turtlebot3_burger" else {
            "name": "lab", "robots": yaml.safe_load((worlds / "lab.yaml").read_text())["robots"]}
        world["like"] = str(worlds / "lab.yaml")
        world["robots"][0]["start"] = [float(value) for value in start]
        path = Path(state) / "world.yaml"
        path.write_text(yaml.safe_dump(world))
        self.world = load_world(str(path))
        self.radius = self.world.robots[0].radius
        x, y, yaw = self.world.robots[0].start_pose()
        port = free_port()
        os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{port}"
        self.child = Child(
            ["roslaunch", "-p", str(port), str(TOP / "bench" / "robot_drives.launch"),
             f"world:={path}", f"state:={state}", f"robot_type:={robot}", "amcl:=true", f"x:={x}", f"y:={y}", f"yaw:={yaw}"],
            folder / "roslaunch.txt", {**os.environ, "ROS_LOG_DIR": str(folder / "log")})
        if not wait_until(rosgraph.is_master_online, 60.0):
            raise CodedError("not_ready", "no master")
        rospy.init_node("robot_drives", anonymous=True, disable_signals=True, log_level=rospy.ERROR)
        self.observer = Observer()
        self.runner = GoalRunner()
        if not wait_until(lambda: self.observer.posterior is not None and self.observer.lab is not None, 60.0):
            raise CodedError("not_ready", f"no maps, see {folder}")
        self._truth, self._errors = deque(maxlen=500), []
        self._subscribers = [rospy.Subscriber(names.LAB_STATE, LabState, self._on_lab),
                             rospy.Subscriber("/amcl_pose", PoseWithCovarianceStamped, self._on_amcl)]

    def _on_lab(self, message) -> None:
        pose = message.robot_poses[0]
        self._truth.append((message.header.stamp.to_sec(), pose.x, pose.y))

    def _on_amcl(self, message) -> None:
        stamp, place = message.header.stamp.to_sec(), message.pose.pose.position
        truth = min(list(self._truth), key=lambda entry: abs(entry[0] - stamp), default=None)
        if truth is not None and abs(truth[0] - stamp) < 0.05:
            self._errors.append(math.dist((place.x, place.y), truth[1:]))

    def errors(self) -> float:
        """[m] the largest error of the localisation since it was asked last."""
        errors, self._errors = self._errors, []
        return round(max(errors, default=math.nan), 3)

    def pose(self):
        pose = self.observer.lab.robot_poses[0]
        return pose.x, pose.y, pose.theta

    def add(self, points, seed, closed) -> str:
        border = VirtualBorder(name="drive", kind=VirtualBorder.POLYGON if closed else VirtualBorder.SEPARATING_CURVE,
                               occupancy=1.0, enabled=True, points=messages.points_from_array(np.array(points)))
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
        """[m] how deep the footprint came into what borders restrict, beyond a cell's diagonal; 0 or less is fine."""
        prior, posterior = self.observer.prior, self.observer.posterior
        restricted = posterior.data > np.maximum(prior.data, 0)
        if not len(path) or not restricted.any():
            return -math.inf
        cells = prior.world_to_cell(path)
        gap = distance_to(restricted)[cells[:, 0], cells[:, 1]] * prior.resolution
        return float(self.radius - gap.min() - 1.5 * prior.resolution)

    def go(self, goal, limit=LIMIT_S):
        return self.runner.drive((goal[0], goal[1], math.radians(goal[2])), limit)


def place(scenario, number):
    """The place (x, y, yaw) [m, m, deg] that a robot comes to as the number-th, forth and back again."""
    loop = GOALS[scenario] + GOALS[scenario][-2:0:-1]
    return loop[number % len(loop)]


def tasks():
    """What is to be driven: (kind, scenario, number, goal). In turns, so that each part tells of all."""
    for begin in range(0, ROUNDS, 10):
        for scenario in GOALS:
            yield from (("round", scenario, i, place(scenario, i + 1)) for i in range(begin, begin + 10))
            if begin == 0:
                yield from (("inside", scenario, i, goal) for i, goal in enumerate(INSIDE[scenario]))
        yield from (("nose", "", i, None) for i in range(begin // 2, begin // 2 + 5))


def first_place(task):
    """Where the robot is before a drive (x, y, yaw) [m, m, deg]."""
    kind, scenario, number, _ = task
    return place(scenario, number if kind == "round" else 0) if scenario else (7.0, 0.9, 180)


def drive_scenario(lab, scenario, todo, keep) -> None:
    """Brings the robot to where the first drive begins, adds the border, drives."""
    what, start = lab.world.scenarios[scenario], first_place(todo[0])
    if math.dist(lab.pose()[:2], start[:2]) > 0.2:
        lab.go(start)
    border = lab.add(what.border, what.seed, what.closed)
    try:
        for kind, _, number, goal in todo:
            began = time.monotonic()
            driven = lab.go(goal)
            keep({"kind": kind, "scenario": scenario, "number": number, "goal": goal, "outcome": driven.outcome,
                  "text": driven.text, "length_m": round(driven.length, 2), "seconds": round(driven.seconds, 1),
                  "wall_s": round(time.monotonic() - began, 1), "localised_m": lab.errors(),
                  "entered_m": round(lab.entered(driven.path), 3)})
    finally:
        lab.remove(border)


def drive_nose(lab, number, keep) -> None:
    """A border across the way of a robot under way, 0.25 to 0.6 m before its nose."""
    rng = np.random.default_rng(1000 + number)
    ends = [(7.0, 0.9, 180), (1.6, 1.6, 0)]
    here = lab.pose()
    goal = max(ends, key=lambda end: math.dist(end[:2], here[:2]))
    gap, driven_before = float(rng.uniform(0.25, 0.6)), float(rng.uniform(1.0, 3.0))
    put = {}

    def watch():
        start = lab.pose()
        if not wait_until(lambda: math.dist(lab.pose()[:2], start[:2]) > driven_before, 120.0, 0.02):
            return
        x, y, yaw = lab.pose()
        ahead, half = lab.radius + gap, 0.3
        middle = np.array([x + (ahead + half) * math.cos(yaw), y + (ahead + half) * math.sin(yaw)])
        along, across = half * np.array([math.cos(yaw), math.sin(yaw)]), half * np.array([-math.sin(yaw), math.cos(yaw)])
        corners = [middle - along - across, middle + along - across, middle + along + across, middle - along + across]
        try:
            put["id"] = lab.add(corners, middle, True)
            put["at"] = (x, y)
        except CodedError as error:
            put["error"] = error.code

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    began = time.monotonic()
    driven = lab.go(goal)
    thread.join(20.0)
    path = driven.path
    if "at" in put and len(path):
        path = path[int(np.argmin(np.linalg.norm(path - put["at"], axis=1))):]
    keep({"kind": "nose", "scenario": "", "number": number, "goal": goal, "outcome": driven.outcome, "text": driven.text,
          "gap_m": round(gap, 2), "border": put.get("error", "added" if "id" in put else "none"),
          "length_m": round(driven.length, 2), "seconds": round(driven.seconds, 1),
          "wall_s": round(time.monotonic() - began, 1), "localised_m": lab.errors(),
          "entered_m": round(lab.entered(path), 3) if "id" in put else None})
    if "id" in put:
        lab.remove(put["id"])


def _interval(good: int, count: int) -> str:
    if not count:
        return "-"
    share = proportion(good, count)
    return f"{100 * share.low:.0f} to {100 * share.high:.0f} %"


def revision() -> str:
    """The commit that the drives are made with."""
    return subprocess.run(["git", "describe", "--always", "--dirty"], cwd=str(TOP), stdout=subprocess.PIPE,
                          universal_newlines=True).stdout.strip()


def table(runs) -> str:
    """The results as Markdown."""
    lines = ["# Driving with the real move_base", "", f"`python3 bench/robot_drives.py`, {time.strftime('%Y-%m-%d', time.gmtime())}, "
             f"revisions {', '.join(sorted({run['revision'] for run in runs}))}. ros-planning/navigation at 9ad6441 with AMCL, "
             "parameters of `vb_bringup/config/navigation` and the robot's profile, through `robot_driver`; simulated lab, "
             "truth judged. *Entered*: the footprint more than one and a half cells inside of what a border restricts.", "",
             "| robot | drives | scenario | done | as wanted | 95 % interval of that | entered | localisation off, at most | median time | longest | simulated per real second |",
             "|---|---|---|---|---|---|---|---|---|---|---|"]
    keys = sorted({(run["robot"], run["kind"], run["scenario"]) for run in runs})
    for robot, kind, scenario in keys:
        group = [run for run in runs if (run["robot"], run["kind"], run["scenario"]) == (robot, kind, scenario)]
        wanted = {"round": ("reached",), "inside": ("refused",), "nose": ("reached", "refused")}[kind]
        counted = [run for run in group if kind != "nose" or run["border"] == "added"]
        good = sum(run["outcome"] in wanted for run in counted)
        entered = sum((run["entered_m"] or -1.0) > 0.0 for run in counted)
        seconds = [run["seconds"] for run in counted] or [0.0]
        off = max([run["localised_m"] for run in counted if run["localised_m"] > 0] or [0.0])
        what = {"round": "past the border", "inside": "into it", "nose": "border put before the nose"}[kind]
        lines.append(f"| {robot} | {what} | {scenario or '-'} | {len(counted)} | {good} | "
                     f"{_interval(good, len(counted))} | {entered} | "
                     f"{off:.2f} m | {np.median(seconds):.0f} s | {max(seconds):.0f} s | "
                     f"{sum(seconds) / max(sum(run['wall_s'] for run in counted), 1e-9):.2f} |")
    bad = [run for run in runs if (run["kind"] == "round" and run["outcome"] != "reached")
           or (run["kind"] == "inside" and run["outcome"] != "refused") or (run["entered_m"] or -1.0) > 0.0
           or (run["kind"] == "nose" and run["outcome"] not in ("reached", "refused"))]
    lines += ["", "Not as wanted:" if bad else "Every drive went as wanted.", ""]
    lines += [f"- {run['robot']}, {run['kind']} {run['scenario']} {run['number']}, goal {tuple(run['goal'])}: {run['outcome']} after "
              f"{run['seconds']:.0f} s, {run['length_m']:.1f} m, entered {run['entered_m']} m. {run['text']}" for run in bad]
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default=ROBOTS[0], choices=ROBOTS)
    parser.add_argument("--scenarios", nargs="+", default=[*GOALS, "nose"], help="one file for each share")
    parser.add_argument("--seconds", type=float, default=math.inf, help="of wall time, then go on another time")
    parser.add_argument("--fresh", action="store_true", help="forget what the file has")
    parser.add_argument("--only-write", action="store_true", help="the table of what the files have")
    arguments = parser.parse_args()
    OUT.mkdir(parents=True, exist_ok=True)
    share = "" if len(arguments.scenarios) == len(GOALS) + 1 else "-" + "-".join(arguments.scenarios)
    out = OUT / f"{arguments.robot}{share}.json"
    runs = json.loads(out.read_text()) if out.exists() and not arguments.fresh else []
    until = time.monotonic() + arguments.seconds
    done = {(run["kind"], run["scenario"], run["number"]) for run in runs}
    todo = [task for task in tasks() if task[:3] not in done and (task[1] or "nose") in arguments.scenarios]
    if todo and not arguments.only_write:
        lab = Lab(arguments.robot, first_place(todo[0]), OUT / out.stem)

        def keep(run) -> None:
            runs.append({"robot": arguments.robot, "revision": revision(), **run})
            out.write_text(json.dumps(runs, indent=1) + "\n")
            print(run, flush=True)
            if time.monotonic() > until:
                raise TimeoutError

        try:
            for scenario, part in itertools.groupby(todo, key=lambda task: task[1]):
                if scenario:
                    drive_scenario(lab, scenario, list(part), keep)
                else:
                    for task in part:
                        drive_nose(lab, task[2], keep)
        except TimeoutError:
            print("time is up: call it again to go on")
        finally:
            lab.child.stop()
    TABLE.parent.mkdir(parents=True, exist_ok=True)
    TABLE.write_text(table([run for path in sorted(OUT.glob("*.json")) for run in json.loads(path.read_text())]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
