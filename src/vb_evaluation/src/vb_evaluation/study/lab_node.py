"""The simulated lab's nodes as a run starts them: with its own person, world and models, and with fewer images."""

from __future__ import annotations

import zlib
from typing import Any, Dict, List, Optional, Tuple, Type, TypeVar

import cv2
import numpy as np

from vb_core import geometry
from vb_laser_detect.detection.exposure import TOO_BRIGHT, saturated_share
from vb_sim.ceiling_cameras_node import CeilingCamerasNode
from vb_sim.cameras.ceiling_view import CeilingView
from vb_sim.room.floor_texture import FloorTexture, render_floor
from vb_sim.lab_history import Snapshot
from vb_sim.room.mesh import Mesh, world_mesh
from vb_sim.room.camera_models import CameraModels
from vb_sim.robot_camera_node import RobotCameraNode
from vb_sim.cameras.robot_view import RobotView
from vb_sim.room.world import CeilingCamera, Robot, World

View = TypeVar("View", CeilingView, RobotView)
FLOOR_SEED = 1  # everybody draws on the same floor
_SPOT_MARGIN_PX = 40.0  # a spot whose middle is outside the image by less may still shine into it


class RenderCache:
    """Keeps what all runs of a process share and is expensive to make: the room as it is drawn.

    Views are kept for one set of worlds and models; other ones replace them.
    """

    def __init__(self) -> None:
        # threads within a process would only fight with the other processes, and do not survive a fork
        cv2.setNumThreads(1)
        self._floor: Optional[FloorTexture] = None
        self._mesh: Optional[Mesh] = None
        self._views: Dict[str, Tuple[str, Any]] = {}
        self._floor_key: object = None

    def enter(self, world: World, models: CameraModels) -> None:
        """Prepares for runs in a world; the participant's body may be another one each time."""
        floor_key = repr((world.room, world.floor, world.walls, world.furniture, world.patches, world.lights))
        if floor_key != self._floor_key:
            self._floor, self._mesh = render_floor(world, FLOOR_SEED), world_mesh(world)
            self._floor_key = floor_key
            self._views.clear()
        self.world, self.models = world, models

    def view(self, kind: Type[View], whose: Any) -> View:
        """Returns the view of a ceiling camera, or of a robot's, before anything moved."""
        # the pointer's height differs with each body and is nothing that was drawn
        models, radii = self.models, self.world.robot_radii()
        key = repr((whose, models.optics, models.noise, models.robot_camera, sorted(radii.items())))
        name = f"{kind.__name__} {whose.name}"
        if name not in self._views or self._views[name][0] != key:
            self._views[name] = (key, kind(whose, radii, self._floor, self._mesh, models, FLOOR_SEED))
        view = self._views[name][1]
        view.restart(models)
        return view


def frame_generator(seed: int, camera: str, stamp: float) -> np.random.Generator:
    """Makes the generator of one frame's noise, the same whatever was rendered before it."""
    return np.random.default_rng([seed, zlib.crc32(camera.encode()), int(round(stamp * 1e4))])


class StudyCeilingCameras(CeilingCamerasNode):
    """Ceiling cameras that skip images in which no spot can be.

    An image without spot and without people or robots is skipped; one with them is sent every `idle_every`-th time
    only, as the detector updates its background with it.

    Args:
        idle_every: 1 sends every image.

    Attributes:
        too_bright: whether a camera's image of the empty room is one that the lab's own check would have darkened.
    """

    def __init__(self, cache: RenderCache, cameras: List[CeilingCamera], seed: int, idle_every: int) -> None:
        self._seed, self._idle_every = seed, idle_every
        self._idle = [0] * len(cameras)
        self._from_map = [geometry.invert(camera.pose()) for camera in cameras]
        views = [cache.view(CeilingView, camera) for camera in cameras]
        self.too_bright = any(
            saturated_share(view.frame(Snapshot(0.0), frame_generator(seed, camera.name, 0.0))) > TOO_BRIGHT
            for camera, view in zip(cameras, views)
        )
        super().__init__(cache.world, cache.models, cameras, seed, views)

    def _image(self, index: int, snapshot: Snapshot) -> Optional[np.ndarray]:
        if not self._is_relevant(index, snapshot):
            return None
        return self._views[index].frame(
            snapshot, frame_generator(self._seed, self._cameras[index].name, snapshot.stamp)
        )

    def _is_relevant(self, index: int, snapshot: Snapshot) -> bool:
        if self._idle_every == 1:
            return True
        if snapshot.laser is not None and self._shows(index, np.array([[*snapshot.laser, 0.0]]), _SPOT_MARGIN_PX):
            return True
        bodies = [(pose, 0.45, 2.1) for pose in [snapshot.person] if pose is not None]
        bodies += [(pose, 0.25, 0.5) for pose in snapshot.robots.values()]
        # a body's corners, and points between them: it may be larger than the image
        if not any(self._shows(index, _hull(*body), 0.0) for body in bodies):
            return False
        self._idle[index] = (self._idle[index] + 1) % self._idle_every
        return self._idle[index] == 0

    def _shows(self, index: int, points: np.ndarray, margin: float) -> bool:
        in_camera = geometry.apply(self._from_map[index], points)
        if (in_camera[:, 2] < 0.05).any():
            return True
        model = self._views[index].model
        pixels = model.project(in_camera)
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        return bool((high >= -margin).all() and low[0] <= model.width + margin and low[1] <= model.height + margin)


def _hull(pose: Tuple[float, float, float], radius: float, height: float) -> np.ndarray:
    x, y = pose[:2]
    sides = (-radius, radius)
    return np.array([(x + dx, y + dy, z) for dx in sides for dy in sides for z in (0.0, height)])


class StudyRobotCamera(RobotCameraNode):
    """A robot's camera that skips most images in which no spot can be.

    Of those it sends every `idle_every`-th: as many as the detector needs to know the floor and how the camera moved.
    """

    def __init__(self, cache: RenderCache, robot: Robot, seed: int, tf_prefix: str, idle_every: int) -> None:
        self._seed, self._idle_every, self._idle = seed, idle_every, 0
        super().__init__(cache.world, cache.models, robot, seed, tf_prefix, cache.view(RobotView, robot))

    def _wanted(self, snapshot: Snapshot) -> bool:
        if not self._is_relevant(snapshot):
            return False
        self._view.draw_from(frame_generator(self._seed, self._robot.name, snapshot.stamp))
        return True

    def _is_relevant(self, snapshot: Snapshot) -> bool:
        self._idle = (self._idle + 1) % self._idle_every
        if self._idle == 0:
            return True
        pose = self._view.camera_pose(snapshot)
        if snapshot.laser is None:
            return False
        spot = geometry.apply(geometry.invert(pose), np.array([[*snapshot.laser, 0.0]]))
        if spot[0, 2] < 0.05:
            return False
        (u, v), model = self._view.color_model.project(spot)[0], self._view.color_model
        return max(-u, u - model.width, -v, v - model.height) <= _SPOT_MARGIN_PX
