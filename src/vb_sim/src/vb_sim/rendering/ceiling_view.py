"""Renders the images of a ceiling camera.

The static scene is rendered once, as several images with different sensor noise. To render an image of the camera, one
of them is changed, but only in the rectangles with moving objects. The next rendering undoes these changes. Therefore
an image takes little time, whatever its size.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List, Optional, Tuple

import cv2
import numpy as np

from vb_core.geometry import Pose, invert_transform, transform_points
from vb_sim.rendering.camera_view import Body, CameraView
from vb_sim.lab_history import Snapshot
from vb_sim.model_params import Models
from vb_sim.rendering import bodies
from vb_sim.rendering.floor_texture import FloorTexture
from vb_sim.rendering.laser_spot import SpotImage
from vb_sim.rendering.mesh import DepthBuffer, Mesh, RayGrid
from vb_sim.world import CeilingCamera

_NOISY_IMAGES = 5  # of the empty room, shown in random order
# moving objects are drawn at half the resolution, because a Bayer pattern resolves colour no better
_HALF = 2
_NOISE_OFFSET = 16  # [grey levels] added to the noise, so that unsigned values can represent it
_SHIFT = 4  # bits of fraction in fixed-point coordinates


def _to_fixed_point(points: np.ndarray) -> np.ndarray:
    """Converts points to the fixed-point integers that OpenCV's drawing functions need."""
    return np.rint(points * (1 << _SHIFT)).astype(np.int32)


def encode(rgb: np.ndarray, encoding: str) -> np.ndarray:
    """Encodes rgb (H, W, 3) as (H, W) or (H, W, 3) in a sensor_msgs encoding. For Bayer, H and W must be even."""
    if encoding == "bgr8":
        return cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
    if encoding == "mono8":
        return cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    red, mosaic, blue = cv2.split(rgb)  # green wherever it is neither red nor blue
    mosaic[0::2, 0::2] = red[0::2, 0::2]
    mosaic[1::2, 1::2] = blue[1::2, 1::2]
    return mosaic


def encode_doubled(rgb: np.ndarray, encoding: str) -> np.ndarray:
    """Encodes an image (h, w, 3) at twice its size: (2h, 2w) or (2h, 2w, 3)."""
    if encoding != "bayer_rggb8":
        return encode(cv2.resize(rgb, None, fx=2, fy=2, interpolation=cv2.INTER_LINEAR), encoding)
    red, green, blue = cv2.split(rgb)
    mosaic = cv2.resize(green, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST)
    mosaic[0::2, 0::2] = red
    mosaic[1::2, 1::2] = blue
    return mosaic


@dataclass(frozen=True)
class _Sprite:
    """A moving object in the image of a camera. Its part of the image becomes image * keep / 255 + color."""

    rows: slice  # its part of the image, of (2h, 2w) pixels
    columns: slice
    keep: np.ndarray  # (2h, 2w) or (2h, 2w, 3) uint8
    color: np.ndarray  # as `keep`
    solid: np.ndarray  # (2h, 2w) uint8, 255 in pixels that show the object itself, not only its shadow
    opacity: np.ndarray  # (h, w) uint8, 255 where the object hides what is behind it


