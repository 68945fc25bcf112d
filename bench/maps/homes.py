"""Homes for the benches of maps: two generators that share no code for plans, and what SLAM does to a map.

`split_home` halves rectangles again and again; the registration was developed on it. `corridor_home` puts rooms on both
sides of a corridor, with an alcove cut out of the outline, a slanted wall and round tables; it only judges.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import List, Tuple

import cv2
import numpy as np

from vb_core.grid_map import GridMap
from vb_map_integration.places.registration import IDENTITY, Transform

_SHIFT = 8  # bits of sub-cell accuracy for OpenCV's polygons


@dataclass(frozen=True)
class Home:
    """A floor plan.

    Attributes:
        outline: (N, 2) [m] outer corners of the floor.
        walls: each (4, 2) [m].
        rooms: each (N, 2) [m], to be left out of a map.
        furniture: each (N, 2) [m].
    """

    outline: np.ndarray
    walls: List[np.ndarray] = field(default_factory=list)
    rooms: List[np.ndarray] = field(default_factory=list)
    furniture: List[np.ndarray] = field(default_factory=list)

    def mirrored(self) -> "Home":
        """Returns the flat on the other side of the stairs."""
        flip = np.array([-1.0, 1.0])
        parts = ([one * flip for one in some] for some in (self.walls, self.rooms, self.furniture))
        return Home(self.outline * flip, *parts)


def wall(a: np.ndarray, b: np.ndarray, thickness: float) -> np.ndarray:
    """Returns the corners of a straight wall, (4, 2) [m]."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    along = (b - a) / max(1e-9, float(np.linalg.norm(b - a)))
    across = np.array([-along[1], along[0]]) * thickness / 2.0
    along = along * thickness / 2.0
    return np.array([a - across - along, b - across + along, b + across + along, a + across - along])


