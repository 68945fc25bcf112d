"""Renders the images of a robot's colour and depth camera."""

from __future__ import annotations

import math
from typing import Dict, List, Optional, Tuple

import cv2
import numpy as np

from vb_core import geometry
from vb_core.geometry import Pose
from vb_sim.rendering.camera_view import Body, CameraView
from vb_sim.lab_history import Snapshot
from vb_sim.model_params import Models
from vb_sim.rendering import bodies
from vb_sim.rendering.floor_texture import FloorTexture
from vb_sim.rendering.laser_spot import SpotImage
from vb_sim.rendering.mesh import DepthBuffer, Mesh, RayGrid
from vb_sim.world import Robot

_CEILING = (206, 204, 198)
_TILES = 7
_FRONT_OFFSET = 0.05  # [m] from a round piece's centre to its front, where a flat piece represents it


class RobotView(CameraView):
    """Renders one robot's camera; arguments as for `CeilingView`. Colour and depth show the same geometry."""

    def __init__(
        self, robot: Robot, radii: Dict[str, float], floor: FloorTexture, mesh: Mesh, models: Models, seed: int
    ) -> None:
        name = f"camera of robot {robot.name}"
        super().__init__(name, robot.color_model(), "rgb8", radii, models, models.robot_camera, seed)
        self.robot = robot
        self.depth_model = robot.depth_model()
        self._own_names = {robot.name, robot.namespace.strip("/")}
        self._mount = robot.camera_mount()
        self._mesh = mesh
        self._floors = [floor]
        while len(self._floors) < 5 and min(self._floors[-1].rgb.shape[:2]) > 64:
            self._floors.append(self._floors[-1].halved())
        self._pose: Pose = robot.start_pose()
        self._buffer = DepthBuffer(RayGrid(self.model))
        self._object_ids = self._buffer.ids
        self._depth_grid = RayGrid(self.depth_model)
        x, y = self._depth_grid.x, self._depth_grid.y
        self._slant = np.sqrt(1.0 + x * x + y * y)
        # the rows and columns of the colour pixels that are nearest to the centres of the depth pixels
        rows = (np.arange(self.depth_model.height) + 0.5) * self.model.height / self.depth_model.height
        columns = (np.arange(self.depth_model.width) + 0.5) * self.model.width / self.depth_model.width
        self._sampled = np.ix_(rows.astype(int), columns.astype(int))
        self._drawn_key: Optional[Tuple] = None  # identifies the scene in the buffers
        self._make_noise()

    def restart(self, models: Models) -> None:
        """Resets the moving objects for another person in the same room. `models` may differ only in the body."""
        super().restart(models)
        self._pose = self.robot.start_pose()
        self._drawn_key = None

    def _make_noise(self) -> None:
        figures = self._noise_model
        shape = (self.model.height + 32, self.model.width + 32, 3)
        # read and photon noise at a medium brightness
        sigma = math.sqrt(figures.read_sigma**2 + 110.0 * 255.0 / figures.full_well_e)
        noise = sigma * self._rng.standard_normal(shape, dtype=np.float32)
        # the positive and the negative part, because saturating addition and subtraction are fast
        self._brighter = np.clip(noise + 0.5, 0, 255).astype(np.uint8)
        self._darker = np.clip(0.5 - noise, 0, 255).astype(np.uint8)
        depth_shape = (_TILES, self.depth_model.height, self.depth_model.width)
        self._depth_noise = self._rng.standard_normal(depth_shape, dtype=np.float32)
        self._depth_holes = self._rng.random(depth_shape) < figures.depth_holes

    def camera_pose(self, snapshot: Snapshot) -> np.ndarray:
        """Returns T_map_optical, 4x4. A robot that is missing from the scene keeps its last pose."""
        for name in self._own_names:
            if name in snapshot.robots:
                self._pose = snapshot.robots[name]
        return geometry.transform_from_pose2d(*self._pose) @ self._mount

    # ------------------------------------------------------------- scene
    def _draw(self, snapshot: Snapshot) -> None:
        """Draws all but spot and noise, unless nothing has moved since the last call."""
        pose = self.camera_pose(snapshot)
        others = [body for body in self._bodies(snapshot) if body.name not in self._own_names]
        key = (self._pose, [(body.name, body.key) for body in others])
        if key == self._drawn_key:
            return
        self._drawn_key = key
        image = self._draw_floor(pose)
        gain = self._optics.exposure_gain
        if gain != 1.0:
            image = cv2.convertScaleAbs(image, alpha=gain)
        self._buffer.clear()
        self._buffer.draw_mesh(self._mesh, pose, gain)
        if others:
            self._draw_bodies(others, pose, gain)
        self._buffer.paint(image)
        self._noiseless = cv2.GaussianBlur(image, (3, 3), 0.5)
        self._true_depth, self._depth_missing = self._compute_depth(pose)

    def _draw_bodies(self, others: List[Body], pose: np.ndarray, gain: float) -> None:
        pieces = bodies.join_pieces([body.build() for body in others])
        outlines = bodies.project_pieces(pieces, self.model, pose)
        towards_camera = np.array([0.0, 0.0, -1.0])
        for points, depth, color in zip(outlines.points, outlines.depths, outlines.colors):
            low = points.min(axis=0)
            high = points.max(axis=0)
            if (high < 0).any() or (low > (self.model.width, self.model.height)).any():
                continue
            front = max(0.1, float(depth) - _FRONT_OFFSET)
            self._buffer.draw_flat(points, front, 0.74 * gain * color, towards_camera)
            # lighter inside than at the rim, so that pieces look round
            center = 0.5 * (low + high)
            inner = center + 0.7 * (points - center)
            self._buffer.draw_flat(inner, front - 0.001, 0.95 * gain * color, towards_camera)

    # ------------------------------------------------------------- colour
    def image(self, snapshot: Snapshot) -> np.ndarray:
        """Renders the colour image, (480, 640, 3) uint8 rgb."""
        self._draw(snapshot)
        image = self._noiseless.copy()
        self._add_light(image, snapshot)
        top, left = self._rng.integers(0, 32, 2)
        part = (slice(top, top + image.shape[0]), slice(left, left + image.shape[1]))
        cv2.add(image, self._brighter[part], dst=image)
        cv2.subtract(image, self._darker[part], dst=image)
        return image

    def _albedo(self, spot: SpotImage) -> np.ndarray:
        column, row = spot.pixel
        white = np.float32(255.0 * self._optics.exposure_gain)
        return self._noiseless[row, column].astype(np.float32) / white

    def _draw_floor(self, pose: np.ndarray) -> np.ndarray:
        """Draws the floor by its homography, with coarser textures for more distant rows."""
        camera = self.model
        height, width = camera.height, camera.width
        rotation = pose[:3, :3]
        x, y, z = pose[:3, 3]
        # from homogeneous (column, row) [px] to map coordinates [m] on the floor
        floor_x = x * rotation[2] - z * rotation[0]
        floor_y = y * rotation[2] - z * rotation[1]
        ray_to_floor = np.array([floor_x, floor_y, rotation[2]])
        to_floor = ray_to_floor @ np.linalg.inv(camera.matrix)
        image = np.empty((height, width, 3), np.uint8)
        # how far the rays of each row fall per unit of depth gives the depth of the row's floor; 0 at the horizon
        ahead = (np.arange(height) - camera.matrix[1, 2]) / camera.matrix[1, 1]
        down = -(rotation[2, 1] * ahead + rotation[2, 2])
        with np.errstate(divide="ignore"):
            depth = np.where(down > 1e-3, z / down, np.inf)
        # a pixel covers depth/f across the view, and 1/down times as much along it; the geometric mean counts
        footprint = depth / camera.focal_px / np.sqrt(np.clip(down, 1e-3, 1.0))
        texels = np.maximum(footprint / self._floors[0].resolution, 1.0)
        levels = np.clip(np.floor(np.log2(texels)), 0, len(self._floors) - 1)
        levels[~np.isfinite(depth)] = -1
        changes = np.concatenate([[0], np.nonzero(np.diff(levels))[0] + 1, [height]])
        for first, last in zip(changes[:-1], changes[1:]):
            level = int(levels[first])
            if level < 0:
                image[first:last] = _CEILING
                continue
            texture = self._floors[level]
            shifted = to_floor @ np.array([[1, 0, 0], [0, 1, first], [0, 0, 1.0]])
            cv2.warpPerspective(
                texture.rgb,
                texture.matrix() @ shifted,
                (width, int(last - first)),
                dst=image[first:last],
                # the nearest texel suffices, because textures are as fine as the pixels, and takes a third of the time
                flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP,
                borderMode=cv2.BORDER_REPLICATE,
            )
        return image

    # ------------------------------------------------------------- depth
    def depth(self, snapshot: Snapshot) -> np.ndarray:
        """Renders the depth image, (120, 160) uint16 [mm] along the optical axis, 0 if unknown."""
        self._draw(snapshot)
        depth = self._true_depth
        figures = self._noise_model
        tile = int(self._rng.integers(_TILES))
        growth = np.float32(figures.depth_sigma_quadratic) * (depth - np.float32(0.4)) ** 2
        sigma = np.float32(figures.depth_sigma) + growth
        # flipping increases the number of different tiles
        row_step = 1 - 2 * int(self._rng.integers(2))
        column_step = 1 - 2 * int(self._rng.integers(2))
        noise = self._depth_noise[tile, ::row_step, ::column_step]
        rounded = (depth + sigma * noise) * np.float32(1000.0) + np.float32(0.5)
        millimeters = np.clip(rounded, 0, 65535).astype(np.uint16)
        millimeters[self._depth_missing | self._depth_holes[tile]] = 0
        return millimeters

    def _compute_depth(self, pose: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Computes the true depth (120, 160) float32 [m], and where the sensor cannot measure it, (120, 160) bool."""
        grid, figures = self._depth_grid, self._noise_model
        ids = self._buffer.ids[self._sampled]
        down = -grid.dot_rays(*pose[2, :3])
        is_floor = ids == 0
        floor_inverse = down / np.float32(pose[2, 3])
        inverse = np.where(is_floor, floor_inverse, self._buffer.inverse[self._sampled])
        depth = np.float32(1.0) / np.maximum(inverse, np.float32(1e-3))
        # cosine of the angle between ray and surface normal
        normals = self._buffer.normals[ids]
        cosine = -(normals[..., 0] * grid.x + normals[..., 1] * grid.y + normals[..., 2])
        cosine = np.where(is_floor, down, cosine) / self._slant
        grazing = cosine < math.cos(math.radians(figures.depth_grazing_deg))
        blind = grazing | (depth < figures.depth_min) | (depth > figures.depth_max)
        return depth, blind
