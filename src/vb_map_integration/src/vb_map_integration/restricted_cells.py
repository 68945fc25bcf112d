"""Regions of a map that borders restrict: draws and joins them, and counts the parts of the floor left free."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core.grid_map import OCCUPIED_THRESHOLD, GridMap, Transform
from vb_core.notices import Notice

CellWindow = Tuple[slice, slice]  # rows and columns of a part of a map
Positions = Sequence[Sequence[float]]  # x, y of each robot [m]

# larger maps are checked in coarser cells: only doors and rooms matter here, and people wait for the result
MAX_CELLS = 2_000_000
# [m^2] smaller parts, by the area that the robot's centre can reach, are not counted
MIN_PART_AREA = 0.1


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

    window: CellWindow
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
        # comparing all bytes of the window is ten times as fast as selecting the cells of the mask
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
    """The region that one border restricts on a map."""

    prior: GridMap = field(repr=False)  # the map without the border; it is not changed
    line: np.ndarray  # (M, 2) [m] map frame, the line in effect: for a curve, with its extensions
    issues: Tuple[Notice, ...]  # warnings

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

    def transfer(self, transform: Transform, grid: GridMap) -> Optional[Region]:
        """Transfers the region to another map's free cells, by the transform to that map; None if there are none."""
        corners = self.prior.grid_to_world([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        start, *ends = grid.world_to_grid(transform.apply(corners))
        matrix = np.column_stack([*(end - start for end in ends), start])
        restricted = self.restricted_cells.view(np.uint8)
        cells = cv2.warpAffine(restricted, matrix, grid.shape[::-1], flags=cv2.INTER_NEAREST)
        left, top, width, height = cv2.boundingRect(cells)
        window = slice(top, top + height), slice(left, left + width)
        is_free = (grid.data[window] >= 0) & (grid.data[window] < OCCUPIED_THRESHOLD)
        mask = cells[window] * is_free * np.uint8(255)
        count = cv2.countNonZero(mask)
        return Region(window, mask, self.cell_value, False, count * grid.resolution**2) if count else None


@dataclass(frozen=True)
class BorderCheck:
    """Effect of adding or changing a border."""

    region: BorderRegion  # the region of the physical map that the border restricts
    issues: Tuple[Notice, ...]  # warnings, the region's first
    free_parts: int  # number of parts of the free space with the border, see `count_free_parts`


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
        part_rows = slice(rows.start - top, rows.stop - top)
        part_columns = slice(columns.start - left, columns.stop - left)
        mask[part_rows, part_columns] |= region.mask
    cell_area = max(region.area_m2 / max(1, cv2.countNonZero(region.mask)) for region in regions)
    area = cell_area * cv2.countNonZero(mask)
    window = slice(top, bottom), slice(left, right)
    return Region(window, mask, regions[0].cell_value, regions[0].covers_unknown, area)


def count_free_parts(grid: GridMap, radius: float) -> int:
    """Counts the separate parts of the free space that a robot of a radius [m] can be in; tiny ones are left out."""
    free = cv2.inRange(np.ascontiguousarray(grid.data), 0, OCCUPIED_THRESHOLD - 1)
    factor = int(np.ceil(np.sqrt(free.size / MAX_CELLS)))
    cell = grid.resolution * factor
    reach = radius / cell
    if factor > 1:
        # a coarse cell is free only if all its cells are: obstacles have grown by half a coarse cell already
        kernel = np.ones((factor, factor), np.uint8)
        eroded = cv2.erode(free, kernel, anchor=(0, 0), borderType=cv2.BORDER_CONSTANT, borderValue=0)
        free = np.ascontiguousarray(eroded[::factor, ::factor])
        reach = max(0.0, reach - 0.5)
    if reach > 1.0:
        framed = cv2.copyMakeBorder(free, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
        distances = cv2.distanceTransform(framed, cv2.DIST_L2, 3)[1:-1, 1:-1]
        free = (distances > reach).astype(np.uint8)
    _, _, stats, _ = cv2.connectedComponentsWithStats(free, connectivity=4)
    return int((stats[1:, cv2.CC_STAT_AREA] * cell**2 >= MIN_PART_AREA).sum())
