"""Writes an image of every camera's view of a world, without ROS: for inspection and the docs."""
from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import cv2
import numpy as np

from vb_core.errors import CodedError
from vb_sim.cameras import pixels
from vb_sim.cameras.ceiling_view import CeilingView
from vb_sim.room.floor_texture import render_floor
from vb_sim.lab_history import Snapshot
from vb_sim.room.mesh import world_mesh
from vb_sim.room.models_cameras import CameraModels, load_camera_models
from vb_sim.cameras.robot_view import RobotView
from vb_sim.room.world import load_world


def main() -> None:
    """The command; --help lists its options."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--world", required=True, help="world file (YAML)")
    parser.add_argument("--models", default="", help="file of models (YAML); default: the built-in figures")
    parser.add_argument("--out", default="out/views", help="folder for the pictures")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--laser", type=float, nargs=2, metavar=("X", "Y"), help="[m]; default: on the first scenario's border")
    parser.add_argument("--color", choices=("red", "green"), default="red", help="of the laser")
    parser.add_argument("--person", type=float, nargs=3, metavar=("X", "Y", "YAW"), help="[m, m, deg]")
    parser.add_argument("--robot", type=float, nargs=3, metavar=("X", "Y", "YAW"), help="[m, m, deg] of the first robot")
    parser.add_argument("--frames", type=int, default=20, help="frames per camera for measuring the time")
    arguments = parser.parse_args()
    try:
        _render(arguments)
    except CodedError as error:
        print(f"render_views: {error}", file=sys.stderr)
        sys.exit(1)


def _render(arguments: argparse.Namespace) -> None:
    cv2.setNumThreads(1)
    world = load_world(arguments.world)
    models = load_camera_models(arguments.models) if arguments.models else CameraModels()
    folder = Path(arguments.out)
    folder.mkdir(parents=True, exist_ok=True)
    scenario = next(iter(world.scenarios.values()), None)
    laser = tuple(arguments.laser) if arguments.laser else None
    if laser is None:
        laser = tuple(scenario.border.mean(axis=0)) if scenario else (world.room.size[0] / 2, world.room.size[1] / 2)
    person = None
    if arguments.person:
        person = (*arguments.person[:2], np.radians(arguments.person[2]))
    elif scenario:
        to_laser = np.array(laser) - scenario.stand
        person = (*scenario.stand, float(np.arctan2(to_laser[1], to_laser[0])))
    robots = {robot.name: robot.start_pose() for robot in world.robots}
    if arguments.robot:
        robots[world.robots[0].name] = (*arguments.robot[:2], float(np.radians(arguments.robot[2])))
    scene = Snapshot(1.0, robots, laser, arguments.color, (0.3, 0.0), person)
    radii = {robot.name: robot.radius for robot in world.robots}
    floor, mesh = render_floor(world, arguments.seed), world_mesh(world)
    for camera in world.cameras:
        view = CeilingView(camera, radii, floor, mesh, models, arguments.seed)
        _write(folder / f"{camera.name}.png", pixels.decode(view.frame(scene), view.encoding))
        _measure(camera.name, lambda: view.frame(scene), arguments.frames)
    for robot in world.robots:
        view = RobotView(robot, radii, floor, mesh, models, arguments.seed)
        _write(folder / f"{robot.name}.png", cv2.cvtColor(view.color(scene), cv2.COLOR_RGB2BGR))
        depth = view.depth(scene)
        colored = cv2.applyColorMap(cv2.convertScaleAbs(depth, alpha=255.0 / 4500.0), cv2.COLORMAP_TURBO)
        colored[depth == 0] = 0
        _write(folder / f"{robot.name}_depth.png", cv2.resize(colored, None, fx=4, fy=4, interpolation=cv2.INTER_NEAREST))
        _measure(f"{robot.name} colour", lambda: view.color(scene), arguments.frames)
        _measure(f"{robot.name} depth", lambda: view.depth(scene), arguments.frames)


def _write(path: Path, image: np.ndarray) -> None:
    cv2.imwrite(str(path), image)
    print(f"wrote {path}")


def _measure(name: str, render, frames: int) -> None:
    times = []
    for _ in range(max(0, frames)):
        started = time.thread_time()
        render()
        times.append(time.thread_time() - started)
    if times:
        print(f"  {name}: {1e3 * float(np.median(times)):.2f} ms per frame (CPU, median of {frames})")


if __name__ == "__main__":
    main()
