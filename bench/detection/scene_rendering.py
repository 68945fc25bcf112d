"""Rendered scenes for the spot detector (scene_list.py): a scene says what is where at a time; `frames` renders it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache, partial
from types import SimpleNamespace
from typing import Any, Callable, Iterator, Tuple

import numpy as np
import yaml

from bench.detection.scene_disturbances import DisturbedSnapshot, SceneConditions
from bench.detection.detector_under_test import LabeledFrame
from bench.detection.scene_motions import Place, place_and_velocity
from bench.detection.scene_rooms import Rooms
from bench.harness import TOP
from vb_sim.models import make_generator
from vb_sim.room.floor_plan import physical_map
from vb_sim.room.world import World

RATE = 25.0
LEARN_S, QUIET_S, DRAW_S = 1.0, 8.0, 10.0  # [s] the empty room, the disturbance alone, then with the laser
NEAR_MM = 100.0  # a spot further from the laser is a false one
SEEN = 0.5  # a camera sees the spot if this share of its light arrives


@dataclass(frozen=True)
class Scene:
    """One case.

    Attributes:
        worlds: the rooms; `world_at` says which of them is there at a time [s], for things that are moved.
        laser_at: (x, y) [m] of the spot at a time [s].
        around_at: what else changes at a time [s].
        robot_at: (x, y, yaw) of the robot at a time [s]; its camera is used if `mobile`, else the ceiling's.
    """

    name: str
    laser_at: Callable[[float], Place]
    worlds: Tuple[World, ...]
    world_at: Callable[[float], int] = lambda t: 0
    around_at: Callable[[float], SceneConditions] = lambda t: SceneConditions()
    color: str = "red"
    mobile: bool = False
    camera: str = "green"
    robot_at: Callable[[float], Tuple[float, float, float]] = lambda t: (7.6, 0.4, 2.6)
    person: bool = True

    @property
    def role(self) -> str:
        return "mobile" if self.mobile else "stationary"

    @property
    def title(self) -> str:
        """The name, prefixed with the camera that is used."""
        return ("robot: " if self.mobile else "ceiling: ") + self.name


def course(scene: Scene, share: float = 1.0, learn_s: float = LEARN_S) -> Iterator[Tuple[int, DisturbedSnapshot]]:
    """Yields (world's index, snapshot) of a share of a scene: the empty room, the disturbance alone, the laser too."""
    before = learn_s + share * QUIET_S
    for k in range(int(RATE * (before + share * DRAW_S))):
        t = k / RATE
        laser, velocity, person = None, (0.0, 0.0), None
        if t >= before:
            laser, velocity = place_and_velocity(scene.laser_at, t - before)
        if scene.person:
            # beside what is drawn, so that neither the body nor its shadow is always in the way
            target = laser or scene.laser_at(0.0)
            person = (4.6, 2.9, math.atan2(target[1] - 2.9, target[0] - 4.6))
        around = scene.around_at(t) if t >= learn_s else SceneConditions()
        snapshot = DisturbedSnapshot(t, {"robot": scene.robot_at(t)}, laser, scene.color, velocity, person, around)
        yield scene.world_at(t) if t >= learn_s else 0, snapshot


def frames(
    scene: Scene, rooms: Rooms, share: float = 1.0, learn_s: float = LEARN_S, clear: float = SEEN, on_floor: bool = True
) -> Iterator[LabeledFrame]:
    """Renders a share of one scene's time.

    Args:
        clear: share of a spot's light below which the spot is unclear.
        on_floor: whether spots are given on the floor [mm], as `floor_place` gives detected ones, or in the image [px].
    """
    config = yaml.safe_load((TOP / f"src/vb_laser_detect/config/{scene.role}.yaml").read_text())["projection"]
    floor = physical_map(scene.worlds[0])

    @lru_cache(maxsize=None)
    def floor_projection(version: Any) -> Any:
        return version.FloorProjection(version.ProjectionParams.from_mapping(config), floor)

    def geometry(view: Any, snapshot: DisturbedSnapshot, lookups: Any, version: Any) -> Any:
        return version.ImageGeometry(view.model, floor_projection(version), view.camera_pose(snapshot), lookups)

    views = [rooms.view(world, "" if scene.mobile else scene.camera) for world in scene.worlds]
    first = next(course(scene))[1]
    for view in views:
        # a scene's noise depends on the scene alone, not on those played before in the same room
        view.set_noise_generator(make_generator(rooms.seed, f"scene {scene.name}"))
        if not scene.mobile:
            view.frame(first)
    for index, snapshot in course(scene, share, learn_s):
        view, places = views[index], []
        image = view.frame(snapshot)
        if snapshot.laser is not None and on_floor:
            places = [(1e3 * snapshot.laser[0], 1e3 * snapshot.laser[1])]
        elif view.spot(snapshot) is not None:
            places = [tuple(view.spot(snapshot).center)]
        seen, unclear = (places, []) if view.spot_share(snapshot) >= clear else ([], places)
        # drawn with noise, so only if it is needed, and once for all versions
        draw = lru_cache(maxsize=None)(lambda *image: (view.depth(snapshot), view.depth_model))
        lookups = SimpleNamespace(depth_at=draw, cylinders=lambda stamp: ()) if scene.mobile else None
        here = partial(geometry, view, snapshot, lookups)
        yield LabeledFrame(snapshot.stamp, image, seen, unclear, here, encoding=view.encoding)


def floor_place(spot: Any) -> np.ndarray:
    """Returns where a spot was found on the floor, (2,) [mm]."""
    return 1e3 * spot.floor_point.position[:2]
