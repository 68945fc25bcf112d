"""The 2D occupancy grid map (OGM) as numpy sees it, and operations on maps and their layers (H, W).

All packages keep maps, costmaps and coverage in this form; `vb_core.ros.messages` converts it from and to ROS messages.

>>> import numpy as np
>>> grid = GridMap(np.zeros((40, 60), np.int8), resolution=0.05, origin=(-1.0, 0.0, 0.0))
>>> grid.shape, grid.world_to_cell([0.0, 1.0])[0].tolist()   # (x, y) [m] to (row, column)
((40, 60), [20, 20])
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Optional, Tuple

import numpy as np

from vb_core.errors import CodedError

FREE = 0
OCCUPIED = 100
UNKNOWN = -1
OCCUPIED_THRESHOLD = 65  # [%] cells of this occupancy or more are obstacles: map_server's occupied_thresh
Window = Tuple[float, float, float, float]


def distance_transform(cells: np.ndarray) -> np.ndarray:
    """Computes the distance transform (H, W) float32 [cells]: from each centre of a cell to the nearest marked cell's.

    The same mask always yields the same bits, for distances up to 1400 cells. OpenCV's exact transform does not: it
    computes square roots with or without vector instructions, depending on where the rows lie in memory, and the two
    differ in the last bit. Squared distances between cells are whole numbers, so rounding them removes the difference.

    Args:
        cells: mask (H, W) bool. If nothing is marked, every distance is inf.
    """
    if not cells.any():
        return np.full(cells.shape, np.inf, np.float32)
    import cv2  # most nodes with a map never need distances, and OpenCV takes 20 MiB per process

    distance = cv2.distanceTransform((~cells).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    np.multiply(distance, distance, out=distance)
    np.rint(distance, out=distance)
    return np.sqrt(distance, out=distance)


class Transform(NamedTuple):
    """A rigid motion in the plane, from one map's frame to another's: q = R(yaw) p + (x, y).

    Attributes:
        x, y, yaw: [m], [m], [rad].

    >>> Transform(1.0, 0.0, math.pi / 2).apply([(2.0, 0.0)]).round(3).tolist()
    [[1.0, 2.0]]
    """

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Moves points (N, 2) [m]; the identity returns the same numbers."""
        points = np.asarray(points, dtype=float).reshape(-1, 2)
        if not any(self):
            return points
        return points @ self.rotation.T + (self.x, self.y)

    @property
    def rotation(self) -> np.ndarray:
        """The rotation matrix (2, 2)."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.array([[c, -s], [s, c]])

    @property
    def inverse(self) -> "Transform":
        """The motion back."""
        if not any(self):
            return self
        x, y = -self.rotation.T @ (self.x, self.y)
        return Transform(float(x), float(y), -self.yaw)

    def after(self, first: "Transform") -> "Transform":
        """Returns this motion after another one."""
        x, y = self.rotation @ (first.x, first.y) + (self.x, self.y)
        return Transform(float(x), float(y), math.remainder(self.yaw + first.yaw, 2.0 * math.pi))

    @classmethod
    def rotation_about(cls, center: np.ndarray, destination: np.ndarray, yaw: float) -> "Transform":
        """Returns the motion that turns about a centre (2,) [m] by a yaw [rad], and takes it to a destination (2,) [m]."""
        x, y = destination - cls(yaw=yaw).apply(center)[0]
        return cls(float(x), float(y), math.remainder(yaw, 2.0 * math.pi))


@dataclass(frozen=True)
class GridMap:
    """An occupancy grid.

    Attributes:
        data: (H, W) int8; -1 unknown, 0 free ... 100 occupied. Row 0 holds the map's lowest y.
        resolution: [m] edge length of a cell.
        origin: (x, y, yaw) [m, m, rad] of the outer corner of cell (0, 0) in the map frame.

    Raises:
        CodedError: "bad_map" if shape, resolution or origin are invalid.
    """

    data: np.ndarray
    resolution: float
    origin: Tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        data = np.asarray(self.data)
        if data.ndim != 2 or data.size == 0:
            raise CodedError("bad_map", f"a map needs rows and columns, this one has the shape {data.shape}")
        if data.dtype != np.int8:
            data = data.astype(np.int8)
        origin = tuple(float(value) for value in self.origin)
        if len(origin) != 3 or not all(math.isfinite(value) for value in origin):
            raise CodedError("bad_map", f"the map's origin must be x, y and yaw, got {self.origin}")
        if not (math.isfinite(self.resolution) and self.resolution > 0):
            raise CodedError("bad_map", f"the map's resolution must be above 0 m, got {self.resolution}")
        object.__setattr__(self, "data", data)
        object.__setattr__(self, "origin", origin)
        object.__setattr__(self, "resolution", float(self.resolution))

    @property
    def shape(self) -> Tuple[int, int]:
        """(rows, columns)."""
        return self.data.shape  # type: ignore[return-value]

    @cached_property
    def _corner(self) -> np.ndarray:
        """The outer corner (2,) [m] of cell (0, 0)."""
        return np.array(self.origin[:2])

    @cached_property
    def _turn(self) -> np.ndarray:
        """The matrix (2, 2) that rotates row vectors from the map frame to (column, row) axes."""
        return Transform(*self.origin).rotation

    def same_geometry(self, other: "GridMap") -> bool:
        """Returns whether both maps have the same size, resolution and origin."""
        return (
            self.shape == other.shape
            and math.isclose(self.resolution, other.resolution, rel_tol=1e-6)
            and np.allclose(self.origin, other.origin, atol=1e-6)
        )

    def with_data(self, data: np.ndarray) -> "GridMap":
        """Returns a map of the same geometry with other cells (H, W)."""
        if np.shape(data) != self.shape:
            raise CodedError("bad_map", f"expected {self.shape} cells, got {np.shape(data)}")
        return GridMap(data, self.resolution, self.origin)

    def world_to_grid(self, points: np.ndarray) -> np.ndarray:
        """Converts map coordinates (N, 2) [m] to fractional (column, row) (N, 2). Inverse of `grid_to_world`.

        Whole numbers are the centres of cells, as in image coordinates.
        """
        points = np.asarray(points, dtype=float).reshape(-1, 2)
        return (points - self._corner) @ self._turn / self.resolution - 0.5

    def grid_to_world(self, columns_rows: np.ndarray) -> np.ndarray:
        """Converts (column, row) (N, 2) to map coordinates (N, 2) [m]. Inverse of `world_to_grid`."""
        cells = np.asarray(columns_rows, dtype=float).reshape(-1, 2)
        return (cells + 0.5) * self.resolution @ self._turn.T + self._corner

    def world_to_cell(self, points: np.ndarray) -> np.ndarray:
        """Returns the cells (N, 2), int (row, column), that contain points (N, 2) [m]. They may be outside the map."""
        grid = np.floor(self.world_to_grid(points) + 0.5)
        # np.clip is several times slower for the few points in a usual call
        return np.minimum(np.maximum(grid, -(2.0**31)), 2.0**31).astype(np.int64)[:, ::-1]

    def cell_to_world(self, rows_columns: np.ndarray) -> np.ndarray:
        """Returns the centres (N, 2) [m] of cells (N, 2), (row, column)."""
        return self.grid_to_world(np.asarray(rows_columns).reshape(-1, 2)[:, ::-1])

    def contains_cells(self, rows_columns: np.ndarray) -> np.ndarray:
        """Returns, as (N,) bool, which cells (N, 2), (row, column), are in the map."""
        cells = np.asarray(rows_columns).reshape(-1, 2)
        rows, columns = cells[:, 0], cells[:, 1]
        return (rows >= 0) & (columns >= 0) & (rows < self.shape[0]) & (columns < self.shape[1])

    def corners(self) -> np.ndarray:
        """Returns the map's outer corners (4, 2) [m], counter-clockwise, starting at the origin."""
        rows, columns = self.shape
        return self.grid_to_world(np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]], dtype=float) - 0.5)


