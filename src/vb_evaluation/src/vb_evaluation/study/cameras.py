"""The cameras of one run: rendered and searched in one process, wherever a spot can be seen."""
from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Callable, Dict, List, Optional, Sequence, Tuple

import cv2
import numpy as np
import yaml

from vb_core import geometry
from vb_core.grid_map import GridMap
from vb_evaluation.study.config import top
from vb_laser_detect.detector import DetectorParams, Spot, SpotDetector
from vb_laser_detect.frame import Frame, placed, search
from vb_laser_detect.projection import FloorProjector, ProjectionParams
from vb_sim.camera_calibration import calibrated_pose
from vb_sim.ceiling_view import CeilingView
from vb_sim.floor_texture import FloorTexture, render_floor
from vb_sim.lab_history import Snapshot
from vb_sim.mesh import Mesh, world_mesh
from vb_sim.models_cameras import CameraModels
from vb_sim.robot_view import RobotView
from vb_sim.world import CeilingCamera, Robot, World

FLOOR_SEED = 1  # everybody draws on the same floor
_SPOT_MARGIN_PX = 40.0  # a spot whose middle is outside the picture by less may still shine into it
_IDLE_EVERY = 5  # of a robot's pictures that cannot show the spot: so far it turns that the next one can be matched


@dataclass(frozen=True)
class Seen:
    """One spot as a camera reports it: stamp [s], place (x, y) [m] in the map frame."""

    stamp: float
    position: Tuple[float, float]
    camera: str
    mobile: bool
    confidence: float


class Room:
    """What is the same in all runs of a process, and dear to make: the room as it is drawn.

    Pictures are kept for one set of worlds and models; other ones replace them.
    """

    def __init__(self) -> None:
        # threads within a process would only fight with the other processes, and do not survive a fork
        cv2.setNumThreads(1)
        self._floor: Optional[FloorTexture] = None
        self._mesh: Optional[Mesh] = None
        self._views: Dict[str, object] = {}
        self._floor_key: object = None

    def enter(self, world: World, models: CameraModels) -> None:
        """Prepares for runs in a world; the participant's body may be another one each time."""
        floor_key = repr((world.room, world.floor, world.walls, world.furniture, world.patches, world.lights))
        if floor_key != self._floor_key:
            self._floor, self._mesh = render_floor(world, FLOOR_SEED), world_mesh(world)
            self._floor_key = floor_key
            self._views.clear()
        self._world, self._models = world, models

    def prepare(self, world: World, models: CameraModels) -> None:
        """Draws all that any run in a world needs; processes that are forked later share it."""
        self.enter(world, models)
        for camera in world.cameras:
            self.ceiling_view(camera)
        for robot in world.robots:
            self.robot_view(robot)

    def ceiling_view(self, camera: CeilingCamera) -> CeilingView:
        """The view of a ceiling camera, as nobody has moved yet."""
        return self._fresh(("ceiling", camera), lambda floor, mesh: CeilingView(
            camera, self._world.robot_radii(), floor, mesh, self._models, FLOOR_SEED))

    def robot_view(self, robot: Robot) -> RobotView:
        """The view of a robot's camera, as nobody has moved yet."""
        return self._fresh(("robot", robot), lambda floor, mesh: RobotView(
            robot, self._world.robot_radii(), floor, mesh, self._models, FLOOR_SEED))

    def _fresh(self, what: Tuple, make: Callable):
        # the pointer's height differs with each body and is nothing that was drawn
        figures = (self._models.optics, self._models.noise, self._models.robot_camera)
        key = repr((what, figures, sorted(self._world.robot_radii().items())))
        name = repr((what[0], what[1].name))
        known = self._views.get(name)
        if known is None or known[0] != key:
            known = (key, make(self._floor, self._mesh))
            self._views[name] = known
        known[1].restart(self._models)
        return known[1]


@lru_cache(maxsize=None)
def detector_params(kind: str) -> Tuple[DetectorParams, ProjectionParams]:
    """What the live detector nodes are started with; kind is "stationary" or "mobile"."""
    path = top() / "src" / "vb_laser_detect" / "config" / f"{kind}.yaml"
    document = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    return (DetectorParams.from_mapping(document.get("detector"), "detector"),
            ProjectionParams.from_mapping(document.get("projection"), "projection"))


def frame_generator(seed: int, camera: str, stamp: float) -> np.random.Generator:
    """The noise of one frame, whatever was rendered before it."""
    return np.random.default_rng([seed, zlib.crc32(camera.encode()), int(round(stamp * 1e4))])


