"""Floor that a border is about to take, and ways that keep off it (paper, Sect. 4.2, states Border and Seed).

Navigation does not know a border before it is saved. A robot that drives across what is being drawn may stand in
it when it is saved, and from inside a border navigation plans nothing. So its ways are chosen to keep off.
"""
from __future__ import annotations

from typing import TYPE_CHECKING, Optional

import cv2
import numpy as np

from vb_robot.terrain import Terrain, clearance_grid, sample

if TYPE_CHECKING:
    from vb_robot.viewpoint import Drawing


def expected_area(terrain: Terrain, drawing: Drawing, min_size: float) -> Optional[np.ndarray]:
    """(H, W) bool: what the border will probably restrict or run through; None if that cannot be told yet.

    While the seed is shown: the seed's side. Before: the line and what it encloses together with the straight line
    between its ends, since a polygon that is half drawn looks like a curve.

    Args:
        min_size: [m] a line that extends over less is none yet.
    """
    if drawing.seeding:
        side = terrain.side_of(drawing.spot, drawing.chain, drawing.closed)
        if side is not None:
            return side
    chain = np.asarray(drawing.chain, dtype=float).reshape(-1, 2)
    if len(chain) < 2 or float(np.ptp(chain, axis=0).max()) < min_size:
        return None
    canvas = np.zeros(terrain.grid.shape, dtype=np.uint8)
    pixels = np.rint(terrain.grid.world_to_grid(chain)).astype(np.int32)
    if drawing.ordered:
        cv2.polylines(canvas, [pixels.reshape(-1, 1, 2)], drawing.closed, 1)
        cv2.fillPoly(canvas, [pixels.reshape(-1, 1, 2)], 1)
    else:
        inside = terrain.grid.contains_cells(pixels[:, ::-1])
        canvas[pixels[inside, 1], pixels[inside, 0]] = 1
    return canvas.astype(bool) if canvas.any() else None


class KeepOut:
    """Judges ways by an area (H, W) bool that the robot's footprint is not to come to."""

    def __init__(self, terrain: Terrain, area: np.ndarray) -> None:
        self._grid = terrain.grid
        self._params = terrain.params
        self._area = area
        self._gap = clearance_grid(area, terrain.grid.resolution, edge=False)
        # along an edge the cells make the gap tremble
        self._tremble = 1.5 * terrain.grid.resolution
        self._needed = terrain.params.robot_radius + terrain.params.travel_margin + self._tremble

    def near_ways(self, start, places: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        """(N,) bool: to which places (N, 2) [m] a way round the area is not notably longer than the shortest one.

        A first sieve for many places. Where the shortest way leads through the area, navigation would take it.

        Args:
            start: (2,) [m]; from within the area any place will do.
            lengths: (N,) [m] of the shortest ways.
        """
        if sample(self._grid, self._gap, np.array([start]), outside=np.inf)[0] < self._needed:
            return np.ones(len(places), dtype=bool)
        data = self._grid.data.copy()
        data[self._area] = 100
        around = Terrain(self._grid.with_data(data), self._params).ways(start).lengths_to(places)
        return around <= 1.1 * lengths + 0.2

    def allows(self, route: Optional[np.ndarray]) -> bool:
        """Whether a way (N, 2) [m] keeps off the area.

        A robot that is too near or inside already may leave, but nowhere come nearer again. No way is not allowed.
        """
        if route is None or not len(route):
            return False
        gaps = np.minimum(sample(self._grid, self._gap, route, outside=np.inf), self._needed)
        return bool((gaps >= np.maximum.accumulate(gaps) - self._tremble).all())
