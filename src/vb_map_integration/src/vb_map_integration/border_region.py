"""The region of the map that a virtual border restricts, which integrates the border into the map (paper, Sect. 3).

M_posterior is a copy of M_prior with the seed's side of the border raised to delta, where obstacles keep their value.

`map_integrator.MapIntegrator` handles several borders, undo, and maps that change.

>>> import numpy as np
>>> room = GridMap(np.zeros((60, 60), np.int8), resolution=0.05)      # 3 m x 3 m of free floor
>>> border = VirtualBorder([(1.0, 1.0), (2.0, 1.0), (2.0, 2.0), (1.0, 2.0)], seed=(1.5, 1.5), closed=True)
>>> region = compute_region(room, border)
>>> round(region.area_m2, 2), int(region.posterior.data[30, 30]), int(region.posterior.data[10, 10])
(1.0, 100, 0)
"""

from __future__ import annotations

from typing import Tuple

import cv2
import numpy as np
import shapely

from vb_core.grid_map import OCCUPIED_THRESHOLD, GridMap
from vb_map_integration.border import IntegrationError, VirtualBorder
from vb_map_integration.open_chains import BorderOnGrid, enumerate_runs, fill_side_of_curve, fill_wall
from vb_map_integration.restricted_cells import BorderRegion, CellWindow

# share of the free space. A border that leaves only a corner to be cleaned restricts over 0.9 of a room
MAX_AREA_SHARE = 0.98
# marks the cells that a fill has reached, in a mask of blocked cells
_FILLED = 128


def compute_region(prior: GridMap, border: VirtualBorder) -> BorderRegion:
    """Computes the region of a map that a border restricts.

    A polygon restricts its inside, unknown cells included, or, with the seed outside, all free space outside that is
    connected to the seed. A separating curve is extended to the physical borders and restricts the free space that is
    reachable from the seed without crossing it. A virtual wall restricts a thin band along its chain. Unknown cells
    are raised only if the value counts as an obstacle: a soft value would make them look known and passable.

    Raises:
        IntegrationError: "no_separation", "seed_on_both_sides", "empty_region", "outside_map",
            "seed_outside_map", "seed_on_obstacle", "too_complex".
    """
    positions = prior.world_to_grid(np.concatenate([border.points, [border.seed]]))
    cells = np.ascontiguousarray(prior.data).view(np.uint8)
    on_grid = BorderOnGrid(cells, prior.resolution, positions[:-1], positions[-1])
    try:
        return _integrate(prior, border, on_grid)
    except IntegrationError as error:
        error.warnings = tuple(on_grid.issues)
        raise


def _integrate(prior: GridMap, border: VirtualBorder, on_grid: BorderOnGrid) -> BorderRegion:
    """Computes the region that a border restricts, as `compute_region` does."""
    _check_shape(border, on_grid)
    line = border.points
    if border.closed:
        window, mask = _fill_polygon(on_grid)
    elif border.is_wall:
        window, mask = fill_wall(on_grid)
    else:
        window, mask, line_on_grid = fill_side_of_curve(on_grid)
        line = prior.grid_to_world(line_on_grid)
    restricted = cv2.countNonZero(mask)
    if restricted == 0:
        raise IntegrationError("empty_region")
    free = cv2.countNonZero(cv2.inRange(on_grid.cells, 0, OCCUPIED_THRESHOLD - 1))
    if restricted > MAX_AREA_SHARE * free:
        on_grid.warn("covers_nearly_all")
    return BorderRegion(
        window=window,
        mask=mask,
        cell_value=border.cell_value,
        covers_unknown=border.closed is True and border.cell_value >= OCCUPIED_THRESHOLD,
        area_m2=restricted * prior.resolution**2,
        prior=prior,
        line=line,
        issues=tuple(on_grid.issues),
    )


def _check_shape(border: VirtualBorder, on_grid: BorderOnGrid) -> None:
    """Warns of a border that leaves the map or crosses itself; refuses a seed off the map."""
    limit = np.array(on_grid.cells.shape[::-1]) - 0.5
    if ((on_grid.points < -0.5) | (on_grid.points >= limit)).any():
        on_grid.warn("outside_map")
    if border.is_wall:  # its seed is not used, and it may cross itself
        return
    if ((on_grid.seed < -0.5) | (on_grid.seed >= limit)).any():
        raise IntegrationError("seed_outside_map")
    chain = np.concatenate([border.points, border.points[:1]]) if border.closed else border.points
    if not shapely.linestrings(chain).is_simple:
        on_grid.warn("border_self_intersects")


