"""Computes an occupancy grid's costs as move_base's costmap_2d does: obstacles and inflation."""

from __future__ import annotations

from typing import Optional

import numpy as np

from vb_core.grid_map import OCCUPIED, GridMap, distance_to

LETHAL = 254
INSCRIBED = 253
NO_INFORMATION = 255
INFLATION = 0.17  # [m] for a robot: costmap_2d's inflation_radius minus the robot's own radius
_SCALING = 8.0  # [1/m] decay of the cost around obstacles: costmap_2d's cost_scaling_factor


class Costmap:
    """Costs (H, W) uint8: 254 obstacle, 253 robot's centre must not be there, 255 unknown, 0 free.

    Attributes:
        grid: the map from which it was made.
        costs: (H, W) uint8.
        distance: (H, W) float32 [m] from each cell's centre to the nearest obstacle cell's.
    """

    def __init__(
        self, grid: GridMap, radius: float, obstacles: Optional[np.ndarray] = None, inflation: float = INFLATION
    ) -> None:
        """Makes the costmap of a map.

        Args:
            radius: [m] of the robot, or person, that moves there.
            obstacles: (H, W) bool, further obstacle cells beside the map's.
            inflation: [m] beyond the radius, within which cells near obstacles cost more.
        """
        self.grid = grid
        static = static_costs(grid.data)
        if obstacles is not None:
            static[obstacles] = LETHAL
        self.distance = distance_to(static == LETHAL) * np.float32(grid.resolution)
        self.costs = inflate(static, self.distance, radius, inflation)

    def traversable(self) -> np.ndarray:
        """Returns (H, W) bool: in which cells the robot's centre may be; in unknown cells it may not."""
        return self.costs < INSCRIBED

    def occupancy(self) -> np.ndarray:
        """Returns (H, W) int8, as costmap_2d's publisher does: 100 lethal, 99 inscribed, 98 ... 0, -1 unknown."""
        table = np.zeros(256, np.int16)
        table[1:INSCRIBED] = 1 + (97 * (np.arange(1, INSCRIBED) - 1)) // 251
        table[INSCRIBED], table[LETHAL], table[NO_INFORMATION] = 99, 100, -1
        return table[self.costs].astype(np.int8)


def static_costs(data: np.ndarray) -> np.ndarray:
    """Converts occupancy (H, W) int8 to costs (H, W) uint8 as static_layer's interpretValue does.

    As without `trinary_costmap`: soft borders (occupancy under 100) are crossed where there is no other path.
    """
    table = np.full(256, NO_INFORMATION, np.uint8)  # -1, seen as unsigned, is among the rest
    table[: OCCUPIED + 1] = np.arange(OCCUPIED + 1) / OCCUPIED * LETHAL
    return table[data.view(np.uint8)]


def inflate(static: np.ndarray, distance: np.ndarray, radius: float, inflation: float) -> np.ndarray:
    """Inflates costs (H, W) uint8 with the decay of inflation_layer's computeCost; the higher cost wins."""
    decay = (INSCRIBED - 1) * np.exp(-_SCALING * (distance - radius))
    # a cell whose distance equals the radius is within it, despite rounding errors
    inflated = np.where(distance <= radius + 1e-6, INSCRIBED, decay)
    inflated[distance > radius + inflation + 1e-6] = 0
    costs = np.maximum(static, np.minimum(inflated, INSCRIBED).astype(np.uint8))
    costs[static == LETHAL] = LETHAL
    # as in the real layer: unknown stays unknown unless a robot would touch an obstacle there
    unknown = static == NO_INFORMATION
    costs[unknown] = np.where(inflated[unknown] >= INSCRIBED, INSCRIBED, NO_INFORMATION)
    return costs
