#!/usr/bin/env python3
"""What it costs and what it saves that nothing on a robot is a spot (vb_laser_detect/detection/robot_cylinders.py).

    bench/detection/robots_in_view.py [--places 1500] [--rounds 8] [--csv docs/results/detection/robots.csv]

Robots at random places of the simulated lab, seen by its three ceiling cameras, with a localisation that is off by 0, 5
or 10 cm in a random direction:

- *laser beside*: a spot at a random place beyond the robot's rim. Of those that the camera sees (the rendered robot
  hides less than half of the light), how many are refused? Places that the robot hides say how often there was nothing
  to lose. *By all cameras*: refused by each of those that see it, so that only the robot's own camera is left.
- *light on it*: a point anywhere on the robot's side or top that faces the camera, as for a button
  or an LED. How many are refused?

Both for the margin that the detectors use, and for none and twice as much. Then the time of a search with and without a
robot, paired. Intervals are Wilson's for 95 %.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any, Dict, List, Tuple

import cv2
import numpy as np

TOP = Path(__file__).resolve().parents[2]
for package in ("vb_core", "vb_laser_detect", "vb_sim"):
    sys.path.insert(0, str(TOP / "src" / package / "src"))

from vb_core.robot_profile import RobotProfile  # noqa: E402
from vb_evaluation.result_table import append_rows  # noqa: E402
from vb_evaluation.statistics import proportion  # noqa: E402
from vb_laser_detect.detection.image_geometry import ImageGeometry, search  # noqa: E402
from vb_laser_detect.detection.projection import FloorProjection  # noqa: E402
from vb_laser_detect.detection.robot_cylinders import RobotCylinder  # noqa: E402
from vb_laser_detect.detector import DetectorParams, SpotDetector  # noqa: E402
from vb_sim.cameras.ceiling_view import CeilingView  # noqa: E402
from vb_sim.lab_history import Snapshot  # noqa: E402
from vb_sim.room.camera_models import CameraModels  # noqa: E402
from vb_sim.room.floor_texture import render_floor  # noqa: E402
from vb_sim.room.mesh import world_mesh  # noqa: E402
from vb_sim.room.world import load_world  # noqa: E402

PROFILE = RobotProfile.load(TOP / "robots" / "turtlebot2.yaml")
TALL = 0.42  # [m] the robot that is drawn; its profile may say more
RINGS = ((0.0, 0.1), (0.1, 0.2), (0.2, 0.3))  # [m] beyond the rim
ERRORS = (0.0, 0.05, 0.10)  # [m] of the localisation
MARGINS = (0.05, 0.0, 0.10)  # [m]; the first is what ros/camera_geometry.py has


def around(random: np.random.Generator, distance: float) -> np.ndarray:
    """Returns (2,) [m] in a random direction."""
    angle = random.uniform(0.0, 2.0 * math.pi)
    return distance * np.array([math.cos(angle), math.sin(angle)])


def share(what: str, error: float, margin: float, refused: List[bool], hidden: int) -> Dict[str, Any]:
    """Makes a row of the table."""
    found = proportion(sum(refused), len(refused))
    return {
        "what": what,
        "localisation_error_cm": round(100 * error),
        "margin_cm": round(100 * margin),
        "n": len(refused),
        "hidden_anyway": hidden,
        "refused": sum(refused),
        "share": round(found.estimate, 4),
        "low": round(found.low, 4),
        "high": round(found.high, 4),
    }


def on_surface(random: np.random.Generator, origin: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Returns (3,) [m], a random point of a robot's side or top, by area, that a camera sees from outside."""
    side, top = 2.0 * math.pi * PROFILE.radius * TALL, math.pi * PROFILE.radius**2
    while True:
        if random.uniform() < top / (top + side):
            return np.array([*(place + around(random, PROFILE.radius * math.sqrt(random.uniform()))), TALL])
        out = around(random, PROFILE.radius)
        point = np.array([*(place + out), random.uniform(0.0, TALL)])
        if (origin - point)[:2] @ out > 0.0:
            return point


