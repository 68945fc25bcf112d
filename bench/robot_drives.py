#!/usr/bin/env python3
"""Drives with the real move_base: round each scenario's border, into it, and with a border put before the nose.

    make navigation                                                  once
    python3 bench/robot_drives.py                                    all that is missing in the file
    python3 bench/robot_drives.py --robots turtlebot2 --amcl --seconds 280      for at most that long, then go on later

Each robot type drives in the simulated lab (no cameras, no display) with move_base as it is shipped here, through its
driver, in simulated time. The judge sees where the robot truly is. Goals: GOALS below, from one to the next and back
again, so that both directions are driven. With --amcl the lab does not localise, AMCL does. Writes each drive to
out/bench/robot_drives.json, and the tables to docs/results/robots_navigation.md.
"""
import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import rosgraph
import rospy

from vb_core.errors import CodedError
from vb_core.grid_map import distance_to
from vb_core.ros import messages
from vb_core.ros.services import call
from vb_core import names
from vb_evaluation.goal_runs import GoalRunner
from vb_evaluation.observer import Observer, wait_until
from vb_evaluation.processes import Child, free_port
from vb_evaluation.statistics import proportion
from vb_msgs.msg import VirtualBorder
from vb_msgs.srv import AddBorder, AddBorderRequest, RemoveBorder, RemoveBorderRequest
from vb_sim.world import load_world

TOP = Path(__file__).resolve().parent.parent
OUT, TABLE = TOP / "out" / "bench" / "robot_drives.json", TOP / "docs" / "results" / "robots_navigation.md"
WORLDS = {"turtlebot2": "lab", "turtlebot3_burger": "burger"}
LIMIT_S = 150.0  # [s] of simulated time for one goal
# places on either side of each border, [m, m, deg]: the robot drives from each to the next
GOALS = {
    "carpet": [(7.4, 0.6, 180), (1.6, 1.6, 180), (4.2, 2.5, 0), (7.0, 1.5, 0), (2.6, 0.5, 180), (5.7, 0.6, 0),
               (1.6, 1.6, 90)],
    "room": [(7.4, 0.6, 180), (4.0, 3.5, 180), (1.6, 1.6, 0), (4.0, 3.5, 0)],
    "corner": [(6.8, 4.2, 0), (7.5, 3.9, 0), (6.5, 4.6, 180), (7.3, 4.5, 90)],
}
ROUNDS = {"carpet": 2, "room": 2, "corner": 2}  # forth and back again counts as one
INSIDE = {"carpet": [(4.1, 1.4, 0), (3.6, 1.1, 0)], "room": [(1.6, 3.6, 0), (0.8, 4.2, 0)],
          "corner": [(4.0, 2.6, 0), (2.0, 1.6, 0)]}
NOSES = 20


class Lab:
    """The running lab: borders, goals, and what truly happened."""

    def __init__(self, robot: str, amcl: bool, folder: Path) -> None:
        self.world = load_world(str(TOP / "src" / "vb_sim" / "worlds" / f"{WORLDS[robot]}.yaml"))
        self.radius = self.world.robots[0].radius
        x, y, yaw = self.world.robots[0].start_pose()
        port = free_port()
        os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{port}"
        state = tempfile.mkdtemp(prefix="robot_drives")
        self.child = Child(
            ["roslaunch", "-p", str(port), str(TOP / "bench" / "robot_drives.launch"),
             f"world:={TOP / 'src' / 'vb_sim' / 'worlds' / (WORLDS[robot] + '.yaml')}", f"state:={state}",
             f"robot_type:={robot}", f"amcl:={str(amcl).lower()}", f"x:={x}", f"y:={y}", f"yaw:={yaw}"],
            folder / "roslaunch.txt", {**os.environ, "ROS_LOG_DIR": str(folder / "log")})
        if not wait_until(rosgraph.is_master_online, 60.0):
            raise CodedError("not_ready", "no master")
        rospy.init_node("robot_drives", anonymous=True, disable_signals=True, log_level=rospy.ERROR)
        self.observer = Observer()
        self.runner = GoalRunner()
        if not wait_until(lambda: self.observer.posterior is not None and self.observer.lab is not None, 60.0):
            raise CodedError("not_ready", f"no maps, see {folder}")
        self.border = ""

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


