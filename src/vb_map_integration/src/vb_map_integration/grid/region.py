"""The cells of the map that one border restricts, and the parts into which borders split the free floor."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Optional, Sequence

import cv2
import numpy as np

from vb_core.grid_map import OCCUPIED_THRESHOLD, GridMap
from vb_map_integration.grid import raster

# larger maps are checked in coarser cells: the check is about doors and rooms, and people wait for its result
MAX_CELLS = 2_000_000
# [m^2] smaller parts, by the area that the robot's centre can reach, are not counted
MIN_PART = 0.1


@dataclass(frozen=True)
class Region:
    """Cells of the map that one border restricts.

    Attributes:
        window: the part of the map that contains it.
        mask: (h, w) uint8 of that window, 0 or 255; obstacles are left out.
        value: 0 .. 100, the occupancy that the cells are raised to.
        over_unknown: whether unknown cells are raised too.
        area_m2: [m^2].
    """

    window: raster.CellWindow
    mask: np.ndarray = field(repr=False)
    value: int
    over_unknown: bool
    area_m2: float

    def outline(self, grid: GridMap) -> np.ndarray:
        """Returns the outline (N, 2) [m] of its largest part, to about a cell; `grid` is the map that it is on."""
        contours, _ = cv2.findContours(self.mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        largest = cv2.approxPolyDP(max(contours, key=cv2.contourArea), 1.0, True)
        rows, columns = self.window
        return grid.grid_to_world(largest.reshape(-1, 2) + np.array([columns.start, rows.start], float))

    def apply(self, cells: np.ndarray) -> None:
        """Raises the cells (H, W) int8 of the map in place; none is lowered."""
        part, level = cells[self.window], np.uint8(self.value)
        if self.over_unknown:  # as int8, unknown is -1, the lowest value
            np.maximum(part, np.bitwise_or(np.invert(self.mask), level).view(np.int8), out=part)
        else:  # as uint8 it is 255, the highest value
            as_bytes = part.view(np.uint8)
            np.maximum(as_bytes, np.bitwise_and(self.mask, level), out=as_bytes)

    def iou(self, other: Optional["Region"]) -> float:
        """Returns the intersection over union of the two regions' cells, 0 .. 1."""
        if other is None:
            return 0.0
        one, two, either = (cv2.countNonZero(region.mask) for region in (self, other, join_regions([self, other])))
        return (one + two - either) / max(1, either)


def apply_regions(grid: GridMap, regions: Sequence[Region]) -> GridMap:
    """Returns the map with regions applied; their order does not matter, as none lowers a cell."""
    if not regions:
        return grid
    cells = np.array(grid.data, order="C")
    for region in regions:
        region.apply(cells)
    return grid.with_data(cells)


def join_regions(possible: Sequence[Optional[Region]]) -> Optional[Region]:
    """Joins the regions that are not None into one, with the value of the first; returns None if there is none."""
    regions = [one for one in possible if one is not None]
    if len(regions) < 2:
        return regions[0] if regions else None
    window = tuple(
        slice(min(one.window[axis].start for one in regions), max(one.window[axis].stop for one in regions))
        for axis in (0, 1)
    )
    mask = raster.filled((window[0].stop - window[0].start, window[1].stop - window[1].start), 0)
    for one in regions:
        part = tuple(slice(own.start - all_.start, own.stop - all_.start) for own, all_ in zip(one.window, window))
        np.maximum(mask[part], one.mask, out=mask[part])
    first = regions[0]
    cell = max(one.area_m2 / max(1, cv2.countNonZero(one.mask)) for one in regions)
    area = cell * cv2.countNonZero(mask)
    return Region(window, mask, first.value, first.over_unknown, area)  # type: ignore[arg-type]


def count_free_parts(grid: GridMap, radius: float) -> int:
    """Counts the parts into which the free space falls for a robot of a given radius [m]; tiny ones are left out."""
    free = cv2.inRange(np.ascontiguousarray(grid.data), 0, OCCUPIED_THRESHOLD - 1)
    factor = int(np.ceil(np.sqrt(free.size / MAX_CELLS)))
    cell = grid.resolution * factor
    reach = radius / cell
    if factor > 1:
        free = _coarser(free, factor)
        # a coarse cell is free only if all its cells are: obstacles have grown by half a coarse cell already
        reach = max(0.0, reach - 0.5)
    if reach > 1.0:
        framed = cv2.copyMakeBorder(free, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
        free = (cv2.distanceTransform(framed, cv2.DIST_L2, 3)[1:-1, 1:-1] > reach).astype(np.uint8)
    _, _, stats, _ = cv2.connectedComponentsWithStats(free, connectivity=4)
    return int((stats[1:, cv2.CC_STAT_AREA] * cell**2 >= MIN_PART).sum())


def _coarser(free: np.ndarray, factor: int) -> np.ndarray:
    """Makes a mask (H, W) uint8 with cells `factor` times as large; a coarse cell is set only if all its cells are."""
    rows, columns = (-(-size // factor) for size in free.shape)
    padded = cv2.copyMakeBorder(
        free, 0, rows * factor - free.shape[0], 0, columns * factor - free.shape[1], cv2.BORDER_CONSTANT, value=0
    )
    return cv2.inRange(cv2.resize(padded, (columns, rows), interpolation=cv2.INTER_AREA), 255, 255)