def _fill_polygon(polygon: BorderOnGrid) -> Tuple[CellWindow, np.ndarray]:
    """Returns the area on the seed's side of a polygon: a window, and its (h, w) uint8 mask."""
    cells, start = polygon.cells, polygon.seed_cell
    window, inner = polygon_mask(polygon.points, cells.shape)
    if not inner.any():
        raise IntegrationError("empty_region")
    row = start[0] - window[0].start
    column = start[1] - window[1].start
    is_in_window = 0 <= row < inner.shape[0] and 0 <= column < inner.shape[1]
    if is_in_window and inner[row, column]:
        obstacles = cv2.inRange(cells[window], OCCUPIED_THRESHOLD, 127)  # unknown cells, 255, stay
        mask = cv2.subtract(inner, obstacles, dst=inner)
        if OCCUPIED_THRESHOLD <= cells[start] <= 127:
            barred = np.full(cells.shape, 255, np.uint8)
            barred[window] = np.invert(mask)
            polygon.find_free_cell(barred)  # only for its warning or refusal: all of the inside is restricted
        return window, mask
    # the outside is all that is connected to the seed, also behind the polygon
    polygon.warn("restricts_outside")
    blocked = cv2.inRange(cells, OCCUPIED_THRESHOLD, 255)
    if blocked[start]:
        barred = blocked.copy()
        barred[window] = np.bitwise_or(barred[window], inner)
        start = polygon.find_free_cell(barred)
    _, _, _, (left, top, width, depth) = cv2.floodFill(blocked, None, start[::-1], _FILLED, flags=4)
    blocked[window] = cv2.subtract(blocked[window], inner)
    outer = slice(top, top + depth), slice(left, left + width)
    return outer, cv2.inRange(blocked[outer], _FILLED, _FILLED)


def polygon_mask(vertices: np.ndarray, shape: Tuple[int, int]) -> Tuple[CellWindow, np.ndarray]:
    """Finds the cells of the map whose centre is in a polygon.

    By the nonzero rule, all that the outline winds round is inside: an overshoot at the closing point leaves no hole.

    Args:
        vertices: (N, 2) (column, row), the first one not repeated.
        shape: (H, W) of the map.

    Returns:
        The window of the map that the polygon covers, which may be empty, and its (h, w) uint8 mask.

    Raises:
        IntegrationError: "too_complex" for an outline that crosses more than MAX_CROSSINGS rows.
    """
    corners = np.array([vertices.min(axis=0), vertices.max(axis=0) + 1.0])
    corners = np.minimum(np.maximum(corners, 0.0), shape[::-1])
    (left, top), (right, bottom) = np.ceil(corners).astype(int).tolist()
    window = slice(top, bottom), slice(left, right)
    height, width = bottom - top, right - left
    mask = np.full((height, width), 0, np.uint8)
    starts = vertices - (left, top)
    x0, y0 = starts.T
    x1, y1 = np.roll(starts, -1, axis=0).T
    # each edge crosses the centres of the rows from `first` to the one before `beyond`
    extent = np.minimum(np.maximum(np.sort([y0, y1], axis=0), 0.0), height)
    first, beyond = np.ceil(extent).astype(np.int64)
    edge, number = enumerate_runs(beyond - first)
    row = first[edge] + number
    slope = np.divide(x1 - x0, y1 - y0, out=np.zeros(len(starts)), where=beyond > first)
    x = x0[edge] + (row - y0[edge]) * slope[edge]
    order = np.lexsort((x, row))
    row = row[order].tolist()
    x_on_map = np.minimum(np.maximum(x[order], 0.0), width)
    column = np.ceil(x_on_map).astype(int).tolist()
    direction = np.where(y1 > y0, 1, -1)
    winding = np.cumsum(direction[edge[order]])
    # in each row the directions add up to zero, so no span reaches into the next one
    for k in np.flatnonzero(winding[:-1]).tolist():
        mask[row[k], column[k] : column[k + 1]] = 255
    return window, mask
