"""The map with borders, always computed from the physical map and all regions that are in force."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, Mapping, Optional, Sequence

import cv2
import numpy as np

from vb_core.grid_map import GridMap
from vb_map_integration.grid import raster
from vb_map_integration.integration import Area


@dataclass(frozen=True)
class Region:
    """Cells of the map that one border restricts; one bit for each cell of its window.

    Attributes:
        window: the part of the map that it is in.
        bits: the packed mask of that window.
        value: 0 .. 100.
        over_unknown: whether it covers unknown cells.
        area_m2: [m^2].
    """

    window: raster.Window
    bits: np.ndarray
    value: int
    over_unknown: bool
    area_m2: float

    @classmethod
    def of(cls, area: Area) -> "Region":
        """Packs an area into a region."""
        return cls(area.window, np.packbits(area.mask), area.value, area.over_unknown, area.area_m2)

    @property
    def cells(self) -> int:
        """Number of cells."""
        return cv2.countNonZero(self.mask)

    @property
    def mask(self) -> np.ndarray:
        """The mask (h, w) uint8 of the window."""
        rows, columns = self.window
        shape = rows.stop - rows.start, columns.stop - columns.start
        bits = np.unpackbits(self.bits, count=shape[0] * shape[1]).reshape(shape)
        return np.negative(bits, out=bits)  # 1 becomes 255

    def outline(self, grid: GridMap) -> np.ndarray:
        """Returns the outline (N, 2) [m] of its largest part, to about a cell, on the map that it is of."""
        contours, _ = cv2.findContours(self.mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        largest = cv2.approxPolyDP(max(contours, key=cv2.contourArea), 1.0, True)
        rows, columns = self.window
        return grid.grid_to_world(largest.reshape(-1, 2) + np.array([columns.start, rows.start], float))

    def apply(self, cells: np.ndarray) -> None:
        """Raises the cells (H, W) int8 in place."""
        raster.paint(cells[self.window], self.mask, self.value, self.over_unknown)

    def apply_within(self, cells: np.ndarray, window: raster.Window) -> None:
        """Applies the region to a window of the map."""
        rows = _overlap(self.window[0], window[0])
        columns = _overlap(self.window[1], window[1]) if rows else None
        if rows is None or columns is None:
            return  # as most of a thousand do: this is what removing a border costs
        part = self.mask[
            rows.start - self.window[0].start : rows.stop - self.window[0].start,
            columns.start - self.window[1].start : columns.stop - self.window[1].start,
        ]
        raster.paint(cells[rows, columns], part, self.value, self.over_unknown)


def join_regions(regions: Sequence[Region]) -> Optional[Region]:
    """Returns the region of all cells of some regions, with the value of the first one; None if there is none."""
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
    cell = max(one.area_m2 / max(1, one.cells) for one in regions)
    area = cell * cv2.countNonZero(mask)
    return Region(window, np.packbits(mask), first.value, first.over_unknown, area)  # type: ignore[arg-type]


class LayeredMap:
    """Physical map plus regions by border id. It never changes: `with_regions` returns a new one.

    The order of the regions does not matter, as none lowers a cell. Adding one costs the same however many there
    are; removing one checks only those that overlap its window.

    Attributes:
        physical: the map without borders.
        map_with_borders: the map with them.
    """

    def __init__(self, physical: GridMap) -> None:
        self.physical = physical
        self.map_with_borders = physical
        self._regions: Dict[str, Region] = {}

    def region(self, key: str) -> Optional[Region]:
        """Returns a region; None if there is none of that key."""
        return self._regions.get(key)

    def with_regions(self, changes: Mapping[str, Optional[Region]]) -> "LayeredMap":
        """Returns the map with some regions added or replaced, and without those whose value is None."""
        result = LayeredMap(self.physical)
        result._regions = {key: region for key, region in self._regions.items() if key not in changes}
        cells = np.array(self.map_with_borders.data, order="C")
        for key in changes:
            old = self._regions.get(key)
            if old is not None:
                cells[old.window] = self.physical.data[old.window]
                for region in result._regions.values():
                    region.apply_within(cells, old.window)
        for key, region in changes.items():
            if region is not None:
                result._regions[key] = region
                region.apply(cells)
        result.map_with_borders = self.physical.with_data(cells)
        return result


def _overlap(a: slice, b: slice) -> Optional[slice]:
    if a.start >= b.stop or b.start >= a.stop:
        return None
    return slice(max(a.start, b.start), min(a.stop, b.stop))
