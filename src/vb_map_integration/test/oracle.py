"""Worlds with exact geometry, and an oracle that knows nothing of the code under test: shapely."""

from __future__ import annotations

import math
from typing import Sequence, Tuple

import numpy as np
import shapely
from shapely.affinity import rotate, translate
from shapely.geometry import LineString, Point, Polygon, box
from shapely.ops import split

from vb_core.grid_map import GridMap

RESOLUTION = 0.025
WALL = 0.10

ROOMS = {
    "rectangle": box(0.3, 0.3, 7.7, 4.7),
    "L": Polygon([(0.3, 0.3), (7.7, 0.3), (7.7, 2.4), (4.0, 2.4), (4.0, 4.7), (0.3, 4.7)]),
    "U": Polygon([(0.3, 0.3), (7.7, 0.3), (7.7, 4.7), (5.2, 4.7), (5.2, 2.0), (2.8, 2.0), (2.8, 4.7), (0.3, 4.7)]),
}
ORIGINS = [(0.0, 0.0, 0.0), (-3.0, -7.5, 0.0), (1.0, -2.0, 0.6), (-4.0, 2.0, -2.2), (10.0, 10.0, math.pi / 2)]


def rasterise(shape, grid: GridMap) -> np.ndarray:
    """Returns (H, W) bool, the cells whose centre lies in a shape given in map coordinates."""
    centers = grid.cell_to_world(np.indices(grid.shape).reshape(2, -1).T)
    shapely.prepare(shape)
    return shapely.contains_xy(shape, centers[:, 0], centers[:, 1]).reshape(grid.shape)


def place(shape, origin: Sequence[float]):
    """Transforms a shape from the world's own coordinates to the map frame, by the map's origin."""
    x, y, yaw = origin
    return translate(rotate(shape, yaw, (0.0, 0.0), use_radians=True), x, y)


def world(room, origin, boxes=(), shape=(200, 320)) -> Tuple[GridMap, np.ndarray]:
    """Returns a map of a room with boxes, walls round it, unknown beyond; and the room's shape in the map frame."""
    empty = GridMap(np.full(shape, -1, np.int8), RESOLUTION, origin)
    data = empty.data.copy()
    data[rasterise(place(room.buffer(WALL, join_style=2), origin), empty)] = 100
    data[rasterise(place(room, origin), empty)] = 0
    for obstacle in boxes:
        data[rasterise(place(obstacle, origin), empty)] = 100
    return empty.with_data(data), place(room, origin)


def side_of(room, line: LineString, seed: Sequence[float]):
    """Returns the part of a room with the seed after a sufficiently long line divides it, or None if it does not."""
    parts = list(split(room, line).geoms)
    holding = [part for part in parts if part.covers(Point(*seed))]
    return holding[0] if len(holding) == 1 and len(parts) > 1 else None
