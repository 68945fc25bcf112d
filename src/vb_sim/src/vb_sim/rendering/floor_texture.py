"""Draws an image of the floor from above, with all flat objects on it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Tuple

import cv2
import numpy as np

from vb_core.geometry import base_to_map
from vb_sim.model_params import make_generator
from vb_sim.floor_plan import wall_outline
from vb_sim.world import Floor, FloorPatch, World

_CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])  # of a square


@dataclass(frozen=True)
class FloorTexture:
    """A metric image of the floor, seen from above."""

    rgb: np.ndarray  # (H, W, 3) uint8, or float32 while it is being drawn; row 0 has the lowest y
    resolution: float  # [m] per pixel
    origin: Tuple[float, float]  # (x, y) [m] of the outer corner of pixel (0, 0), map frame

    def matrix(self) -> np.ndarray:
        """Returns the matrix (3, 3) from map coordinates [m] to (column, row) [px], integers at pixel centres."""
        scale = 1.0 / self.resolution
        x, y = self.origin
        return np.array([[scale, 0, -x * scale - 0.5], [0, scale, -y * scale - 0.5], [0, 0, 1.0]])

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Projects points (N, 2) [m] to pixels (N, 2) (column, row) [px]."""
        return (np.asarray(points, dtype=float).reshape(-1, 2) - self.origin) / self.resolution - 0.5

    def halved(self) -> "FloorTexture":
        """Returns the image at half the resolution, averaged."""
        height, width = (size // 2 for size in self.rgb.shape[:2])
        even_part = self.rgb[: 2 * height, : 2 * width]
        small = cv2.resize(even_part, (width, height), interpolation=cv2.INTER_AREA)
        return FloorTexture(small, self.resolution * 2.0, self.origin)


def render_floor(world: World, seed: int, resolution: float = 0.0025) -> FloorTexture:
    """Draws a world's floor; the same seed gives the same image."""
    margin = world.room.margin
    origin = (-margin, -margin)
    width, height = (math.ceil((size + 2 * margin) / resolution) for size in world.room.size)
    rng = make_generator(seed, "floor")
    brightness = _make_brightness(world.floor, (height, width), resolution, rng)
    image = brightness[..., None] * np.array(world.floor.color, np.float32)
    texture = FloorTexture(image, resolution, origin)
    for patch in world.patches:
        if patch.kind == "snippets":
            _draw_snippets(texture, patch, rng)
        else:
            _draw_carpet(texture, patch, rng)
    _draw_contact_shadows(texture, world)
    for light in world.lights:
        column, row = texture.pixels(np.array([[light.x, light.y]]))[0]
        reach = 2.0 * light.radius / resolution
        left, top = (max(0, int(center - reach)) for center in (column, row))
        right, bottom = (max(0, int(center + reach)) for center in (column, row))
        part = image[top:bottom, left:right]
        rows, columns = np.ogrid[top : top + part.shape[0], left : left + part.shape[1]]
        squared_distance = ((columns - column) ** 2 + (rows - row) ** 2) * (resolution / light.radius) ** 2
        glow = light.brightness * np.exp(-0.7 * squared_distance**1.5)
        part += glow[..., None].astype(np.float32)
    return FloorTexture(np.clip(image + 0.5, 0, 255).astype(np.uint8), resolution, origin)


def _make_noise(shape: Tuple[int, int], step: Tuple[float, float], rng: np.random.Generator) -> np.ndarray:
    """Returns smooth noise (H, W) float32 of unit standard deviation, with features of `step` (rows, columns) [px]."""
    counts = [int(math.ceil(size / max(1.0, length))) for size, length in zip(shape, step)]
    values = rng.standard_normal([max(2, count + 2) for count in counts], dtype=np.float32)
    noise = cv2.resize(values, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC)
    return noise / max(1e-6, float(noise.std()))


def _make_brightness(floor: Floor, shape: Tuple[int, int], resolution: float, rng: np.random.Generator) -> np.ndarray:
    height, width = shape
    result = 1.0 + 0.02 * _make_noise(shape, (0.9 / resolution, 0.9 / resolution), rng)
    result += 0.12 * floor.contrast * _make_noise(shape, (0.004 / resolution, 0.004 / resolution), rng)
    if floor.kind == "plain":
        return result + 0.15 * floor.contrast * _make_noise(shape, (0.03 / resolution, 0.03 / resolution), rng)
    length = max(2.0, floor.plank[0] / resolution)
    breadth = max(2.0, floor.plank[1] / resolution)
    if floor.kind == "tiles":
        breadth = length
    # positions counted in boards or tiles; each row of boards is shifted by a random share of a board
    rows = np.arange(height, dtype=np.float32) / breadth
    row_numbers = rows.astype(int)
    shifts = rng.random(row_numbers[-1] + 1).astype(np.float32)
    if floor.kind == "tiles":
        shifts[:] = 0.0
    columns = np.arange(width, dtype=np.float32)[None, :] / length + shifts[row_numbers][:, None]
    column_numbers = columns.astype(np.int32)
    counts = (row_numbers[-1] + 1, int(column_numbers.max()) + 1)
    tones = rng.normal(0.0, 1.0, counts).astype(np.float32)
    result += 0.42 * floor.contrast * tones[row_numbers[:, None], column_numbers]
    if floor.kind == "planks":
        # the grain runs along the boards
        result += 0.28 * floor.contrast * _make_noise(shape, (0.006 / resolution, 0.25 / resolution), rng)
        result += 0.18 * floor.contrast * _make_noise(shape, (0.02 / resolution, 0.5 / resolution), rng)
    seam = (0.0015 if floor.kind == "planks" else 0.002) / resolution
    # [px] distances to the nearest seam
    row_shares = rows - row_numbers
    across = np.minimum(row_shares, 1.0 - row_shares) * breadth
    column_shares = columns - column_numbers
    along = np.minimum(column_shares, 1.0 - column_shares) * length
    row_gap = np.exp(-((across / seam) ** 2))[:, None]
    column_gap = np.exp(-((along / seam) ** 2))
    return result * (1.0 - min(1.0, 1.8 * floor.contrast) * np.maximum(row_gap, column_gap))


def _cut_patch(texture: FloorTexture, patch: FloorPatch) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the part of the image that contains a patch, and x and y [m] of its pixels in the patch's axes."""
    corners = texture.pixels(patch.footprint())
    left, top = np.maximum(np.floor(corners.min(axis=0)).astype(int), 0)
    right, bottom = np.maximum(np.ceil(corners.max(axis=0)).astype(int) + 1, (left, top))
    part = texture.rgb[top:bottom, left:right]
    rows, columns = np.indices(part.shape[:2], dtype=np.float32)
    dx = (columns + left + 0.5) * texture.resolution + texture.origin[0] - patch.x
    dy = (rows + top + 0.5) * texture.resolution + texture.origin[1] - patch.y
    yaw = math.radians(patch.yaw)
    c = math.cos(yaw)
    s = math.sin(yaw)
    return part, c * dx + s * dy, c * dy - s * dx


def _draw_carpet(texture: FloorTexture, patch: FloorPatch, rng: np.random.Generator) -> None:
    part, x, y = _cut_patch(texture, patch)
    if part.size == 0:
        return
    half_x, half_y = np.array(patch.size) / 2.0
    edge = np.minimum(half_x - np.abs(x), half_y - np.abs(y))  # [m] distance to the nearest edge
    warp = np.sin(2 * math.pi * x / 0.011)
    weft = np.sin(2 * math.pi * y / 0.011)
    step = 0.007 / texture.resolution
    fibres = _make_noise(part.shape[:2], (step, step), rng)
    wear = _make_noise(part.shape[:2], (60 * step, 60 * step), rng)
    tone = 1.0 + patch.contrast * (0.35 * 0.5 * (warp * weft) + 0.22 * fibres)
    tone += 0.10 * patch.contrast * wear
    # a woven border and diamonds, which may mislead a spot detector as real carpets do
    is_stripe = ((edge > 0.05) & (edge < 0.065)) | ((edge > 0.10) & (edge < 0.125))
    across_x = np.abs(((x + 0.2) % 0.4) / 0.4 - 0.5)
    across_y = np.abs(((y + 0.2) % 0.4) / 0.4 - 0.5)
    rhomb = across_x + across_y
    is_diamond = (rhomb > 0.16) & (rhomb < 0.21) & (edge > 0.16)
    figures = is_stripe.astype(np.float32) + 0.7 * is_diamond.astype(np.float32)
    tone *= 1.0 + 1.2 * patch.contrast * figures
    inside = edge > 0.0
    part[inside] = tone[inside][:, None] * np.array(patch.color, np.float32)
    part[(edge <= 0.0) & (edge > -0.012)] *= 0.75


def _draw_snippets(texture: FloorTexture, patch: FloorPatch, rng: np.random.Generator) -> None:
    pose = (patch.x, patch.y, math.radians(patch.yaw))
    for _ in range(patch.count):
        center = (rng.random(2) - 0.5) * np.array(patch.size)
        angle = rng.random() * math.pi
        half_size = patch.snippet * rng.uniform(0.3, 0.6, 2)
        # torn paper: a rectangle with each corner displaced
        torn = half_size * _CORNERS * rng.uniform(0.7, 1.1, (4, 2))
        in_patch = base_to_map(torn, (*center, angle))
        outline = texture.pixels(base_to_map(in_patch, pose))
        shade = float(rng.uniform(1.0 - patch.contrast, 1.0))
        color = tuple(shade * value for value in patch.color)
        corners = np.round(outline * 16).astype(np.int32)
        shadow = np.round(outline * 16 + 12).astype(np.int32)
        cv2.fillConvexPoly(texture.rgb, shadow, (0.0, 0.0, 0.0), cv2.LINE_8, 4)
        cv2.fillConvexPoly(texture.rgb, corners, color, cv2.LINE_8, 4)


def _draw_contact_shadows(texture: FloorTexture, world: World) -> None:
    """Darkens the floor beside walls and furniture."""
    step = 8
    height, width = texture.rgb.shape[:2]
    small = (height // step + 1, width // step + 1)
    occluder = np.zeros(small, np.float32)
    outlines = [(wall_outline(wall), 1.0) for wall in world.walls]
    outlines += [(thing.footprint(), 0.55 if thing.kind == "table" else 1.0) for thing in world.furniture]
    for outline, weight in outlines:
        corners = np.round(texture.pixels(outline) / step * 16).astype(np.int32)
        cv2.fillPoly(occluder, [corners], weight, cv2.LINE_8, 4)
    room_corners = texture.pixels(np.array([(0, 0), world.room.size]))
    low, high = np.round(room_corners / step).astype(int).tolist()
    outside = np.ones(small, np.float32)
    cv2.rectangle(outside, low, high, 0.0, -1)
    occluder = np.maximum(occluder, 0.7 * outside)
    cell = texture.resolution * step
    near = cv2.GaussianBlur(occluder, (0, 0), 0.07 / cell)
    far = cv2.GaussianBlur(occluder, (0, 0), 0.22 / cell)
    shade = 0.55 * near + 0.45 * far
    resized = cv2.resize(shade, (small[1] * step, small[0] * step), interpolation=cv2.INTER_LINEAR)
    light = 1.0 - 0.5 * resized[:height, :width]
    np.multiply(texture.rgb, light[..., None], out=texture.rgb)
