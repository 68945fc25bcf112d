"""Derives from a drawing what a robot should look at, and which floor the border will probably restrict.

A robot looks a little ahead of the spot, to where the line continues, so that it is there before ceiling cameras lose
the spot; and it goes nowhere that the border will probably restrict.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Optional

import cv2
import numpy as np
from shapely.geometry import Polygon

from vb_robot.clearance_map import ClearanceMap

STEP = 0.05  # [m] between points of an extrapolated line
# A quick hand has moved on by the time a robot arrives: the robot looks at the middle of the way that the hand may have
# gone until then, as long as the spot stays in view too.
MIN_LOOKAHEAD, REACTION, MAX_LOOKAHEAD = 0.3, 1.2, 0.6  # [m] at least, [s] of the hand's motion, [m] at most
LINE_AHEAD = 0.8  # [m] how far the line is extrapolated: a robot should see this part too, and keeps off it
MIN_LINE = 0.3  # [m] a shorter line encloses nothing yet
NO_POINTS = np.zeros((0, 2))


@dataclass(frozen=True)
class DrawingState:
    """The drawing so far, map frame.

    Attributes:
        spot: (2,) [m] where the spot is, or was last; None: not known.
        chain: (M, 2) [m] what has been drawn.
        velocity: (2,) [m/s] how the spot moves, or None.
        closed: whether the chain is a polygon.
        seeding: the spot marks the side to be restricted, from which robots keep off.
        seen_by_stationary: a stationary camera sees the spot, so a robot need not.
        seed: (2,) [m] the one that the border would be saved with now, or None.
    """

    spot: Optional[np.ndarray] = None
    chain: np.ndarray = field(default_factory=lambda: NO_POINTS)
    velocity: Optional[np.ndarray] = None
    closed: bool = False
    seeding: bool = False
    seen_by_stationary: bool = False
    seed: Optional[np.ndarray] = None

    def inside(self) -> Optional[np.ndarray]:
        """Returns a point (2,) [m] within a closed line, near its middle; None if the line is open."""
        if not self.closed or len(self.chain) < 3:
            return None
        return np.array(Polygon(self.chain).representative_point().coords[0])

    def line_ahead(self, clearance_map: ClearanceMap) -> np.ndarray:
        """Extrapolates the line from the spot, (K, 2) [m], up to a wall at most; the spot alone if it does not move."""
        if self.velocity is None or self.seeding:
            return np.array([self.spot])
        room = float(np.linalg.norm(clearance_map.ray_end(self.spot, self.velocity) - self.spot)) - STEP
        lengths = np.arange(0.0, min(LINE_AHEAD, max(0.0, room)) + 1e-9, STEP)
        return self.spot + lengths[:, None] * self.velocity / np.linalg.norm(self.velocity)

    def look_at(self, ahead: np.ndarray) -> np.ndarray:
        """Returns the point (2,) [m] of the line ahead (K, 2) [m] that a robot should look at."""
        speed = float(np.linalg.norm(self.velocity)) if self.velocity is not None else 0.0
        length = min(max(0.5 * REACTION * speed, MIN_LOOKAHEAD), MAX_LOOKAHEAD)
        return ahead[min(int(round(length / STEP)), len(ahead) - 1)]

    def expected_area(self, clearance_map: ClearanceMap) -> Optional[np.ndarray]:
        """Predicts which cells (H, W) bool the border will restrict; None if it is too early to tell.

        While the seed is shown, the seed's side; before that, the area between the line and the straight line joining
        its ends, since a half-drawn polygon looks like a curve.
        """
        if self.seeding:
            return clearance_map.side_of(self.spot, self.chain, self.closed)
        if len(self.chain) < 2 or float(np.ptp(self.chain, axis=0).max()) < MIN_LINE:
            return None
        canvas = np.zeros(clearance_map.grid.shape, dtype=np.uint8)
        cv2.fillPoly(canvas, [np.rint(clearance_map.grid.world_to_grid(self.chain)).astype(np.int32)[:, None]], 1)
        return canvas.astype(bool)
