"""Operations on grid maps and their layers: cropping, clearance, values at points, the nearest cell of a mask."""

from __future__ import annotations

from typing import Optional, Tuple

import numpy as np

from vb_core.grid_map import GridMap, distance_to

Window = Tuple[float, float, float, float]


def crop(grid: GridMap, window: Window) -> GridMap:
    """Cuts a window (x_min, y_min, x_max, y_max) [m] out of a map; cells off the map are unknown."""
    corners = np.array([[window[i], window[j]] for i in (0, 2) for j in (1, 3)])
    cells = np.floor(grid.world_to_grid(corners) + 0.5).astype(int)[:, ::-1]
    low, high = cells.min(axis=0), cells.max(axis=0)
    data = np.full(high - low + 1, -1, dtype=np.int8)
    begin, end = np.maximum(low, 0), np.minimum(high + 1, grid.shape)
    if (begin < end).all():
        data[begin[0] - low[0] : end[0] - low[0], begin[1] - low[1] : end[1] - low[1]] = grid.data[
            begin[0] : end[0], begin[1] : end[1]
        ]
    x, y = grid.grid_to_world(low[None, ::-1] - 0.5)[0]
    return GridMap(data, grid.resolution, (x, y, grid.origin[2]))


def clearance_grid(blocked: np.ndarray, resolution: float) -> np.ndarray:
    """Computes each cell's clearance (H, W) float32 [m] from its centre to the nearest blocked cell; 0 if blocked.

    Half a cell's diagonal is subtracted from the distance between centres, so that the result never exceeds the true
    clearance. The map's edge is not blocked; if no cell is blocked, every clearance is inf.
    """
    return np.maximum(distance_to(blocked) - np.sqrt(0.5), 0.0) * np.float32(resolution)


def sample(grid: GridMap, layer: np.ndarray, points: np.ndarray, outside: float = 0.0) -> np.ndarray:
    """Returns the values (N,) of a grid's layer (H, W) at points (N, 2) [m]; `outside` for points off the map."""
    cells = grid.world_to_cell(points)
    inside = grid.contains_cells(cells)
    values = np.full(len(cells), outside, dtype=float)
    values[inside] = layer[cells[inside, 0], cells[inside, 1]]
    return values


def nearest_cell(grid: GridMap, mask: np.ndarray, point, reach: float) -> Tuple[Optional[Tuple[int, int]], np.ndarray]:
    """Finds a mask's (H, W) cell (row, column) nearest to a point (2,) [m], up to `reach` [m] away, and its centre.

    Returns None and the point itself if there is none.
    """
    point = np.asarray(point, dtype=float)
    row, column = grid.world_to_cell(point)[0]
    span = int(np.ceil(reach / grid.resolution))
    top, left = max(row - span, 0), max(column - span, 0)
    cells = np.argwhere(mask[top : max(row + span + 1, 0), left : max(column + span + 1, 0)]) + (top, left)
    centers = grid.cell_to_world(cells) if len(cells) else np.zeros((0, 2))
    distances = np.linalg.norm(centers - point, axis=1)
    nearest = int(np.argmin(distances)) if len(cells) else -1
    if nearest < 0 or distances[nearest] > reach:
        return None, point
    return (int(cells[nearest, 0]), int(cells[nearest, 1])), centers[nearest]
