"""The map with borders, always computed from the physical map and all regions that are in force."""

from __future__ import annotations

from typing import Dict, Mapping, Optional

import numpy as np

from vb_core.grid_map import GridMap
from vb_map_integration.grid.region import Region


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
                    region.apply(cells, old.window)
        for key, region in changes.items():
            if region is not None:
                result._regions[key] = region
                region.apply(cells)
        result.map_with_borders = self.physical.with_data(cells)
        return result
