"""The study's cameras: the simulated lab's camera nodes with a run's own person, world and models, and with fewer images."""

from __future__ import annotations

import zlib
from typing import Any, Dict, List, Optional, Tuple, Type, TypeVar

import cv2
import numpy as np

from vb_core import geometry
from vb_laser_detect.camera.exposure import TOO_BRIGHT, saturated_share
from vb_sim.cameras.camera_node import CameraNode, SimulatedCamera
from vb_sim.rendering.ceiling_view import CeilingView
from vb_sim.rendering.robot_view import RobotView
from vb_sim.ceiling_cameras_node import make_ceiling_camera
from vb_sim.lab_history import Snapshot
from vb_sim.model_params import Models
from vb_sim.robot_camera_node import make_robot_camera
from vb_sim.rendering.floor_texture import FloorTexture, render_floor
from vb_sim.rendering.mesh import Mesh, world_mesh
from vb_sim.world import CeilingCamera, Robot, World

ViewT = TypeVar("ViewT", CeilingView, RobotView)
FLOOR_SEED = 1  # everybody draws on the same floor
_SPOT_MARGIN_PX = 40.0  # a spot whose middle is outside the image by less may still shine into it


class RenderCache:
    """Keeps the rendered room, which is expensive to make and shared by all runs of a process.

    It holds views for one set of worlds and models at a time.

    Attributes:
        world, models: those of the present run; set by `enter`.
    """

    def __init__(self) -> None:
        # threads within a process would only compete with the other processes, and do not survive a fork
        cv2.setNumThreads(1)
        self._floor: Optional[FloorTexture] = None
        self._mesh: Optional[Mesh] = None
        self._views: Dict[str, Tuple[str, Any]] = {}  # by name, (text of what the view depends on, view)
        self._floor_key: object = None

    def enter(self, world: World, models: Models) -> None:
        """Prepares for runs in a world. The participant's body may differ each time."""
        floor_key = repr((world.room, world.floor, world.walls, world.furniture, world.patches, world.lights))
        if floor_key != self._floor_key:
            self._floor = render_floor(world, FLOOR_SEED)
            self._mesh = world_mesh(world)
            self._floor_key = floor_key
            self._views.clear()
        self.world, self.models = world, models

    def view(self, kind: Type[ViewT], whose: Any) -> ViewT:
        """Returns the view of a ceiling camera, or of a robot's, before anything has moved."""
        # without the body: the pointer's height depends on it, but nothing that was rendered does
        models = self.models
        radii = self.world.robot_radii()
        key = repr((whose, models.optics, models.camera_noise, models.robot_camera, sorted(radii.items())))
        name = f"{kind.__name__} {whose.name}"
        if name not in self._views or self._views[name][0] != key:
            self._views[name] = (key, kind(whose, radii, self._floor, self._mesh, models, FLOOR_SEED))
        view = self._views[name][1]
        view.restart(models)
        return view


def image_noise_generator(seed: int, camera: str, stamp: float) -> np.random.Generator:
    """Makes the random generator of one image's noise, independent of what was rendered before."""
    return np.random.default_rng([seed, zlib.crc32(camera.encode()), int(round(stamp * 1e4))])


class StudyCameras(CameraNode):
    """Cameras whose images do not depend on those before, and that skip most images in which there can be no spot.

    Args:
        seed: seed of the images' noise.
        idle_every: at most every n-th image without a spot is sent; 1 sends every image.
    """

    def __init__(self, cameras: List[SimulatedCamera], latency_ms: float, seed: int, idle_every: int) -> None:
        self._seed, self._idle_every = seed, idle_every
        self._idle = dict.fromkeys([camera.name for camera in cameras], 0)
        super().__init__(cameras, latency_ms)

    def _is_wanted(self, camera: SimulatedCamera, snapshot: Snapshot) -> bool:
        if not self._is_relevant(camera, snapshot):
            return False
        camera.view.set_noise_generator(image_noise_generator(self._seed, camera.name, snapshot.stamp))
        return True

    def _is_relevant(self, camera: SimulatedCamera, snapshot: Snapshot) -> bool:
        raise NotImplementedError

    def _is_due(self, camera: SimulatedCamera) -> bool:
        self._idle[camera.name] = (self._idle[camera.name] + 1) % self._idle_every
        return self._idle[camera.name] == 0