def with_door(a: np.ndarray, b: np.ndarray, at: float, width: float, thickness: float) -> List[np.ndarray]:
    """Returns a wall with a doorway whose middle lies at a share of its length."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    length = float(np.linalg.norm(b - a))
    half = width / 2.0 / length
    parts = []
    for low, high in ((0.0, at - half), (at + half, 1.0)):
        if (high - low) * length > thickness:
            parts.append(wall(a + low * (b - a), a + high * (b - a), thickness))
    return parts


def _box(center: np.ndarray, size: np.ndarray, yaw: float) -> np.ndarray:
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * size
    return Transform(float(center[0]), float(center[1]), yaw).apply(corners)


def split_home(random: np.random.Generator, size: Tuple[float, float] = (0.0, 0.0)) -> Home:
    """Rooms by halving a rectangle; a size [m] of 0 is drawn too."""
    width, height = (value or random.uniform(low, high) for value, low, high in zip(size, (7.5, 6.0), (14.0, 10.0)))
    thickness = random.uniform(0.08, 0.16)
    outline = np.array([[0, 0], [width, 0], [width, height], [0, height]], float)
    walls = [wall(outline[k], outline[(k + 1) % 4], thickness) for k in range(4)]
    rooms, todo = [], [(0.0, 0.0, width, height)]
    while todo:
        x0, y0, x1, y1 = todo.pop()
        w, h = x1 - x0, y1 - y0
        if max(w, h) < 4.5 or (w * h < 14.0 and random.random() < 0.5):
            rooms.append(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]))
            continue
        share = random.uniform(0.35, 0.65)
        if w > h:
            x = x0 + share * w
            a, b = (x, y0), (x, y1)
            todo += [(x0, y0, x, y1), (x, y0, x1, y1)]
        else:
            y = y0 + share * h
            a, b = (x0, y), (x1, y)
            todo += [(x0, y0, x1, y), (x0, y, x1, y1)]
        walls += with_door(a, b, random.uniform(0.2, 0.8), random.uniform(0.75, 0.95), thickness)
    return furnished(Home(outline, walls, rooms), random)


def corridor_home(random: np.random.Generator, size: Tuple[float, float] = (0.0, 0.0)) -> Home:
    """Rooms of different widths on both sides of a corridor; a size [m] of 0 is drawn too."""
    width, height = (value or random.uniform(low, high) for value, low, high in zip(size, (9.0, 7.0), (16.0, 11.0)))
    thickness = random.uniform(0.1, 0.2)
    low = random.uniform(0.36, 0.46) * height
    high = low + random.uniform(1.1, 1.6)
    alcove = random.uniform(0.15, 0.3) * width, random.uniform(0.15, 0.4) * low
    inner = width - alcove[0]
    outline = np.array([[0, 0], [inner, 0], [inner, alcove[1]], [width, alcove[1]], [width, height], [0, height]])
    walls = [wall(outline[k], outline[(k + 1) % len(outline)], thickness) for k in range(len(outline))]
    rooms = [np.array([[0, low], [width, low], [width, high], [0, high]])]
    for y0, y1, door_y in ((0.0, low, low), (high, height, high)):
        edges = [0.0]
        while edges[-1] < width:
            edges.append(edges[-1] + random.uniform(2.4, 4.6))
        edges[-1] = width
        if edges[-1] - edges[-2] < 2.0:
            del edges[-2]
        for x0, x1 in zip(edges[:-1], edges[1:]):
            rooms.append(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]))
            at, door = random.uniform(0.25, 0.75), random.uniform(0.8, 1.1)
            walls += with_door((x0, door_y), (x1, door_y), at, door, thickness)
            if x1 < width:
                slant = random.uniform(-0.4, 0.4) if random.random() < 0.3 else 0.0
                walls.append(wall((x1, y0), (x1 + slant, y1), thickness))
    return furnished(Home(outline, walls, rooms), random)


def furnished(home: Home, random: np.random.Generator, kept: float = 0.0) -> Home:
    """Returns the home with other furniture; a share of what there is keeps its place."""
    things = [thing for thing in home.furniture if random.random() < kept]
    for room in home.rooms:
        low, high = room.min(axis=0) + 0.4, room.max(axis=0) - 0.4
        if (high - low).min() < 0.8:
            continue
        for _ in range(random.integers(1, 4) if not things else random.integers(0, 2)):
            kind, center = random.random(), random.uniform(low, high)
            if kind < 0.25:
                angles = np.linspace(0.0, 2.0 * math.pi, 16, endpoint=False)
                things.append(center + random.uniform(0.3, 0.6) * np.column_stack([np.cos(angles), np.sin(angles)]))
            elif kind < 0.5:  # four legs
                spread = random.uniform(0.4, 1.2, 2)
                corners = _box(center, spread, random.uniform(0, 3))
                things += [_box(corner, np.array([0.06, 0.06]), 0.0) for corner in corners]
            else:
                yaw = 0.0 if random.random() < 0.7 else random.uniform(0.0, math.pi)
                things.append(_box(center, random.uniform((0.5, 0.35), (2.0, 1.0)), yaw))
    return replace(home, furniture=things)


def draw_map(
    home: Home,
    random: np.random.Generator,
    transform: Transform = IDENTITY,
    resolution: float = 0.05,
    missing: int = 0,
    noise: float = 1.0,
) -> GridMap:
    """Draws the map that SLAM would make of a home.

    Args:
        transform: from the home's frame to the map's.
        missing: how many rooms nobody drove into.
        noise: 0: none; 1: bends of up to 3 cm, missed cells, ragged walls, patches nobody saw.
    """
    waves = [(random.uniform(0.3, 1.2, 2), random.uniform(0, 6.28, 2), random.uniform(0, 0.015, 2)) for _ in range(2)]

    def moved(points: np.ndarray) -> np.ndarray:
        bent = np.array(points, float)
        for frequency, phase, size in waves:
            bent = bent + noise * size * np.sin(np.asarray(points)[:, ::-1] * frequency + phase)
        return transform.apply(bent)

    corners = moved(home.outline)
    margin = 0.5 + random.uniform(0.0, 1.0)
    origin = corners.min(axis=0) - margin
    columns, rows = np.ceil((corners.max(axis=0) + margin - origin) / resolution).astype(int)
    unknown = np.full((rows, columns), 255, np.uint8)

    def fill(image: np.ndarray, points: np.ndarray, value: int) -> None:
        cells = (moved(points) - origin) / resolution - 0.5
        cv2.fillPoly(image, [np.round(cells * 2**_SHIFT).astype(np.int32)], value, shift=_SHIFT)

    image = unknown.copy()
    fill(image, home.outline, 0)
    gone = np.zeros_like(image)
    for index in random.permutation(len(home.rooms))[: min(missing, len(home.rooms) - 2)]:
        fill(gone, home.rooms[index], 255)
    patches = np.zeros_like(image)
    for _ in range(int(3 * noise)):
        place = random.uniform(home.outline.min(axis=0), home.outline.max(axis=0))
        fill(patches, _box(place, random.uniform(0.2, 0.8, 2), random.uniform(0, 3)), 255)
    image[(patches > 0) & (image == 0)] = 255
    for thing in home.furniture:
        fill(image, thing, 255)
        cells = (moved(thing) - origin) / resolution - 0.5
        cv2.polylines(image, [np.round(cells * 2**_SHIFT).astype(np.int32)], True, 100, shift=_SHIFT)
    solid = np.zeros_like(image)
    for part in home.walls:
        fill(solid, part, 100)
    near = cv2.dilate((gone == 0).astype(np.uint8), np.ones((3, 3), np.uint8))
    image[gone > 0] = 255
    image[(solid > 0) & (near > 0)] = 100
    if noise > 0:
        edge = cv2.dilate((image == 100).astype(np.uint8), np.ones((3, 3), np.uint8))
        image[(edge > 0) & (image == 0) & (random.random(image.shape) < 0.12 * noise)] = 100  # ragged
        image[(image == 100) & (random.random(image.shape) < 0.06 * noise)] = 0  # missed
        image[(image == 0) & (random.random(image.shape) < 0.0005 * noise)] = 100  # dust and feet
    return GridMap(image.view(np.int8), resolution, (float(origin[0]), float(origin[1]), 0.0))
