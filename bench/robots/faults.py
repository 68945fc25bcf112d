#!/usr/bin/env python3
"""What a robot does when something is lost while it drives: time until it stops, and whether it ran into anything.

    python3 bench/robots/faults.py               20 times each, about 5 minutes of one core; goes on where it was ended
    python3 bench/robots/faults.py --fresh

The driver, the guide's servoing, the stand-in for navigation and the simulated base with its own brakes and timeout, in
one process and in simulated time, as the study drives them. Each fault is put in while the robot follows a spot
that leads it round in a circle for ever, on the widest free floor, and while it drives under navigation round
the carpet; a moment later it is mended. The network is the link between the robot's computer and the others:
state, spots and maps do not come
any more. *Nothing* is the control: whatever happens there is not the loss's doing. The driver hears nothing of the
dispatcher, so that its loss must look like the control.
Writes each run to out/bench/robot_faults.json, and docs/results/robots/faults.md.
"""

import argparse
import json
import math
import sys
import time
from pathlib import Path

import numpy as np
from driver_rig import NAVIGATION_HZ, SCAN_HZ, DrivenRobot, Every, standin_navigator

from vb_core.robot_profile import RobotProfile
from vb_evaluation.provenance import revision
from vb_map_integration.border import VirtualBorder
from vb_map_integration.integrator import IntegratorParams, MapIntegrator
from vb_robot.clearance_map import BLOCKED_THRESHOLD, clearance_grid
from vb_robot.driving.gate import RATE
from vb_robot.spots import DEFAULT, GUIDE, Sighting
from vb_sim.lab import Lab
from vb_sim.room.floor_plan import physical_map
from vb_sim.room.world import load_world

TOP = Path(__file__).resolve().parents[2]
OUT = TOP / "out" / "bench" / "robot_faults.json"
TABLE = TOP / "docs" / "results" / "robots" / "faults.md"
STEP = 0.02
FAULTS = ("nothing", "state", "spots", "dispatcher", "driver", "network", "pose", "scan", "clock")
TITLES = {
    "nothing": "nothing",
    "state": "interaction manager",
    "spots": "detector",
    "dispatcher": "dispatcher",
    "driver": "driver",
    "network": "network",
    "pose": "localisation",
    "scan": "scan",
    "clock": "clock",
}
HELD = 2.5  # [s] for which it is lost
AHEAD, BEARING, CIRCLE = 1.6, 0.2, 0.56  # [m, rad] where the spot is from the robot; [m] radius of where that leads it


class Run:
    """One drive with one fault."""

    def __init__(self, world, grid, posterior, profile, guided, seed):
        self.lab = Lab(world, seed=seed)
        self.rng = np.random.default_rng(seed)
        self.body, self.guided = self.lab.robots[0], guided
        if guided:
            clearance = clearance_grid(
                (posterior.data >= BLOCKED_THRESHOLD) | (posterior.data < 0), posterior.resolution
            )
            middle = np.unravel_index(int(np.argmax(clearance)), clearance.shape)
            x, y = posterior.cell_to_world(np.array([middle]))[0]
            yaw = self.rng.uniform(-math.pi, math.pi)
            self.body.pose = (float(x + CIRCLE * math.sin(yaw)), float(y - CIRCLE * math.cos(yaw)), float(yaw))
        self.robot = DrivenRobot(0, self.lab, standin_navigator(grid, profile), "robot", grid, profile)
        self.robot.set_map(posterior)
        self.scan, self.drive, self.control, self.image = Every(SCAN_HZ), Every(RATE), Every(NAVIGATION_HZ), Every(25.0)
        self.now, self.frozen = 100.0, False
        self.waiting = []
        self.robot.set_state(GUIDE if guided else DEFAULT, "a" if guided else "", 100.0)

    def step(self):
        self.now += STEP
        now = self.now
        self.lab.step(STEP, now)
        if self.frozen:
            return  # without a clock nothing comes any more
        if self.scan.due(now):
            self.robot.scan(now)
        if self.guided and self.image.due(now):
            x, y, yaw = self.body.pose
            # always a little too far ahead: only a fault ends the drive
            place = np.array([x + AHEAD * math.cos(yaw + BEARING), y + AHEAD * math.sin(yaw + BEARING)])
            self.waiting.append((now, place))
        while self.waiting and self.waiting[0][0] <= now - 0.1:
            stamp, place = self.waiting.pop(0)
            self.robot.add(Sighting(stamp, tuple(place), "robot", True, 0.9))
        if self.control.due(now) and not self.guided:
            self.robot.navigate(now, self.control.period)
        if self.drive.due(now):
            self.robot.drive(now)