class StationaryCamera:
    """A ceiling camera and its detector.

    While the spot cannot be in the picture nothing can be found in it. A picture without spot and without people or
    robots is skipped; one with them is taken every `idle_every`-th time only, for the detector learns from it what
    is no spot.
    """

    def __init__(
        self, camera: CeilingCamera, view: CeilingView, models: CameraModels, grid: GridMap, seed: int, idle_every: int
    ) -> None:
        self.name = camera.name
        self.rate = camera.rate
        self.rendered = self.skipped = 0
        self._view = view
        self._seed = seed
        self._encoding = camera.encoding
        detecting, projecting = detector_params("stationary")
        self._detector = SpotDetector(detecting)
        self._projector = FloorProjector(projecting, grid)
        self._pose = calibrated_pose(camera, models.optics, seed)
        self._from_map = geometry.invert(camera.pose())
        self._idle_every = idle_every
        self._idle = 0

    def look(self, stamp: float, snapshot: Snapshot) -> List[Seen]:
        """Takes the picture of a moment and searches it."""
        if not self._worth_a_look(snapshot):
            self.skipped += 1
            return []
        self.rendered += 1
        image = self._view.frame(snapshot, frame_generator(self._seed, self.name, stamp))
        frame = Frame(self._view.model, lambda: self._pose, self._projector, stamp=stamp)
        spots = search(self._detector, image, stamp, frame, self._encoding)
        return [_seen(*found, self.name, False) for found in placed(self._detector, spots, frame)]

    def _worth_a_look(self, snapshot: Snapshot) -> bool:
        if snapshot.laser is not None and self._shows(np.array([[*snapshot.laser, 0.0]]), _SPOT_MARGIN_PX):
            return True
        bodies = [(pose, 0.45, 2.1) for pose in [snapshot.person] if pose is not None]
        bodies += [(pose, 0.25, 0.5) for pose in snapshot.robots.values()]
        # a body's corners, and points between them: it may be larger than the picture
        if self._idle_every == 1 or not any(self._shows(_hull(*body), 0.0) for body in bodies):
            return self._idle_every == 1
        self._idle = (self._idle + 1) % self._idle_every
        return self._idle == 0

    def _shows(self, points: np.ndarray, margin: float) -> bool:
        in_camera = geometry.apply(self._from_map, points)
        if (in_camera[:, 2] < 0.05).any():
            return True
        model = self._view.model
        pixels = model.project(in_camera)
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        return bool((high >= -margin).all() and low[0] <= model.width + margin and low[1] <= model.height + margin)


def _hull(pose: Tuple[float, float, float], radius: float, height: float) -> np.ndarray:
    x, y = pose[:2]
    sides = (-radius, radius)
    return np.array([(x + dx, y + dy, z) for dx in sides for dy in sides for z in (0.0, height)])


class RobotCamera:
    """A robot's colour and depth camera and its detector.

    While the spot cannot be in the picture only every n-th picture is drawn and searched, as many as the detector needs to
    know the floor and how the camera moved; `whole` draws and searches all of them.
    """

    def __init__(
        self, robot: Robot, view: RobotView, models: CameraModels, grid: GridMap, seed: int,
        pose_at: Callable[[float], Tuple[float, float, float]], whole: bool = False,
    ) -> None:
        self.name = robot.namespace.strip("/") or "robot"
        self.rate = robot.camera_rate
        self.rendered = self.skipped = 0
        self._view = view
        self._seed = seed
        self._pose_at = pose_at
        self._whole = whole
        detecting, projecting = detector_params("mobile")
        self._detector = SpotDetector(detecting)
        self._projector = FloorProjector(projecting, grid)
        self._mount = robot.camera_mount()
        self._every = models.robot_camera.depth_every
        self._frames = self._idle = 0
        self._depth: Tuple[float, Optional[np.ndarray]] = (-math.inf, None)  # stamp, picture

    def look(self, stamp: float, snapshot: Snapshot) -> List[Seen]:
        """Takes the picture of a moment and searches it."""
        self._frames += 1
        if not self._worth_a_look(snapshot):
            self.skipped += 1
            self._view.camera_pose(snapshot)
            return []
        self.rendered += 1
        self._view.draw_from(frame_generator(self._seed, self.name, stamp))
        # a depth picture comes with every n-th colour picture
        if self._frames % self._every == 0 or stamp - self._depth[0] > (self._every - 0.5) / self.rate:
            self._depth = (stamp, self._view.depth(snapshot))
        depth = (self._depth[1], self._view.depth_model)
        image = self._view.color(snapshot)
        frame = Frame(self._view.color_model, lambda: self._estimated(stamp), self._projector, lambda: depth, stamp)
        spots = search(self._detector, image, stamp, frame, "bgr8")
        return [_seen(*found, self.name, True) for found in placed(self._detector, spots, frame)]

    def _estimated(self, stamp: float) -> np.ndarray:
        return geometry.pose2d_transform(*self._pose_at(stamp)) @ self._mount

    def _worth_a_look(self, snapshot: Snapshot) -> bool:
        self._idle = (self._idle + 1) % _IDLE_EVERY
        if self._whole or self._idle == 0:
            return True
        if snapshot.laser is None:
            return False
        spot = geometry.apply(geometry.invert(self._view.camera_pose(snapshot)), np.array([[*snapshot.laser, 0.0]]))
        if spot[0, 2] < 0.05:
            return False
        (u, v), model = self._view.color_model.project(spot)[0], self._view.color_model
        return max(-u, u - model.width, -v, v - model.height) <= _SPOT_MARGIN_PX


def _seen(frame: Frame, spot: Spot, camera: str, mobile: bool) -> Seen:
    x, y = (float(value) for value in frame.point(spot.u, spot.v).position[:2])
    return Seen(frame.stamp, (x, y), camera, mobile, float(np.float32(spot.confidence)))


def spot_counts(seen: Sequence[Seen]) -> Dict[str, int]:
    """How many spots each camera reported."""
    counts: Dict[str, int] = {}
    for spot in seen:
        counts[spot.camera] = counts.get(spot.camera, 0) + 1
    return counts
