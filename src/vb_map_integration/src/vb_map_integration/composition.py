"""The posterior map: the physical map and all regions that act, never anything computed before."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, Iterable

import numpy as np

from vb_core.grid_map import GridMap
from vb_map_integration import raster
from vb_map_integration.integration import Integration


@dataclass(frozen=True)
class Region:
    """What one border does to the map.

    Attributes:
        runs: (N, 2) int64, [start, end) in the flat grid.
        value: 0 .. 100.
        over_unknown: whether it covers unknown cells.
        area_m2: [m^2].
    """

    runs: np.ndarray
    value: int
    over_unknown: bool
    area_m2: float

    @classmethod
    def of(cls, result: Integration) -> "Region":
        """The region of an integration; small, however large the map is."""
        return cls(raster.runs_of(result.mask), result.value, result.over_unknown, result.area_m2)

    def paint(self, cells: np.ndarray, window=None) -> None:
        """Raises the cells (H, W) int8 in place, within a window [start, end) of the flat grid."""
        raster.paint_runs(cells, self.runs, self.value, self.over_unknown, window or (0, cells.size))


class Composition:
    """Physical map plus regions by border id; the order of the regions does not matter, as none lowers a cell.

    Adding one costs the same however many there are. Taking one away recomputes only the rows that it covered.
    """

    def __init__(self, physical: GridMap, regions: Iterable = ()) -> None:
        self.physical = physical
        self._regions: Dict[str, Region] = {}
        self._cells = np.ascontiguousarray(physical.data).copy()
        for key, region in regions:
            self.put(key, region)

    @property
    def posterior(self) -> GridMap:
        """The map now. Its cells are the composition's own: use them before the next change, and do not write."""
        return self.physical.with_data(self._cells)

    def area_m2(self, key: str) -> float:
        """[m^2] that a region restricts; 0 if it does not act."""
        return self._regions[key].area_m2 if key in self._regions else 0.0

    def put(self, key: str, region: Region) -> None:
        """Adds or replaces a region."""
        self.drop(key)
        self._regions[key] = region
        region.paint(self._cells)

    def drop(self, key: str) -> None:
        """Takes a region away; one that is not there is no error."""
        self._without(key, self._cells)
        self._regions.pop(key, None)

    def preview(self, region: Region, instead_of: str = "") -> GridMap:
        """The posterior as it would be with one more region, or with one instead of another."""
        cells = self._cells.copy()
        self._without(instead_of, cells)
        region.paint(cells)
        return self.physical.with_data(cells)

    def _without(self, key: str, cells: np.ndarray) -> None:
        old = self._regions.get(key)
        if old is None or len(old.runs) == 0:
            return
        window = (int(old.runs[0, 0]), int(old.runs[-1, 1]))
        cells.reshape(-1)[slice(*window)] = np.ascontiguousarray(self.physical.data).reshape(-1)[slice(*window)]
        for other, region in self._regions.items():
            if other != key:
                region.paint(cells, window)