class StudyCeilingCameras(StudyCameras):
    """Skips images of the bare floor. Sends every n-th with bodies but no spot, for the detector to learn the floor.

    Attributes:
        too_bright: whether a camera's image of the empty room is too bright by the lab's own check of exposure.
    """

    def __init__(self, cache: RenderCache, cameras: List[CeilingCamera], seed: int, idle_every: int) -> None:
        optics = cache.models.optics
        simulated = []
        self.too_bright = False
        for camera in cameras:
            view = cache.view(CeilingView, camera)
            view.set_noise_generator(image_noise_generator(seed, camera.name, 0.0))
            self.too_bright |= saturated_share(view.image(Snapshot(0.0))) > TOO_BRIGHT
            simulated.append(make_ceiling_camera(camera, view, optics, seed))
        super().__init__(simulated, optics.latency_ms, seed, idle_every)

    def _is_relevant(self, camera: SimulatedCamera, snapshot: Snapshot) -> bool:
        if self._idle_every == 1 or _may_show_spot(camera, snapshot):
            return True
        bodies = [(pose, 0.45, 2.1) for pose in [snapshot.person] if pose is not None]
        bodies += [(pose, 0.25, 0.5) for pose in snapshot.robots.values()]
        # by the bounding box of a body's corners: the body may be larger than the image
        shows_body = any(_shows(camera, snapshot, _hull(*body), 0.0) for body in bodies)
        return shows_body and self._is_due(camera)


class StudyRobotCamera(StudyCameras):
    """Sends images that may show the spot, and every n-th one, for the detector to learn floor and camera motion."""

    def __init__(self, cache: RenderCache, robot: Robot, seed: int, tf_prefix: str, idle_every: int) -> None:
        models = cache.models
        simulated = make_robot_camera(robot, cache.view(RobotView, robot), tf_prefix)
        super().__init__([simulated], models.optics.latency_ms, seed, idle_every)

    def _is_relevant(self, camera: SimulatedCamera, snapshot: Snapshot) -> bool:
        return self._is_due(camera) or _may_show_spot(camera, snapshot, behind=False)


def _may_show_spot(camera: SimulatedCamera, snapshot: Snapshot, behind: bool = True) -> bool:
    laser = snapshot.laser
    return laser is not None and _shows(camera, snapshot, np.array([[*laser, 0.0]]), _SPOT_MARGIN_PX, behind)


def _shows(camera: SimulatedCamera, snapshot: Snapshot, points: np.ndarray, margin: float, behind: bool = True) -> bool:
    """Returns whether a camera may show any part of what points (N, 3) [m] enclose.

    Args:
        margin: [px] around the image that counts too.
        behind: the answer if some of the points are behind the camera.
    """
    T_camera_map = geometry.invert_transform(camera.view.camera_pose(snapshot))
    in_camera = geometry.transform_points(T_camera_map, points)
    if (in_camera[:, 2] < 0.05).any():
        return behind
    model = camera.view.model
    pixels = model.project(in_camera)
    # in both coordinates, what is shown neither ends before the image begins nor begins after it ends
    ends_after = pixels.max(axis=0) >= -margin
    begins_before = pixels.min(axis=0) <= np.array([model.width, model.height]) + margin
    return bool(ends_after.all() and begins_before.all())


def _hull(pose: Tuple[float, float, float], radius: float, height: float) -> np.ndarray:
    x, y = pose[:2]
    sides = (-radius, radius)
    return np.array([(x + dx, y + dy, z) for dx in sides for dy in sides for z in (0.0, height)])
