"""Renders what a robot's colour and depth camera see."""

from __future__ import annotations

import math
from typing import Dict, List, Optional, Tuple

import cv2
import numpy as np

from vb_core import geometry
from vb_sim.room import bodies, disturbances
from vb_sim.room.floor_texture import FloorTexture
from vb_sim.lab_history import Pose2, Snapshot
from vb_sim.room.mesh import DepthBuffer, Mesh, RayGrid
from vb_sim.room.camera_models import CameraModels, make_generator
from vb_sim.room.spot import SpotImage, add_spot, render_spot
from vb_sim.room.world import Robot

_CEILING = (206, 204, 198)
_TILES = 7
# a flat piece represents a round one: its front is this much nearer than its middle [m]
_FRONT = 0.05


class RobotView:
    """Renders the camera of one robot; colour and depth show the same geometry.

    Args:
        robot: whose camera.
        radii: name of each robot to its radius [m].
        floor, mesh: the world as it is drawn.
        models: figures of optics and noise.
        seed: of the noise.
        noise: False renders without noise (depth keeps its holes at edges of its range and at flat angles).
    """

    def __init__(
        self,
        robot: Robot,
        radii: Dict[str, float],
        floor: FloorTexture,
        mesh: Mesh,
        models: CameraModels,
        seed: int,
        noise: bool = True,
    ) -> None:
        self.robot = robot
        self.color_model, self.depth_model = robot.color_model(), robot.depth_model()
        self._names = {robot.name, robot.namespace.strip("/")}
        self._radii = radii
        self._mount = robot.camera_mount()
        self._optics, self._figures = models.optics, models.robot_camera
        self._body, self._hand_height = models.body, models.hand_height
        self._mesh = mesh
        self._noisy = noise
        self._rng = make_generator(seed, f"camera of robot {robot.name}")
        self._floors = [floor]
        while len(self._floors) < 5 and min(self._floors[-1].rgb.shape[:2]) > 64:
            self._floors.append(self._floors[-1].halved())
        self._pose: Pose2 = robot.start_pose()
        self._buffer = DepthBuffer(RayGrid(self.color_model))
        self._depth_grid = RayGrid(self.depth_model)
        x, y = self._depth_grid.x, self._depth_grid.y
        self._slant = np.sqrt(1.0 + x * x + y * y)
        # the colour pixel nearest to the middle of each depth pixel
        self._sampled = tuple(
            np.floor((np.arange(coarse) + 0.5) * fine / coarse).astype(int)
            for coarse, fine in (
                (self.depth_model.height, self.color_model.height),
                (self.depth_model.width, self.color_model.width),
            )
        )
        self._drawn_key: Optional[Tuple] = None
        self._color_key: Optional[Tuple] = None
        self._depth_key: Optional[Tuple] = None
        self._make_noise()

    def restart(self, models: CameraModels) -> None:
        """Forgets what moved, for another person in the same room: only the body may differ from before."""
        self._body, self._hand_height = models.body, models.hand_height
        self._pose = self.robot.start_pose()
        self._drawn_key = self._color_key = self._depth_key = None

    def draw_from(self, draw: np.random.Generator) -> None:
        """Sets another source of noise, for frames that do not depend on those before."""
        self._rng = draw

    def _make_noise(self) -> None:
        shape = (self.color_model.height + 32, self.color_model.width + 32, 3)
        sigma = math.sqrt(self._figures.read_sigma**2 + 110.0 * 255.0 / self._figures.full_well_e)
        noise = sigma * self._rng.standard_normal(shape, dtype=np.float32)
        # two unsigned halves: adding and subtracting with saturation is what processors do best
        self._brighter = np.clip(noise + 0.5, 0, 255).astype(np.uint8)
        self._darker = np.clip(0.5 - noise, 0, 255).astype(np.uint8)
        size = (self.depth_model.height, self.depth_model.width)
        self._depth_noise = self._rng.standard_normal((_TILES, *size), dtype=np.float32)
        self._depth_holes = self._rng.random((_TILES, *size)) < self._figures.depth_holes

    def camera_pose(self, snapshot: Snapshot) -> np.ndarray:
        """Returns T_map_optical, 4x4. A robot that the scene does not hold stays where it was."""
        for name in self._names:
            if name in snapshot.robots:
                self._pose = snapshot.robots[name]
        return geometry.transform_from_pose2d(*self._pose) @ self._mount

    def _scene_key(self, snapshot: Snapshot) -> Tuple:
        """Returns a key that stays the same while nothing but the spot has moved; to be called after `camera_pose`."""
        others = tuple(
            (name, bodies.robot_key(pose)) for name, pose in snapshot.robots.items() if name not in self._names
        )
        bystanders = tuple(other.key() for other in snapshot.around.bystanders)
        return (self._pose, others, bodies.person_key(snapshot.person, snapshot.laser), bystanders)

    # ------------------------------------------------------------- colour
    def color(self, snapshot: Snapshot) -> np.ndarray:
        """Renders the colour image, (480, 640, 3) uint8 rgb."""
        pose = self.camera_pose(snapshot)
        key = self._scene_key(snapshot)
        if key != self._color_key:
            self._color_key = key
            image = self._draw_floor(pose)
            if self._optics.exposure_gain != 1.0:
                image = cv2.convertScaleAbs(image, alpha=self._optics.exposure_gain)
            self._draw_things(snapshot, pose, key)
            self._buffer.paint(image)
            self._clean = cv2.GaussianBlur(image, (3, 3), 0.5)
        # while nothing moves only spot and noise are new
        image = self._clean.copy()
        if snapshot.around.lit:
            disturbances.relight(image, snapshot.around, self.color_model, pose)
        if snapshot.laser is not None:
            self._add_spot(image, snapshot, pose)
        for glint in snapshot.around.glints:
            area = disturbances.glint_area(glint, self.color_model, pose)
            if area is not None:
                disturbances.add_glint(image, glint, area, "rgb8", snapshot.around.exposure)
        if self._noisy:
            top, left = (int(value) for value in self._rng.integers(0, 32, 2))
            part = (slice(top, top + image.shape[0]), slice(left, left + image.shape[1]))
            cv2.add(image, self._brighter[part], dst=image)
            cv2.subtract(image, self._darker[part], dst=image)
        return image

    def _to_floor(self, pose: np.ndarray) -> np.ndarray:
        """Computes the matrix (3, 3) from homogeneous (column, row) [px] to map coordinates [m] on the floor."""
        rotation, origin = pose[:3, :3], pose[:3, 3]
        return np.array(
            [
                origin[0] * rotation[2] - origin[2] * rotation[0],
                origin[1] * rotation[2] - origin[2] * rotation[1],
                rotation[2],
            ]
        ) @ np.linalg.inv(self.color_model.matrix)

    def _down(self, pose: np.ndarray) -> np.ndarray:
        """Computes (H,) how steeply each row looks down, per unit of depth; 0 and less at and above the horizon."""
        camera, rotation = self.color_model, pose[:3, :3]
        return -(
            rotation[2, 1] * (np.arange(camera.height) - camera.matrix[1, 2]) / camera.matrix[1, 1] + rotation[2, 2]
        )

    def _draw_floor(self, pose: np.ndarray) -> np.ndarray:
        """Draws the floor through its homography, farther away from a coarser texture."""
        camera = self.color_model
        height, width = camera.height, camera.width
        image = np.empty((height, width, 3), np.uint8)
        origin, to_floor = pose[:3, 3], self._to_floor(pose)
        # the row's own direction downwards decides how far away its floor is
        down = self._down(pose)
        with np.errstate(divide="ignore"):
            depth = np.where(down > 1e-3, origin[2] / down, np.inf)
        # a pixel covers depth/f across and 1/down times that along the view: their mean, geometrically
        footprint = depth / camera.focal_px / np.sqrt(np.clip(down, 1e-3, 1.0))
        levels = np.clip(
            np.floor(np.log2(np.maximum(footprint / self._floors[0].resolution, 1.0))), 0, len(self._floors) - 1
        )
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
                # the textures are as fine as the pixels: the nearest texel does, for a third of the time
                flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP,
                borderMode=cv2.BORDER_REPLICATE,
            )
        return image

    def _draw_things(self, snapshot: Snapshot, pose: np.ndarray, key: Tuple) -> None:
        """Draws everything but the floor into the buffer, once for colour and depth of the same scene."""
        if key == self._drawn_key:
            return
        self._drawn_key = key
        buffer, gain = self._buffer, self._optics.exposure_gain
        buffer.clear()
        buffer.draw_mesh(self._mesh, pose, gain)
        pieces: List[bodies.BodyParts] = []
        for name, where in snapshot.robots.items():
            if name not in self._names:
                pieces.append(bodies.robot_pieces(where, self._radii.get(name, 0.18)))
        if snapshot.person is not None:
            pieces.append(bodies.person_pieces(snapshot.person, snapshot.laser, self._hand_height, self._body))
        for other in snapshot.around.bystanders:
            pieces.append(other.pieces())
        if not pieces:
            return
        camera = buffer.grid.camera
        outlines = bodies.project_pieces(bodies.join_pieces(pieces), camera, pose)
        normal = np.array([0.0, 0.0, -1.0])
        lows, highs = outlines.points.min(axis=1), outlines.points.max(axis=1)
        shown = (highs >= 0).all(axis=1) & (lows <= (camera.width, camera.height)).all(axis=1)
        for index in np.nonzero(shown)[0]:
            points, color = outlines.points[index], outlines.colors[index]
            near = max(0.1, float(outlines.depths[index]) - _FRONT)
            buffer.draw_flat(points, near, 0.74 * gain * color, normal)
            middle = 0.5 * (lows[index] + highs[index])
            buffer.draw_flat(middle + 0.7 * (points - middle), near - 0.001, 0.95 * gain * color, normal)

    def spot(self, snapshot: Snapshot, pose: np.ndarray) -> Optional[SpotImage]:
        """Renders the light of the laser's spot, as if nothing hid it; None if the camera does not look there."""
        person = snapshot.person
        source = bodies.hand_position(person, snapshot.laser, self._hand_height) if person is not None else None
        return render_spot(snapshot.laser, snapshot.laser_velocity, source, self.color_model, pose, self._optics)

    def spot_share(self, snapshot: Snapshot) -> float:
        """Returns the share of the laser's light on the floor that reaches the camera; to be called after `color`."""
        spot = self.spot(snapshot, self.camera_pose(snapshot)) if snapshot.laser is not None else None
        return self._visible(spot) if spot is not None else 0.0

    def _visible(self, spot: SpotImage) -> float:
        """Returns the share of a spot's light that nothing hides; 0 if its middle is hidden or outside the image."""
        column, row = int(round(spot.center[0])), int(round(spot.center[1]))
        inside = 0 <= column < self.color_model.width and 0 <= row < self.color_model.height
        if not inside or self._buffer.ids[row, column]:
            return 0.0
        return float((self._buffer.ids[max(0, row - 1) : row + 2, max(0, column - 1) : column + 2] == 0).mean())

    def _add_spot(self, image: np.ndarray, snapshot: Snapshot, pose: np.ndarray) -> None:
        spot = self.spot(snapshot, pose)
        visible = self._visible(spot) if spot is not None else 0.0
        if not visible:
            return
        column, row = int(round(spot.center[0])), int(round(spot.center[1]))
        albedo = self._clean[row, column].astype(np.float32) / np.float32(255.0 * self._optics.exposure_gain)
        weights = visible * snapshot.around.exposure * albedo * self._optics.response(snapshot.laser_color)
        add_spot(image, spot, weights, "rgb8", (self._figures.full_well_e, self._rng) if self._noisy else None)

    # ------------------------------------------------------------- depth
    def depth(self, snapshot: Snapshot) -> np.ndarray:
        """Renders the depth image, (120, 160) uint16 [mm] along the optical axis, 0 where there is none."""
        pose = self.camera_pose(snapshot)
        key = self._scene_key(snapshot)
        if key != self._depth_key:
            self._depth_key = key
            self._draw_things(snapshot, pose, key)
            self._exact, self._blind = self._exact_depth(pose)
        depth, holes = self._exact, self._blind
        figures = self._figures
        if self._noisy:
            tile = int(self._rng.integers(_TILES))
            holes = holes | self._depth_holes[tile]
            sigma = (
                np.float32(figures.depth_sigma)
                + np.float32(figures.depth_sigma_quadratic) * (depth - np.float32(0.4)) ** 2
            )
            # the same tile turned round is another one
            noise = self._depth_noise[
                tile, :: 1 - 2 * int(self._rng.integers(2)), :: 1 - 2 * int(self._rng.integers(2))
            ]
            depth = depth + sigma * noise
        millimeters = np.clip(depth * np.float32(1000.0) + np.float32(0.5), 0, 65535).astype(np.uint16)
        millimeters[holes] = 0
        return millimeters

    def _exact_depth(self, pose: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Computes the exact depth (120, 160) float32 [m], and (120, 160) bool where the sensor sees nothing."""
        grid, figures = self._depth_grid, self._figures
        at = np.ix_(*self._sampled)
        ids = self._buffer.ids[at]
        down = -grid.combine(*pose[2, :3])
        floor = ids == 0
        inverse = np.where(floor, down / np.float32(pose[2, 3]), self._buffer.inverse[at])
        depth = np.float32(1.0) / np.maximum(inverse, np.float32(1e-3))
        # cosine of the angle between ray and surface normal
        normals = self._buffer.normals[ids]
        facing = -(normals[..., 0] * grid.x + normals[..., 1] * grid.y + normals[..., 2])
        facing = np.where(floor, down, facing) / self._slant
        grazing = facing < math.cos(math.radians(figures.depth_grazing_deg))
        blind = grazing | (depth < figures.depth_min) | (depth > figures.depth_max)
        return depth, blind