def _draw_shadow(outline: np.ndarray, blur_px: float, shape: Tuple[int, int]) -> np.ndarray:
    """Draws the light that remains in a soft shadow, (h, w) uint8; 255 is all light."""
    lit = np.full(shape, 255, np.uint8)
    if len(outline):
        # drawn at a quarter of the size, because the shadow is blurred anyway
        small = np.zeros((shape[0] // 4 + 1, shape[1] // 4 + 1), np.uint8)
        cv2.fillConvexPoly(small, _to_fixed_point(outline * 0.25), 110, cv2.LINE_AA, _SHIFT)
        box = 2 * int(max(1.0, blur_px / 4.0)) + 1
        for _ in range(2):
            small = cv2.blur(small, (box, box))
        shadow = cv2.resize(small, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR)
        cv2.subtract(lit, shadow, dst=lit)
    return lit


class CeilingView(CameraView):
    """Renders one ceiling camera.

    Args:
        floor, mesh: the world's floor, walls and furniture. The other arguments are as for `CameraView`.
    """

    def __init__(
        self, camera: CeilingCamera, radii: Dict[str, float], floor: FloorTexture, mesh: Mesh, models: Models, seed: int
    ) -> None:
        name = f"ceiling camera {camera.name}"
        super().__init__(name, camera.model(), camera.encoding, radii, models, models.camera_noise, seed)
        self.pose = camera.pose()
        background = self._draw_background(floor, mesh)
        self._images = self._make_noisy_images(background)
        size = (self.model.width // _HALF, self.model.height // _HALF)
        self._background = cv2.resize(background, size, interpolation=cv2.INTER_AREA)
        self._noise_tile = self._make_noise_tile()
        self._image_index: Optional[int] = 0  # which noisy image was shown last; None if the next may be any of them
        self._undo: List[Tuple[np.ndarray, np.ndarray]] = []  # parts of an image and their previous contents
        self._sprites: Dict[str, Tuple[Tuple, Optional[_Sprite]]] = {}
        self._visible_sprites: List[_Sprite] = []

    def camera_pose(self, _snapshot: Snapshot) -> np.ndarray:
        """Returns T_map_optical, 4x4."""
        return self.pose

    # ------------------------------------------------------------- static parts
    def _draw_background(self, floor: FloorTexture, mesh: Mesh) -> np.ndarray:
        grid = RayGrid(self.model)
        to_texture = floor.matrix().astype(np.float32)
        rotation = self.pose[:3, :3].astype(np.float32)
        x, y, z = self.pose[:3, 3].astype(np.float32)
        # where each pixel's ray intersects the floor; far away for pixels at and above the horizon
        steps = -z / np.minimum(grid.dot_rays(*rotation[2]), np.float32(-1e-4))
        floor_x = grid.dot_rays(*rotation[0]) * steps + x
        floor_y = grid.dot_rays(*rotation[1]) * steps + y
        columns = floor_x * to_texture[0, 0] + to_texture[0, 2]
        rows = floor_y * to_texture[1, 1] + to_texture[1, 2]
        image = cv2.remap(floor.rgb, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        buffer = DepthBuffer(grid)
        buffer.draw_mesh(mesh, self.pose)
        buffer.paint(image)
        image = cv2.GaussianBlur(image, (0, 0), 0.6)
        height, width = self.model.height // _HALF, self.model.width // _HALF
        odd = buffer.inverse[1::_HALF, 1::_HALF]
        self._inverse_half = np.ascontiguousarray(odd[:height, :width])
        self._object_ids = buffer.ids
        squared_radii = grid.x * grid.x + grid.y * grid.y
        vignetting = self._optics.vignetting * squared_radii / float(squared_radii.max())
        shade = self._optics.exposure_gain * (1.0 - vignetting)
        return np.clip(image * shade[..., None] + 0.5, 0, 255).astype(np.uint8)

    def _make_noisy_images(self, background: np.ndarray) -> List[np.ndarray]:
        values = np.ascontiguousarray(encode(background, self.encoding)).astype(np.float32)
        values *= 1.0 + self._noise_model.prnu * self._rng.standard_normal(values.shape, dtype=np.float32)
        sigma = self._noise_model.sigma(values).astype(np.float32)
        images = []
        for _ in range(_NOISY_IMAGES):
            noisy = values + sigma * self._rng.standard_normal(values.shape, dtype=np.float32)
            images.append(np.clip(noisy + 0.5, 0, 255).astype(np.uint8))
        return images

    def _make_noise_tile(self) -> np.ndarray:
        """Creates a tile with the noise of a mid-grey surface, plus an offset, from which parts are cut."""
        shape = (self.model.height + 64, self.model.width + 64)
        if self._images[0].ndim == 3:
            shape += (3,)
        sigma = float(self._noise_model.sigma(100.0))
        noise = sigma * self._rng.standard_normal(shape, dtype=np.float32)
        return np.clip(noise + _NOISE_OFFSET + 0.5, 0, 255).astype(np.uint8)

    # ------------------------------------------------------------- moving parts
    def restart(self, models: Models) -> None:
        """Resets the moving objects for another person in the same room. `models` may differ only in the body."""
        super().restart(models)
        self._undo_changes()
        self._sprites.clear()
        self._image_index = 0

    def set_noise_generator(self, source: np.random.Generator) -> None:
        """Replaces the noise's random generator, so that images do not depend on earlier ones."""
        super().set_noise_generator(source)
        self._image_index = None

    def _undo_changes(self) -> None:
        for part, previous in reversed(self._undo):
            part[...] = previous
        self._undo.clear()

    def image(self, snapshot: Snapshot) -> np.ndarray:
        """Renders a scene, (H, W) or (H, W, 3) uint8 in the camera's encoding. The next call overwrites it."""
        self._undo_changes()
        count = len(self._images)
        if self._image_index is None:
            self._image_index = int(self._rng.integers(count))
        else:
            # any image but the last, so that none repeats its predecessor
            self._image_index = (self._image_index + int(self._rng.integers(1, count))) % count
        image = self._images[self._image_index]
        sprites = [self._cached_sprite(body) for body in self._bodies(snapshot)]
        self._visible_sprites = [sprite for sprite in sprites if sprite is not None]
        for sprite in self._visible_sprites:
            self._blend(image, sprite)
        self._add_light(image, snapshot)
        return image

    def _cached_sprite(self, body: Body) -> Optional[_Sprite]:
        cached = self._sprites.get(body.name)
        if cached is None or cached[0] != body.key:
            cached = (body.key, self._draw_sprite(body.build(), body.pose, body.radius))
            self._sprites[body.name] = cached
        return cached[1]

    def _draw_sprite(self, pieces: bodies.BodyParts, pose: Pose, radius: float) -> Optional[_Sprite]:
        outlines = bodies.project_pieces(pieces, self.model, self.pose)
        if not len(outlines.points):
            return None
        shadow = self._shadow_outline(pose, radius)
        blur_px = 0.10 * self.model.focal_px / self.pose[2, 3] / _HALF
        extent = outlines.points.reshape(-1, 2)
        if len(shadow):
            reach = 3.0 * blur_px * _HALF
            extent = np.concatenate([extent, shadow - reach, shadow + reach])
        width, height = self.model.width // _HALF, self.model.height // _HALF
        low = np.maximum(np.floor(extent.min(axis=0) / _HALF).astype(int) - 2, 0)
        high = np.minimum(np.ceil(extent.max(axis=0) / _HALF).astype(int) + 3, (width, height))
        if (high <= low).any():
            return None
        columns, rows = slice(low[0], high[0]), slice(low[1], high[1])
        shape = (high[1] - low[1], high[0] - low[0])
        offset = 0.5 / _HALF - 0.5 - low
        color, opacity = self._draw_body(outlines, offset, self._inverse_half[rows, columns])
        lit = _draw_shadow(shadow / _HALF + offset, blur_px, shape)
        keep = cv2.multiply(lit, cv2.bitwise_not(opacity), scale=1.0 / 255.0)
        keep = cv2.resize(keep, (shape[1] * 2, shape[0] * 2), interpolation=cv2.INTER_LINEAR)
        # pixels that are only in shadow keep more than 126
        solid = cv2.inRange(keep, 0, 126)
        pattern = encode_doubled(color, self.encoding)
        darker = cv2.subtract(pattern, np.full(pattern.shape, _NOISE_OFFSET, np.uint8))
        cv2.copyTo(darker, solid, pattern)
        if pattern.ndim == 3:
            keep = cv2.merge([keep] * 3)
        full_rows = slice(2 * low[1], 2 * high[1])
        full_columns = slice(2 * low[0], 2 * high[0])
        return _Sprite(full_rows, full_columns, keep, pattern, solid, opacity)

    def _draw_body(
        self, outlines: bodies.Outlines, offset: np.ndarray, static_inverse: np.ndarray
    ) -> Tuple[np.ndarray, np.ndarray]:
        """Draws a body's pieces, the furthest first. Returns colour (h, w, 3) and opacity (h, w), uint8.

        Args:
            offset: (2,) [px] to add to the halved outlines.
            static_inverse: (h, w) [1/m] inverse depth of the static scene, which may hide the body.
        """
        color = np.zeros((*static_inverse.shape, 3), np.uint8)
        inverse = np.zeros(static_inverse.shape, np.float32)
        outer = outlines.points / _HALF + offset
        centers = 0.5 * (outer.min(axis=1, keepdims=True) + outer.max(axis=1, keepdims=True))
        inner = _to_fixed_point(centers + 0.72 * (outer - centers))
        outer = _to_fixed_point(outer)
        # lighter inside than at the rim, so that pieces look round
        dark, light = (0.72 * outlines.colors).tolist(), (0.92 * outlines.colors).tolist()
        for index, depth in enumerate(outlines.depths):
            hull = cv2.convexHull(outer[index], returnPoints=False)[:, 0]
            cv2.fillConvexPoly(color, outer[index][hull], dark[index], cv2.LINE_8, _SHIFT)
            cv2.fillConvexPoly(color, inner[index][hull], light[index], cv2.LINE_8, _SHIFT)
            cv2.fillConvexPoly(inverse, outer[index][hull], 1.0 / depth, cv2.LINE_8, _SHIFT)
        opacity = np.where(inverse > 0.0, np.uint8(255), np.uint8(0))
        # both get the same soft edges, because the colour is premultiplied by the opacity
        color = cv2.blur(color, (3, 3))
        opacity = cv2.blur(opacity, (3, 3))
        hidden = cv2.compare(static_inverse, np.maximum(inverse * 1.02, 1e-6), cv2.CMP_GT)
        if cv2.countNonZero(hidden):
            visible = cv2.bitwise_not(hidden)
            color = cv2.bitwise_and(color, color, mask=visible)
            opacity = cv2.bitwise_and(opacity, visible)
        # the exposure applies to bodies too
        gain = self._optics.exposure_gain
        if gain != 1.0:
            color = cv2.convertScaleAbs(color, alpha=gain)
        return color, opacity

    def _shadow_outline(self, pose: Pose, radius: float) -> np.ndarray:
        """Returns the outline (N, 2) [px] of a shadow on the floor, small because lamps are all over the ceiling."""
        nothing = np.zeros((0, 2))
        center = (pose[0] + 0.05, pose[1] - 0.04)
        circle = center + 1.1 * radius * bodies.UNIT_CIRCLE
        points = np.column_stack([circle, np.zeros(len(circle))])
        in_camera = transform_points(invert_transform(self.pose), points)
        if (in_camera[:, 2] < 0.15).any():
            return nothing
        outline = self.model.project(in_camera)
        limit = 3.0 * max(self.model.width, self.model.height)
        return outline if np.abs(outline).max() < limit else nothing

    def _blend(self, image: np.ndarray, sprite: _Sprite) -> None:
        self._before_change(image, (sprite.rows, sprite.columns))
        part = image[sprite.rows, sprite.columns]
        blended = cv2.multiply(part, sprite.keep, scale=1.0 / 255.0)
        cv2.add(blended, sprite.color, dst=blended)
        top, left = self._rng.integers(0, 64, 2)
        tile = self._noise_tile[top : top + part.shape[0], left : left + part.shape[1]]
        cv2.add(blended, tile, dst=blended, mask=sprite.solid)
        part[...] = blended

    def _before_change(self, image: np.ndarray, area: Tuple[slice, slice]) -> None:
        self._undo.append((image[area], image[area].copy()))

    # ------------------------------------------------------------- the laser
    def _visible(self, spot: SpotImage) -> float:
        visible = super()._visible(spot)
        column, row = spot.pixel
        for sprite in self._visible_sprites:
            cell_row = (row - sprite.rows.start) // _HALF
            cell_column = (column - sprite.columns.start) // _HALF
            height, width = sprite.opacity.shape
            if 0 <= cell_row < height and 0 <= cell_column < width:
                visible *= 1.0 - float(sprite.opacity[cell_row, cell_column]) / 255.0
        return visible

    def _albedo(self, spot: SpotImage) -> np.ndarray:
        column = min(max(int(spot.center[0]) // _HALF, 0), self._background.shape[1] - 1)
        row = min(max(int(spot.center[1]) // _HALF, 0), self._background.shape[0] - 1)
        return self._background[row, column] / (255.0 * self._optics.exposure_gain)
