"""The maps of one robot's driver, which give the robot's distance from borders and obstacles.

A scanner measures the distance to a wall, but the distance to a border depends on the localisation. So the robot keeps
farther from borders, but not from walls, by its localisation uncertainty. One map, `Workspace.keep_out`, has the
borders inflated by it. The gate, the escape and navigation share this map, so that they agree.
"""

from __future__ import annotations

import math
from typing import Optional

import numpy as np

from vb_core.grid_map import GridMap, clearance_grid, crop, nearest_cell, sample
from vb_core.geometry import Pose, arc_positions
from vb_robot.driving.scan_clearance import HORIZON

LETHAL_THRESHOLD = 99  # [%] a cell of this occupancy or more is never entered


def forbidden_cells(borders: GridMap, physical: GridMap) -> np.ndarray:
    """Returns (H, W) bool: the cells that only a border forbids, including unknown cells."""
    return (borders.data >= LETHAL_THRESHOLD) & (borders.data > physical.data)


def lowest_speed_limit(limits: GridMap, position, reach: float) -> float:
    """Returns the lowest speed limit [m/s] within `reach` [m] of a position (2,) [m], or inf without a limit.

    Args:
        limits: the map that map_integrator publishes [cm/s]; 0 means no limit.
    """
    x, y = position
    reach += 2.0 * limits.resolution  # distances are to the cells' centres, not to their edges
    surroundings = crop(limits, (x - reach, y - reach, x + reach, y + reach))
    cells = np.argwhere(surroundings.data > 0)
    offsets = surroundings.cell_to_world(cells) - position
    cells = cells[np.hypot(*offsets.T) <= reach]
    if not len(cells):
        return math.inf
    return float(surroundings.data[tuple(cells.T)].min()) / 100.0


class Workspace:
    """The floor that a robot may enter. A cell is restricted if the map with borders has a higher occupancy there.

    Restrictions are derived from the maps, so that they always agree with navigation.

    Args:
        borders, physical: the maps with and without borders, of the same geometry.
        radius: [m] of the robot.
        uncertainty: [m] of its localisation.

    Attributes:
        keep_out: the map with borders. Those that must not be entered are inflated by the uncertainty.
    """

    def __init__(self, borders: GridMap, physical: GridMap, radius: float, uncertainty: float = 0.0) -> None:
        self.borders = borders
        self._radius = radius
        # the map's edge is neither a border nor an obstacle, because the floor may continue beyond it
        self._border_distance = clearance_grid(forbidden_cells(borders, physical), borders.resolution)
        near_border = (self._border_distance < uncertainty) & (borders.data >= 0)
        self.keep_out = borders.with_data(np.where(near_border, np.int8(100), borders.data))
        self._blocked_distance = clearance_grid(self.keep_out.data >= LETHAL_THRESHOLD, borders.resolution)

    def distance_to_border(self, point) -> float:
        """Returns the distance [m] from a point (2,) [m] to the nearest cell that a border forbids, or 0 inside it."""
        return self._at(self._border_distance, point)

    def distance_to_blocked(self, point) -> float:
        """Returns the distance [m] from a point (2,) [m] to the nearest blocked cell of `keep_out`, or 0 inside it."""
        return self._at(self._blocked_distance, point)

    def nearest_free_position(self, point, clearance: float, reach: float) -> Optional[np.ndarray]:
        """Finds the nearest known point (2,) [m] within `reach` [m] that has a clearance [m] from blocked cells."""
        has_room = (self._blocked_distance >= clearance) & (self.borders.data >= 0)
        cell, center = nearest_cell(self.borders, has_room, point[:2], reach)
        return None if cell is None else center

    def free_distance(self, pose: Pose, v: float, w: float, margin: float) -> float:
        """Returns how far [m] the robot can drive on the arc of (v, w) until a blocked cell is within `margin` [m].

        A robot that is already too near may move as long as it does not come nearer. A robot that a new border encloses
        may move inside the border, so that a person can guide it out. Nothing is free off the map.
        """
        distances = np.arange(0.0, HORIZON + 1e-9, 0.02)
        direction = math.copysign(1.0, v)
        positions = arc_positions(pose, direction * distances, w / v)
        clearance = sample(self.borders, self._blocked_distance, positions)
        required = min(self._radius + margin, float(clearance[0]))
        too_near = np.flatnonzero(clearance < required - 1e-6)
        if not len(too_near):
            return math.inf
        return max(0.0, float(distances[too_near[0]]) - 0.02)

    def _at(self, layer: np.ndarray, point) -> float:
        position = np.asarray(point, dtype=float)[:2].reshape(1, 2)
        return float(sample(self.borders, layer, position, outside=np.inf)[0])