def tasks(robot):
    """What is to be driven: (kind, scenario, number, goal)."""
    for scenario, goals in GOALS.items():
        there = goals + goals[-2::-1]
        route = there + there[1:] if ROUNDS[scenario] == 2 else there
        yield from (("round", scenario, i, goal) for i, goal in enumerate(route[1:]))
        yield from (("inside", scenario, i, goal) for i, goal in enumerate(INSIDE[scenario]))
    yield from (("nose", "", i, None) for i in range(NOSES))


def drive_scenario(lab, scenario, todo, keep) -> None:
    """Puts the robot to the scenario's first goal, adds the border, drives."""
    what = lab.world.scenarios[scenario]
    first = todo[0]
    whole = GOALS[scenario] + GOALS[scenario][-2::-1]
    route = whole + whole[1:]
    start = route[first[2]] if first[0] == "round" else route[0]
    lab.go(start)
    border = lab.add(what.border, what.seed, what.closed)
    try:
        for kind, _, number, goal in todo:
            driven = lab.go(goal)
            keep({"kind": kind, "scenario": scenario, "number": number, "goal": goal, "outcome": driven.outcome,
                  "text": driven.text, "length_m": round(driven.length, 2), "seconds": round(driven.seconds, 1),
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
        began = lab.pose()
        if not wait_until(lambda: math.dist(lab.pose()[:2], began[:2]) > driven_before, 120.0, 0.02):
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

    import threading
    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    driven = lab.go(goal)
    thread.join(20.0)
    path = driven.path
    if "at" in put and len(path):
        path = path[int(np.argmin(np.linalg.norm(path - put["at"], axis=1))):]
    keep({"kind": "nose", "scenario": "", "number": number, "goal": goal, "outcome": driven.outcome, "text": driven.text,
          "gap_m": round(gap, 2), "border": put.get("error", "added" if "id" in put else "none"),
          "length_m": round(driven.length, 2), "seconds": round(driven.seconds, 1),
          "entered_m": round(lab.entered(path), 3) if "id" in put else None})
    if "id" in put:
        lab.remove(put["id"])


def _interval(good: int, count: int) -> str:
    if not count:
        return "-"
    share = proportion(good, count)
    return f"{100 * share.low:.0f} to {100 * share.high:.0f} %"


def table(runs) -> str:
    """The results as Markdown."""
    revision = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=str(TOP), stdout=subprocess.PIPE,
                              universal_newlines=True).stdout.strip()
    lines = ["# Driving with the real move_base", "", f"`python3 bench/robot_drives.py`, {time.strftime('%Y-%m-%d', time.gmtime())}, "
             f"revision {revision}. ros-planning/navigation at 9ad6441, parameters of `vb_bringup/config/navigation` and the "
             "robot's profile, through `robot_driver`; simulated lab, truth judged. *Entered*: the footprint more than one and "
             "a half cells inside of what a border restricts.", "",
             "| robot | localisation | drives | scenario | done | as wanted | 95 % interval of that | entered | median time | longest |",
             "|---|---|---|---|---|---|---|---|---|---|"]
    keys = sorted({(run["robot"], run["amcl"], run["kind"], run["scenario"]) for run in runs})
    for robot, amcl, kind, scenario in keys:
        group = [run for run in runs if (run["robot"], run["amcl"], run["kind"], run["scenario"]) == (robot, amcl, kind, scenario)]
        wanted = {"round": ("reached",), "inside": ("refused",), "nose": ("reached", "refused")}[kind]
        counted = [run for run in group if kind != "nose" or run["border"] == "added"]
        good = sum(run["outcome"] in wanted for run in counted)
        entered = sum((run["entered_m"] or -1.0) > 0.0 for run in counted)
        seconds = [run["seconds"] for run in counted] or [0.0]
        what = {"round": "past the border", "inside": "into it", "nose": "border put before the nose"}[kind]
        lines.append(f"| {robot} | {'AMCL' if amcl else 'simulator'} | {what} | {scenario or '-'} | {len(counted)} | {good} | "
                     f"{_interval(good, len(counted))} | {entered} | "
                     f"{np.median(seconds):.0f} s | {max(seconds):.0f} s |")
    bad = [run for run in runs if (run["kind"] == "round" and run["outcome"] != "reached")
           or (run["kind"] == "inside" and run["outcome"] != "refused") or (run["entered_m"] or -1.0) > 0.0
           or (run["kind"] == "nose" and run["outcome"] not in ("reached", "refused"))]
    lines += ["", "Not as wanted:" if bad else "Every drive went as wanted.", ""]
    lines += [f"- {run['robot']}, {run['kind']} {run['scenario']} {run['number']}, goal {tuple(run['goal'])}: {run['outcome']} after "
              f"{run['seconds']:.0f} s, {run['length_m']:.1f} m, entered {run['entered_m']} m. {run['text']}" for run in bad]
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", nargs="+", default=list(WORLDS), choices=list(WORLDS))
    parser.add_argument("--amcl", action="store_true", help="AMCL localises, not the lab")
    parser.add_argument("--kinds", nargs="+", default=["round", "inside", "nose"])
    parser.add_argument("--scenarios", nargs="+", default=["", *GOALS])
    parser.add_argument("--seconds", type=float, default=math.inf, help="of wall time, then go on another time")
    parser.add_argument("--fresh", action="store_true", help="forget what the file has")
    parser.add_argument("--only-write", action="store_true", help="the table of what the file has")
    arguments = parser.parse_args()
    OUT.parent.mkdir(parents=True, exist_ok=True)
    runs = json.loads(OUT.read_text()) if OUT.exists() and not arguments.fresh else []
    until = time.monotonic() + arguments.seconds
    if not arguments.only_write:
        robot = arguments.robots[0]  # rospy takes one node name: one robot type per process
        done = {(run["kind"], run["scenario"], run["number"]) for run in runs
                if run["robot"] == robot and run["amcl"] == arguments.amcl}
        todo = [task for task in tasks(robot) if task[0] in arguments.kinds and task[1] in arguments.scenarios
                and task[:3] not in done]
        lab = Lab(robot, arguments.amcl, OUT.parent / "robot_drives")

        def keep(run) -> None:
            runs.append({"robot": robot, "amcl": arguments.amcl, **run})
            OUT.write_text(json.dumps(runs, indent=1) + "\n")
            print(run, flush=True)
            if time.monotonic() > until:
                raise TimeoutError

        try:
            for scenario in GOALS:
                part = [task for task in todo if task[1] == scenario]
                if part:
                    drive_scenario(lab, scenario, part, keep)
            for task in todo:
                if task[0] == "nose":
                    drive_nose(lab, task[2], keep)
        except TimeoutError:
            print("time is up: call it again to go on")
        finally:
            lab.child.stop()
        for other in arguments.robots[1:]:
            if time.monotonic() < until:
                left = ["--seconds", str(until - time.monotonic())] if math.isfinite(until) else []
                subprocess.run([sys.executable, __file__, "--robots", other, "--kinds", *arguments.kinds, "--scenarios",
                                *arguments.scenarios, *left, *(["--amcl"] if arguments.amcl else [])])
                runs = json.loads(OUT.read_text())
    TABLE.parent.mkdir(parents=True, exist_ok=True)
    TABLE.write_text(table(runs))
    return 0


if __name__ == "__main__":
    sys.exit(main())