def crop(grid: GridMap, window: Window) -> GridMap:
    """Cuts a window (x_min, y_min, x_max, y_max) [m] out of a map. Cells off the map are unknown."""
    x_min, y_min, x_max, y_max = window
    corners = np.array([(x_min, y_min), (x_min, y_max), (x_max, y_min), (x_max, y_max)])
    cells = grid.world_to_cell(corners)
    low = cells.min(axis=0)
    high = cells.max(axis=0) + 1
    data = np.full(high - low, UNKNOWN, dtype=np.int8)
    top, left = np.maximum(low, 0)
    bottom, right = np.minimum(high, grid.shape)
    if top < bottom and left < right:
        rows = slice(top - low[0], bottom - low[0])
        columns = slice(left - low[1], right - low[1])
        data[rows, columns] = grid.data[top:bottom, left:right]
    x, y = grid.cell_to_world(low - 0.5)[0]
    return GridMap(data, grid.resolution, (x, y, grid.origin[2]))


def clearance_grid(blocked: np.ndarray, resolution: float) -> np.ndarray:
    """Computes the clearance (H, W) float32 [m] of each cell: how far its centre is from the nearest blocked cell.

    A blocked cell has the clearance 0. Half a cell's diagonal is subtracted from the distance between centres, so that
    the result never exceeds the true clearance. The map's edge is not blocked; if no cell is blocked, all are inf.
    """
    return np.maximum(distance_transform(blocked) - np.sqrt(0.5), 0.0) * np.float32(resolution)


def sample(grid: GridMap, layer: np.ndarray, points: np.ndarray, outside: float = 0.0) -> np.ndarray:
    """Returns the values (N,) of a grid's layer (H, W) at points (N, 2) [m]; `outside` for points off the map."""
    cells = grid.world_to_cell(points)
    inside = grid.contains_cells(cells)
    values = np.full(len(cells), outside, dtype=float)
    values[inside] = layer[cells[inside, 0], cells[inside, 1]]
    return values


def nearest_cell(grid: GridMap, mask: np.ndarray, point, reach: float) -> Tuple[Optional[Tuple[int, int]], np.ndarray]:
    """Finds the marked cell of a mask (H, W) nearest to a point (2,) [m]. Returns its (row, column) and its centre.

    If no marked cell is within `reach` [m], returns None and the point itself.
    """
    point = np.asarray(point, dtype=float)
    row, column = grid.world_to_cell(point)[0]
    span = int(np.ceil(reach / grid.resolution))
    top, left = max(row - span, 0), max(column - span, 0)
    bottom, right = max(row + span + 1, 0), max(column + span + 1, 0)
    cells = np.argwhere(mask[top:bottom, left:right]) + (top, left)
    centers = grid.cell_to_world(cells)
    distances = np.linalg.norm(centers - point, axis=1)
    if not distances.min(initial=np.inf) <= reach:
        return None, point
    nearest = int(np.argmin(distances))
    return (int(cells[nearest, 0]), int(cells[nearest, 1])), centers[nearest]
