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

from dataclasses import dataclass, field
from functools import cached_property
from typing import List, Optional, Sequence, Tuple

import cv2
import numpy as np
import shapely

from vb_core.grid_map import OCCUPIED_THRESHOLD, GridMap
from vb_core.notices import Notice
from vb_map_integration.border import IntegrationError, VirtualBorder, warning
from vb_map_integration.grid import raster, separating_curve

# [m] length of a curve's end that gives its extension's direction: longer than hand tremor, shorter than a doorway
EXTENSION_FIT_LENGTH = 0.3
# [m] a drawn end this near a wall is joined to it: less than any robot's width
WALL_SNAP_DISTANCE = 0.2
# [m] how far a seed on an obstacle or on the line is moved to free floor
MAX_SEED_SHIFT = 0.2
# share of the free space; a border that leaves only a corner for spot cleaning restricts over 0.9 of a room
MAX_AREA_SHARE = 0.98
# [m] width of a virtual wall's band; on coarse maps the band is just the cells that the chain runs through
WALL_WIDTH = 0.1
# [m] a longer extension causes a warning: people who draw from wall to wall stop nearer to the walls
LONG_EXTENSION = 1.0
# marks the cells that a fill has reached, in a mask of blocked cells
_FILLED = 128


@dataclass(frozen=True)
class Region:
    """Cells of the map that are restricted.

    Attributes:
        window: the part of the map that contains it.
        mask: (h, w) uint8 of that window, 0 or 255; obstacles are left out.
        cell_value: 0 .. 100, the occupancy that the cells are raised to.
        covers_unknown: whether unknown cells are raised too.
        area_m2: [m^2].
    """

    window: raster.CellWindow
    mask: np.ndarray = field(repr=False)
    cell_value: int
    covers_unknown: bool
    area_m2: float

    def outline(self, grid: GridMap) -> np.ndarray:
        """Returns the outline (N, 2) [m] of its largest part, to about a cell; `grid` is the map that it is on."""
        contours, _ = cv2.findContours(self.mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        largest = cv2.approxPolyDP(max(contours, key=cv2.contourArea), 1.0, True)
        rows, columns = self.window
        return grid.grid_to_world(largest.reshape(-1, 2) + np.array([columns.start, rows.start], float))

    def raise_cells(self, cells: np.ndarray) -> None:
        """Raises the cells (H, W) int8 of the map in place; none is lowered."""
        part = cells[self.window]
        value = np.uint8(self.cell_value)
        # whole bytes are compared, ten times as fast as only the cells of the mask
        if self.covers_unknown:  # as int8, unknown is -1, the lowest value
            np.maximum(part, np.bitwise_or(np.invert(self.mask), value).view(np.int8), out=part)
        else:  # as uint8 it is 255, the highest value
            as_bytes = part.view(np.uint8)
            np.maximum(as_bytes, np.bitwise_and(self.mask, value), out=as_bytes)

    def contains_any(self, cells: np.ndarray) -> bool:
        """Returns whether any of the cells (N, 2) (row, column), on the map or not, belongs to it."""
        cells = cells - [part.start for part in self.window]
        cells = cells[((cells >= 0) & (cells < self.mask.shape)).all(axis=1)]
        return bool(self.mask[tuple(cells.T)].any())

    def iou(self, other: "Region") -> float:
        """Returns the intersection over union of the two regions' cells, 0 .. 1."""
        counts = cv2.countNonZero(self.mask) + cv2.countNonZero(other.mask)
        union = cv2.countNonZero(join_regions([self, other]).mask)  # type: ignore[union-attr]
        return (counts - union) / max(1, union)


@dataclass(frozen=True)
class BorderRegion(Region):
    """The region that one border restricts on a map.

    Attributes:
        prior: the map without the border; it is not changed.
        border: the border.
        line: (M, 2) [m] map frame, the line in effect: for a curve, with its extensions.
        issues: warnings.
    """

    prior: GridMap = field(repr=False)
    border: VirtualBorder
    line: np.ndarray
    issues: Tuple[Notice, ...]

    @cached_property
    def posterior(self) -> GridMap:
        """The map with the border."""
        return apply_regions(self.prior, [self])

    @property
    def restricted_cells(self) -> np.ndarray:
        """(H, W) bool, the cells that the border restricts, without obstacles."""
        cells = np.full(self.prior.shape, 0, np.uint8).view(bool)
        cells[self.window] = self.mask != 0
        return cells


def apply_regions(grid: GridMap, regions: Sequence[Region]) -> GridMap:
    """Returns the map with regions applied; their order does not matter, as none lowers a cell."""
    if not regions:
        return grid
    cells = np.array(grid.data, order="C")
    for region in regions:
        region.raise_cells(cells)
    return grid.with_data(cells)


def join_regions(possible: Sequence[Optional[Region]]) -> Optional[Region]:
    """Joins the regions that are not None into one, with the cell value of the first; returns None if there is none."""
    regions = [region for region in possible if region is not None]
    if len(regions) < 2:
        return regions[0] if regions else None
    top = min(region.window[0].start for region in regions)
    left = min(region.window[1].start for region in regions)
    bottom = max(region.window[0].stop for region in regions)
    right = max(region.window[1].stop for region in regions)
    mask = np.full((bottom - top, right - left), 0, np.uint8)
    for region in regions:
        rows, columns = region.window
        part = mask[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]
        np.maximum(part, region.mask, out=part)
    cell_area = max(region.area_m2 / max(1, cv2.countNonZero(region.mask)) for region in regions)
    area = cell_area * cv2.countNonZero(mask)
    window = slice(top, bottom), slice(left, right)
    return Region(window, mask, regions[0].cell_value, regions[0].covers_unknown, area)


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
    on_grid = _BorderOnGrid(prior, border)
    try:
        return on_grid.compute_region()
    except IntegrationError as error:
        error.warnings = tuple(on_grid.issues)
        raise


class _BorderOnGrid:
    """A border on the cells of a map, and the warnings found so far.

    Attributes:
        points, seed: (N, 2), (2,) [cells] the border's, column first.
        seed_cell: (row, column) of the cell that the seed is in.
        cells: (H, W) uint8, the map's: unknown is 255 as uint8, so one comparison finds obstacles and unknown cells.
    """

    def __init__(self, prior: GridMap, border: VirtualBorder) -> None:
        self.prior = prior
        self.border = border
        grid = prior.world_to_grid(np.concatenate([border.points, [border.seed]]))
        self.points = grid[:-1]
        self.seed = grid[-1]
        self.seed_cell = tuple(prior.world_to_cell(border.seed)[0].tolist())
        self.cells = np.ascontiguousarray(prior.data).view(np.uint8)
        self.issues: List[Notice] = []

    def warn(self, code: str, **values: str) -> None:
        """Adds a warning."""
        self.issues.append(warning(code, **values))

    def compute_region(self) -> BorderRegion:
        """Computes the region that the border restricts."""
        border, line = self.border, self.border.points
        self.check_shape()
        if border.is_wall:
            window, mask = self.fill_wall()
        elif border.closed:
            window, mask = self.fill_polygon()
        else:
            window, mask, line = self.fill_side_of_curve()
        restricted = cv2.countNonZero(mask)
        if restricted == 0:
            raise IntegrationError("empty_region")
        free = cv2.countNonZero(cv2.inRange(self.cells, 0, OCCUPIED_THRESHOLD - 1))
        if restricted > MAX_AREA_SHARE * free:
            self.warn("covers_nearly_all")
        return BorderRegion(
            window=window,
            mask=mask,
            cell_value=border.cell_value,
            covers_unknown=border.closed is True and border.cell_value >= OCCUPIED_THRESHOLD,
            area_m2=restricted * self.prior.resolution**2,
            prior=self.prior,
            border=border,
            line=line,
            issues=tuple(self.issues),
        )

    def check_shape(self) -> None:
        """Warns of a border that leaves the map or crosses itself; refuses a seed off the map."""
        limit = np.array(self.prior.shape[::-1]) - 0.5
        if ((self.points < -0.5) | (self.points >= limit)).any():
            self.warn("outside_map")
        if self.border.is_wall:  # its seed is not used, and it may cross itself
            return
        if ((self.seed < -0.5) | (self.seed >= limit)).any():
            raise IntegrationError("seed_outside_map")
        chain = self.border.points
        if self.border.closed:
            chain = np.concatenate([chain, chain[:1]])
        if not shapely.linestrings(chain).is_simple:
            self.warn("border_self_intersects")

    def fill_polygon(self) -> Tuple[raster.CellWindow, np.ndarray]:
        """Returns the area on the seed's side of a polygon: a window, and its (h, w) uint8 mask."""
        cells = self.cells
        window, inner = raster.polygon_mask(self.points, cells.shape)
        if not inner.any():
            raise IntegrationError("empty_region")
        row = self.seed_cell[0] - window[0].start
        column = self.seed_cell[1] - window[1].start
        if 0 <= row < inner.shape[0] and 0 <= column < inner.shape[1] and inner[row, column]:
            obstacles = cv2.inRange(cells[window], OCCUPIED_THRESHOLD, 127)  # unknown cells, 255, stay
            mask = cv2.subtract(inner, obstacles, dst=inner)
            if OCCUPIED_THRESHOLD <= cells[self.seed_cell] <= 127:
                barred = np.full(cells.shape, 255, np.uint8)
                barred[window] = np.invert(mask)
                self.find_free_cell(barred)  # for its warning or refusal: the whole inside is restricted
            return window, mask
        # the outer area is everything connected to the seed, also behind the polygon
        self.warn("restricts_outside")
        start = self.seed_cell
        blocked = cv2.inRange(cells, OCCUPIED_THRESHOLD, 255)
        if blocked[start]:
            barred = blocked.copy()
            barred[window] = np.bitwise_or(barred[window], inner)
            start = self.find_free_cell(barred)
        _, _, _, (left, top, width, depth) = cv2.floodFill(blocked, None, start[::-1], _FILLED, flags=4)
        blocked[window] = cv2.subtract(blocked[window], inner)
        outer = slice(top, top + depth), slice(left, left + width)
        return outer, cv2.inRange(blocked[outer], _FILLED, _FILLED)

    def fill_wall(self) -> Tuple[raster.CellWindow, np.ndarray]:
        """Returns the free cells of a band along a chain: a window, and its (h, w) uint8 mask."""
        chain_cells = raster.rasterize_chain(self.points, self.cells.shape).cells
        chain_cells = chain_cells[self.prior.contains_cells(chain_cells)]
        if len(chain_cells) == 0:
            raise IntegrationError("outside_map")
        reach = int(WALL_WIDTH / 2.0 / self.prior.resolution + 1e-6)
        top, left = np.maximum(chain_cells.min(axis=0) - reach, 0).tolist()
        bottom, right = (chain_cells.max(axis=0) + reach + 1).tolist()
        window = slice(top, bottom), slice(left, right)
        mask = np.full(self.cells[window].shape, 0, np.uint8)
        rows, columns = (chain_cells - (top, left)).T
        mask[rows, columns] = 255
        if reach:
            mask = cv2.dilate(mask, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
        free = cv2.inRange(self.cells[window], 0, OCCUPIED_THRESHOLD - 1)
        return window, cv2.bitwise_and(mask, free)

    def fill_side_of_curve(self) -> Tuple[raster.CellWindow, np.ndarray, np.ndarray]:
        """Returns the area on the seed's side of a separating curve: a window, its (h, w) uint8 mask, and the line [m]."""
        prior = self.prior
        # no fill may enter obstacles, unknown cells, or the frame round the map
        framed = np.full((prior.shape[0] + 2, prior.shape[1] + 2), 255, np.uint8)
        cv2.inRange(self.cells, OCCUPIED_THRESHOLD, 255, dst=framed[1:-1, 1:-1])
        fit_length = EXTENSION_FIT_LENGTH / prior.resolution
        tolerance = WALL_SNAP_DISTANCE / prior.resolution
        cut = separating_curve.cut_free_space(framed, self.points, fit_length, tolerance)
        start = self.find_free_cell(framed[1:-1, 1:-1], cut.direction_to(self.seed))
        window, mask = cut.fill_side(start)
        line = prior.grid_to_world(cut.line)
        extensions = np.linalg.norm(line[[0, -1]] - self.border.points[[0, -1]], axis=1)
        ends = cut.trace.cells[[0, -1]].tolist()
        for (row, column), length, side in zip(ends, extensions, ("$line_start", "$line_end")):
            on_map = 0 <= row < prior.shape[0] and 0 <= column < prior.shape[1]
            if not on_map or self.cells[row, column] > 127:
                self.warn("no_wall_found")
            elif length > LONG_EXTENSION:
                self.warn("extended_far", length=f"{length:.1f}", side=side)
        return window, mask, line

    def find_free_cell(self, barred: np.ndarray, away: Optional[np.ndarray] = None) -> Tuple[int, int]:
        """Returns the seed's cell (row, column), or the nearest one not barred, on the side `away` points to if given.

        Raises:
            IntegrationError: "seed_on_obstacle" if there is none within MAX_SEED_SHIFT.
        """
        row, column = self.seed_cell
        if not barred[row, column]:
            return row, column
        radius = MAX_SEED_SHIFT / self.prior.resolution
        reach = int(radius) + 1
        top = max(0, row - reach)
        left = max(0, column - reach)
        allowed = barred[top : row + reach + 1, left : column + reach + 1] == 0
        cells = np.argwhere(allowed) + (top, left)
        offsets = cells[:, ::-1] - self.seed
        distances = np.hypot(offsets[:, 0], offsets[:, 1])
        if away is not None:
            distances[offsets @ away <= 0.0] = np.inf
        if len(distances) == 0 or distances.min() > radius:
            raise IntegrationError("seed_on_obstacle", radius=MAX_SEED_SHIFT)
        nearest = int(np.argmin(distances))
        self.warn("seed_moved", distance=f"{distances[nearest] * self.prior.resolution:.2f}")
        row, column = cells[nearest].tolist()
        return row, column
