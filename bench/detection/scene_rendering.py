"""Renders scenes for the spot detector (scene_list.py): `frames` renders a `Scene` in rooms that vary the simulated lab."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, Callable, Iterator, List, Sequence, Tuple

import numpy as np
import yaml

from bench.detection.scene_disturbances import DisturbedSnapshot, SceneConditions, with_disturbances
from bench.detection.detector_under_test import LabeledFrame
from bench.detection.scene_motions import ScenePoint, place_and_velocity
from bench.harness import TOP
from vb_sim.model_params import Models, make_generator
from vb_sim.floor_plan import physical_map
from vb_sim.rendering.ceiling_view import CeilingView
from vb_sim.rendering.floor_texture import FloorTexture, render_floor
from vb_sim.rendering.mesh import world_mesh
from vb_sim.rendering.robot_view import RobotView
from vb_sim.world import FloorPatch, World, load_world

RATE = 25.0
# [s] with the empty room, then with the disturbance, then with the laser too
LEARN_S, QUIET_S, DRAW_S = 1.0, 8.0, 10.0
NEAR_MM = 100.0  # [mm] from the laser, beyond which a spot is false
SEEN = 0.5  # share of its light at which a spot counts as seen by a camera


def lab(**changes: Any) -> World:
    """Returns the lab with these changes."""
    return replace(load_world(str(TOP / "src/vb_sim/worlds/lab.yaml")), **changes)


def tiles(room: World, color: Sequence[int], contrast: float = 0.06) -> World:
    """Returns the lab with another, empty floor."""
    return lab(floor=replace(room.floor, kind="tiles", color=color, contrast=contrast), patches=(), lights=())


def with_camera(world: World, **changes: Any) -> World:
    """Returns the world with changes to the ceiling camera that the scenes use."""
    cameras = [replace(camera, **changes) if camera.name == "green" else camera for camera in world.cameras]
    return replace(world, cameras=tuple(cameras))


def with_dots(
    world: World, places: Sequence[ScenePoint], colors: Sequence[Sequence[int]], size: float = 0.018
) -> World:
    """Returns a world with printed dots of a size [m] on the floor."""
    dots = (
        {"name": "dot", "x": x, "y": y, "size": [size, size], "color": list(color), "contrast": 0.0}
        for (x, y), color in zip(places, colors)
    )
    return replace(world, patches=world.patches + tuple(map(FloorPatch.from_mapping, dots)))


class Rooms:
    """Draws each room once, since most scenes share a room."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self._views: List[Tuple[World, str, Any]] = []
        self._floors: List[Tuple[World, FloorTexture]] = []

    def view(self, world: World, camera: str) -> Any:
        """Returns a ceiling camera's view, or the robot camera's if the name is empty."""
        for cached, name, view in self._views:
            if cached is world and name == camera:
                return view
        floor = next((floor for cached, floor in self._floors if _same_floor(cached, world)), None)
        if floor is None:
            floor = render_floor(world, self.seed)
            self._floors.append((world, floor))
        mesh, radii = world_mesh(world), world.robot_radii()
        kind, device = (CeilingView, world.camera(camera)) if camera else (RobotView, world.robots[0])
        view = with_disturbances(kind)(device, radii, floor, mesh, Models(), self.seed)
        self._views.append((world, camera, view))
        return view


def _same_floor(a: World, b: World) -> bool:
    return all(getattr(a, part) == getattr(b, part) for part in "room floor walls furniture patches lights".split())


@dataclass(frozen=True)
class Scene:
    """One case; its functions take a time [s].

    Attributes:
        worlds: the room before and after objects are moved; `world_at` returns the index of the current one.
        laser_at: returns (x, y) [m] of the spot.
        conditions_at: returns the conditions in the room.
        robot_at: returns (x, y, yaw) of the robot, whose camera is used if `mobile`; otherwise the ceiling camera is.
    """

    name: str
    laser_at: Callable[[float], ScenePoint]
    worlds: Tuple[World, ...]
    world_at: Callable[[float], int] = lambda t: 0
    conditions_at: Callable[[float], SceneConditions] = lambda t: SceneConditions()
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
        """The name, prefixed with the kind of camera."""
        return f"{'robot' if self.mobile else 'ceiling'}: {self.name}"