def run(world, grid, posterior, profile, guided, fault, seed):
    """Drives with a fault: (seconds until it stopped or None, collisions, m into the border, whether it went on, code
    while held).
    """
    run = Run(world, grid, posterior, profile, guided, seed)
    if not guided:
        run.robot.send((1.6, 1.6, math.pi))
    begin = run.now + run.rng.uniform(2.0, 4.0) if guided else run.now + run.rng.uniform(3.0, 9.0)
    while run.now < begin or abs(run.body.velocity[0]) < 0.08:
        run.step()
        if run.now > begin + 20.0:
            return None
    hit = run.body.collisions
    at = run.now
    stopped, depth, codes = None, -math.inf, set()
    restricted = posterior.data > np.maximum(grid.data, 0)
    cells = grid.cell_to_world(np.argwhere(restricted))
    run.robot.lost.add(fault)
    while run.now < at + HELD:
        if fault == "clock":
            # time stands still for the driver, and it knows only for how long
            run.frozen = True
            if run.drive.due(run.now):
                run.robot.arbiter.gate.clock_age = run.now - at
                run.robot.drive(at)
                run.body.command(run.robot.command.v, run.robot.command.w, run.now)
        run.step()
        codes.add(run.robot.command.code)
        if stopped is None and run.body.velocity[0] == 0.0 and abs(run.body.velocity[1]) < 1e-6:
            stopped = run.now - at
        depth = max(depth, profile.radius - float(np.linalg.norm(cells - run.body.pose[:2], axis=1).min()))
    run.robot.lost.clear()
    run.robot.arbiter.gate.clock_age = 0.0
    run.frozen = False
    end = run.now + 4.0
    going = 0.0
    while run.now < end:
        run.step()
        going = max(going, abs(run.body.velocity[0]))
        depth = max(depth, profile.radius - float(np.linalg.norm(cells - run.body.pose[:2], axis=1).min()))
    on = going > 0.05 or run.robot.status(run.now).goal.value == "reached"
    return stopped, run.body.collisions - hit, depth, on or run.robot.command.code, sorted(codes)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("--fresh", action="store_true", help="forget what the file has")
    arguments = parser.parse_args()
    world = load_world(str(TOP / "src" / "vb_sim" / "worlds" / "lab.yaml"))
    grid, profile = physical_map(world), RobotProfile.load(TOP / "robots" / "turtlebot2.yaml")
    carpet = world.scenarios["carpet"]
    integrator = MapIntegrator(IntegratorParams(), None)
    integrator.set_map(grid)
    integrator.add(VirtualBorder(carpet.border, carpet.seed, 1.0, True), 0.0, {})
    posterior = integrator.map_with_borders
    OUT.parent.mkdir(parents=True, exist_ok=True)
    done = json.loads(OUT.read_text()) if OUT.exists() and not arguments.fresh else {}
    for seed in range(arguments.times):
        for fault in FAULTS:
            for guided in (True, False):
                key = f"{fault} {guided} {seed}"
                if key not in done:
                    done[key] = run(world, grid, posterior, profile, guided, fault, seed)
                    OUT.write_text(json.dumps(done) + "\n")
        print(f"{seed + 1} of {arguments.times}", flush=True)
        write(done, arguments.times, grid.resolution)
    return 0


def write(done, times, cell) -> None:
    """Writes the table of what has been run so far."""
    lines = [
        "# What is lost while a robot drives",
        "",
        f"`python3 bench/robots/faults.py --times {times}`, "
        f"{time.strftime('%Y-%m-%d', time.gmtime())}, revision {revision()}. In one process with the simulated base; "
        "*stopped*: from the loss until both wheels rest. *Keeps driving* is right where what was lost is not needed.",
        "",
        "| lost | driven by | runs | stopped | median | longest | keeps driving | ran into anything | "
        "entered a border | goes on after | what it says |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for fault in FAULTS:
        for guided in (True, False):
            found = [done.get(f"{fault} {guided} {seed}") for seed in range(times)]
            found = [entry for entry in found if entry is not None]
            seconds = [entry[0] for entry in found if entry[0] is not None]
            said = sorted({code for entry in found for code in entry[4]} - {"driving", "idle"})
            lines.append(
                f"| {TITLES[fault]} | {'spot' if guided else 'navigation'} | {len(found)} | {len(seconds)} | "
                + (f"{np.median(seconds):.2f} s | {max(seconds):.2f} s" if seconds else "- | -")
                + f" | {len(found) - len(seconds)} | {sum(entry[1] > 0 for entry in found)} | "
                f"{sum(entry[2] > 2 * cell for entry in found)} | {sum(entry[3] is True for entry in found)} | "
                f"{', '.join(said)} |"
            )
    TABLE.parent.mkdir(parents=True, exist_ok=True)
    TABLE.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    sys.exit(main())
