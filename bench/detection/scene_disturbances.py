"""Adds disturbances to the simulated cameras' views: changes of light, sun, reflections, other people.

`with_disturbances` derives views that show a `DisturbedSnapshot`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, List, Tuple, Type

import cv2
import numpy as np

from vb_core import geometry
from vb_core.camera_model import CameraModel, project_to_pixels
from vb_sim.rendering.camera_view import Body
from vb_sim.lab_history import Snapshot
from vb_sim.rendering.bodies import SHIRT, SHOES, BodyParts, person_key, person_pieces
from vb_sim.rendering.laser_spot import apply_color_filters

_SHIFT = 4


@dataclass(frozen=True)
class Bystander:
    """A person in the room without a laser pointer.

    Attributes:
        pose: (x, y, yaw) [m, m, rad].
        shirt, shoes: rgb.
    """

    pose: Tuple[float, float, float]
    shirt: Tuple[int, int, int] = SHIRT
    shoes: Tuple[int, int, int] = SHOES

    def pieces(self) -> BodyParts:
        """Builds this person's pieces, with the colours of the clothes."""
        pieces = person_pieces(self.pose, None, 0.0)
        colors = pieces.colors.copy()
        tints = np.mean(colors / SHIRT, axis=1, keepdims=True)
        of_shirt = np.isclose(tints * SHIRT, colors, rtol=1e-5, atol=1.0).all(axis=1)
        colors[of_shirt] = np.floor(np.minimum(255.0, tints * self.shirt))[of_shirt]
        colors[(pieces.colors == SHOES).all(axis=1)] = self.shoes
        return replace(pieces, colors=colors)

    def key(self) -> Tuple:
        """Returns a key that is the same for people who look the same."""
        return (self.shirt, self.shoes, *person_key(self.pose, None))


@dataclass(frozen=True)
class Glint:
    """The small white reflection of a lamp on a shiny object, which may saturate the sensor."""

    position: Tuple[float, float, float]  # (x, y, z) [m], map frame
    diameter: float = 0.012  # [m] at which the brightness falls to 1/e^2
    brightness: float = 400.0  # [grey levels] of the centre at the reference exposure; may exceed 255


@dataclass(frozen=True)
class SceneConditions:
    """The conditions in a room at one time, by default without disturbances.

    Attributes:
        light: of the lamps, as a multiple of the rendered light. It does not change a laser's light.
        exposure: of the camera, as a multiple of the rendered exposure. It brightens a laser too.
        sun: (x, y) [m] corners of the sun patch on the floor; empty without sun.
        sun_gain: factor of the floor's brightness in the sun.
    """

    light: float = 1.0
    exposure: float = 1.0
    sun: Tuple[Tuple[float, float], ...] = ()
    sun_gain: float = 1.8
    glints: Tuple[Glint, ...] = ()
    bystanders: Tuple[Bystander, ...] = ()


@dataclass(frozen=True)
class DisturbedSnapshot(Snapshot):
    """A snapshot with the conditions in the room."""

    conditions: SceneConditions = SceneConditions()


def with_disturbances(view_class: Type[Any]) -> Type[Any]:
    """Derives a class of views that show disturbances as well."""

    class DisturbedView(view_class):
        def _bodies(self, snapshot: DisturbedSnapshot) -> List[Body]:
            return super()._bodies(snapshot) + [
                Body(f"bystander {index}", other.key(), other.pieces, other.pose, 0.26)
                for index, other in enumerate(snapshot.conditions.bystanders)
            ]

        def _add_light(self, image: np.ndarray, snapshot: DisturbedSnapshot, _exposure: float = 1.0) -> None:
            # the conditions give the exposure, so the argument is ignored
            conditions, pose = snapshot.conditions, self.camera_pose(snapshot)
            if conditions != SceneConditions():
                self._before_change(image, (slice(None), slice(None)))
                relight(image, conditions, self.model, pose)
            super()._add_light(image, snapshot, conditions.exposure)
            for glint in conditions.glints:
                add_glint(image, glint, self.model, pose, self.encoding, conditions.exposure)

    return DisturbedView


def relight(image: np.ndarray, conditions: SceneConditions, camera: CameraModel, T_map_optical: np.ndarray) -> None:
    """Applies lamps, exposure and sun to an image without laser, (H, W) or (H, W, 3) uint8, in place."""
    if conditions.sun:
        outline = geometry.resample_chain(np.array([*conditions.sun, conditions.sun[0]], dtype=float), 0.05)
        pixels = project_to_pixels(camera, T_map_optical, np.column_stack([outline, np.zeros(len(outline))]))
        # the lens model is invalid far outside the image
        _brighten(image, np.clip(pixels, -2.0 * camera.width, 3.0 * camera.width), conditions.sun_gain)
    gain = conditions.light * conditions.exposure
    if gain != 1.0:
        cv2.convertScaleAbs(image, image, alpha=gain)


def _brighten(image: np.ndarray, outline: np.ndarray, gain: float) -> None:
    height, width = image.shape[:2]
    outline = outline[np.isfinite(outline).all(axis=1)]
    if len(outline) < 3:
        return
    low = np.clip(np.floor(outline.min(axis=0)).astype(int) - 4, 0, (width, height))
    high = np.clip(np.ceil(outline.max(axis=0)).astype(int) + 5, 0, (width, height))
    if (high <= low).any():
        return
    mask = np.zeros((high[1] - low[1], high[0] - low[0]), np.float32)
    cv2.fillPoly(mask, [np.round((outline - low) * (1 << _SHIFT)).astype(np.int32)], gain - 1.0, cv2.LINE_8, _SHIFT)
    # the edges are soft, because the sun is not a point
    mask = 1.0 + cv2.GaussianBlur(mask, (0, 0), 1.5)
    part = image[low[1] : high[1], low[0] : high[0]].T  # with channels, if there are any, in front
    part[...] = np.minimum(part * mask.T + 0.5, 255.0)


def add_glint(
    image: np.ndarray, glint: Glint, camera: CameraModel, T_map_optical: np.ndarray, encoding: str, exposure: float
) -> None:
    """Adds a glint to an image (H, W) or (H, W, 3) uint8, in place, if the camera sees it."""
    T = geometry.invert_transform(T_map_optical)
    in_camera = T[:3, :3] @ np.array(glint.position) + T[:3, 3]
    if in_camera[2] < 0.1:
        return
    center = camera.project(in_camera[None])[0]
    sigma = math.hypot(0.25 * glint.diameter * camera.focal_px / in_camera[2], 0.75)
    low = np.maximum(np.floor(center - 4.0 * sigma).astype(int), 0)
    high = np.minimum(np.ceil(center + 4.0 * sigma).astype(int) + 1, (camera.width, camera.height))
    if (high <= low).any():
        return
    u, v = (np.arange(low[axis], high[axis]) - center[axis] for axis in (0, 1))
    squared_distances = u[None, :] ** 2 + v[:, None] ** 2  # [px^2] from the glint's centre
    light = glint.brightness * exposure * np.exp(-0.5 * squared_distances / sigma**2)
    part = image[low[1] : high[1], low[0] : high[0]]
    filtered = apply_color_filters(light, np.ones(3), encoding, low[0], low[1])
    part[...] = np.minimum(part + filtered + 0.5, 255.0)