def course(scene: Scene, share: float = 1.0, learn_s: float = LEARN_S) -> Iterator[Tuple[int, DisturbedSnapshot]]:
    """Yields (index of the world, snapshot) of a share of a scene: first the empty room, later the laser too."""
    laser_start = learn_s + share * QUIET_S
    for k in range(int(RATE * (laser_start + share * DRAW_S))):
        t = k / RATE
        laser, velocity, person = None, (0.0, 0.0), None
        if t >= laser_start:
            laser, velocity = place_and_velocity(scene.laser_at, t - laser_start)
        if scene.person:
            # the person stands beside the drawing, so that neither body nor shadow always hides it
            target = laser or scene.laser_at(0.0)
            person = (4.6, 2.9, math.atan2(target[1] - 2.9, target[0] - 4.6))
        conditions = scene.conditions_at(t) if t >= learn_s else SceneConditions()
        snapshot = DisturbedSnapshot(t, {"robot": scene.robot_at(t)}, laser, scene.color, velocity, person, conditions)
        world = scene.world_at(t) if t >= learn_s else 0
        yield world, snapshot


def frames(
    scene: Scene, rooms: Rooms, share: float = 1.0, learn_s: float = LEARN_S, clear: float = SEEN, on_floor: bool = True
) -> Iterator[LabeledFrame]:
    """Renders a share of one scene's time.

    Args:
        clear: share of a spot's light below which it counts as unclear.
        on_floor: whether the spots' positions are on the floor [mm], like those of `floor_place`, or in the image [px].
    """
    config = yaml.safe_load((TOP / f"src/vb_laser_detect/config/{scene.role}.yaml").read_text())["projection"]
    floor = physical_map(scene.worlds[0])

    @lru_cache(maxsize=None)
    def floor_projection(version: Any) -> Any:
        return version.FloorProjection(version.ProjectionParams.from_mapping(config), floor)

    def geometry(view: Any, snapshot: DisturbedSnapshot, find_depth: Any, version: Any) -> Any:
        pose = view.camera_pose(snapshot)
        return version.ImageGeometry(view.model, floor_projection(version), lambda: pose, find_depth)

    views = [rooms.view(world, "" if scene.mobile else scene.camera) for world in scene.worlds]
    first = next(course(scene))[1]
    for view in views:
        # a scene's noise depends only on the scene, not on earlier ones in the same room
        view.set_noise_generator(make_generator(rooms.seed, f"scene {scene.name}"))
        if not scene.mobile:
            view.image(first)
    for index, snapshot in course(scene, share, learn_s):
        view = views[index]
        places = []
        image = view.image(snapshot)
        if snapshot.laser is not None and on_floor:
            places = [(1e3 * snapshot.laser[0], 1e3 * snapshot.laser[1])]
        elif view.spot(snapshot) is not None:
            places = [tuple(view.spot(snapshot).center)]
        is_clear = view.spot_share(snapshot) >= clear
        seen, unclear = (places, []) if is_clear else ([], places)
        # depth is rendered with random noise, hence only if needed, and once for all versions
        draw = lru_cache(maxsize=None)(lambda: (view.depth(snapshot), view.depth_model))
        frame_geometry = partial(geometry, view, snapshot, draw if scene.mobile else None)
        yield LabeledFrame(snapshot.stamp, image, seen, unclear, frame_geometry, encoding=view.encoding)


def floor_place(spot: Any) -> np.ndarray:
    """Returns the position (2,) [mm] of a detected spot on the floor."""
    return 1e3 * spot.floor_point.position[:2]