def geometry_rows(places: int) -> List[Dict[str, Any]]:
    """Shares of what is refused."""
    random, world = np.random.default_rng(13), load_world(TOP / "src/vb_sim/worlds/lab.yaml")
    floor, mesh = render_floor(world, 1), world_mesh(world)
    views = [
        CeilingView(camera, {"robot": PROFILE.radius}, floor, mesh, CameraModels(), 1, noise=False)
        for camera in world.cameras
    ]
    beside: Dict[Tuple, List[bool]] = defaultdict(list)
    on_it: Dict[Tuple, List[bool]] = {(error, margin): [] for error in ERRORS for margin in MARGINS}
    hidden: Counter = Counter()
    for index in range(places):
        view = views[index % len(views)]
        origin = view.pose[:3, 3]
        place = random.uniform((0.3, 0.3), np.array(world.room.size) - 0.3)
        robots = {"robot": (*place, random.uniform(-math.pi, math.pi))}
        offs = {error: around(random, error) for error in ERRORS}

        def refused(error: float, margin: float, camera: np.ndarray, spot: np.ndarray) -> bool:
            return RobotCylinder(*(place + offs[error]), PROFILE.radius + margin, PROFILE.shape.height).occludes(
                camera, spot
            )

        for ring in RINGS:
            spot = place + around(random, PROFILE.radius + random.uniform(*ring))
            # the others do not see it, outside of their image or behind furniture
            near = [one for one in views if one.spot_share(Snapshot(0.0, {}, tuple(spot))) >= 0.5]
            see = [one for one in near if one.spot_share(Snapshot(0.0, robots, tuple(spot))) >= 0.5]
            hidden[ring, "one camera"] += int(view in near and view not in see)
            hidden[ring, "all cameras"] += int(bool(near) and not see)
            for error, margin in on_it:
                by = {one: refused(error, margin, one.pose[:3, 3], np.array([*spot, 0.0])) for one in see}
                if view in by:
                    beside[ring, "one camera", error, margin].append(by[view])
                if by:
                    beside[ring, "all cameras", error, margin].append(all(by.values()))
        point = on_surface(random, origin, place)
        seen = origin + (point - origin) * origin[2] / (origin[2] - point[2])  # where its ray would meet the floor
        for error, margin in on_it:
            on_it[error, margin].append(refused(error, margin, origin, seen))
    words = {ring: f"laser beside, {100 * ring[0]:.0f} to {100 * ring[1]:.0f} cm from the rim" for ring in RINGS}
    rows = [
        share(f"{words[ring]}, by {who}", error, margin, some, hidden[ring, who])
        for (ring, who, error, margin), some in sorted(beside.items(), key=lambda one: one[0][:2])
    ]
    return rows + [share("light on it", error, margin, some, 0) for (error, margin), some in on_it.items()]


def time_ratio(rounds: int) -> Tuple[float, float]:
    """Times the search of a 1080p Bayer image with a spot and a robot: median [ms], and its ratio, paired, to not
    knowing the place.
    """
    world = load_world(TOP / "src/vb_sim/worlds/lab.yaml")
    view = CeilingView(
        world.cameras[1], {"robot": PROFILE.radius}, render_floor(world, 1), world_mesh(world), CameraModels(), 1
    )
    x, y = view.pose[:2, 3]
    detectors = {hides: SpotDetector(DetectorParams.stationary()) for hides in (False, True)}
    projector, times = FloorProjection(), {False: [], True: []}
    for step in range(50 + 50 * rounds):
        robot = (x - 0.5, y + 0.3 * math.sin(0.05 * step), 0.0)
        laser = (x + 0.3 * math.cos(0.05 * step), y + 0.3) if step >= 25 else None
        image = view.frame(Snapshot(0.04 * step, {"robot": robot}, laser))
        for hides in ((False, True), (True, False))[step % 2]:
            body = RobotCylinder(*robot[:2], PROFILE.radius + MARGINS[0], PROFILE.shape.height)
            frame = ImageGeometry(view.model, lambda: view.pose, projector, cylinders=lambda: [body] if hides else [])
            began = time.thread_time()
            search(detectors[hides], image, 0.04 * step, frame, view.encoding)
            times[hides].append(1e3 * (time.thread_time() - began))
    old, new = (np.array(times[hides][50:]).reshape(rounds, -1) for hides in (False, True))
    return float(np.median(new)), float(np.median(np.median(new, axis=1) / np.median(old, axis=1)))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--places", type=int, default=1500)
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument("--csv", type=Path, help="append rows")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    rows = geometry_rows(given.places)
    for row in rows:
        print(row)
    print("search with a robot: {:.2f} ms, {:.3f} times as long as without".format(*time_ratio(given.rounds)))
    if given.csv:
        append_rows(given.csv, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
