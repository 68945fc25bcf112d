"""Derives from a drawing the point that a robot should look at, and the area that the border will probably restrict.

A robot looks a little ahead of the spot, where the line continues, so that it arrives before ceiling cameras lose the
spot; and it keeps out of the area that the border will probably restrict.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Optional

import cv2
import numpy as np
from shapely.geometry import Polygon

from vb_robot.clearance_map import ClearanceMap

STEP = 0.05  # [m] between points of an extrapolated line
# A quick hand has moved on when a robot arrives. So the robot looks at the middle of the hand's probable path until
# then, as long as the spot stays in view too.
MIN_LOOKAHEAD, REACTION, MAX_LOOKAHEAD = 0.3, 1.2, 0.6  # [m] at least, [s] of the hand's motion, [m] at most
LINE_AHEAD = 0.8  # [m] extrapolated part of the line, which a robot should also see, and keeps off
MIN_LINE = 0.3  # [m] a shorter line does not enclose an area yet
NO_POINTS = np.zeros((0, 2))


@dataclass(frozen=True)
class DrawingState:
    """The drawing so far, map frame.

    Attributes:
        spot: (2,) [m] the spot's present or last known position; None if not known.
        chain: (M, 2) [m] the drawn line.
        velocity: (2,) [m/s] of the spot, or None.
        closed: whether the chain is a polygon.
        seeding: whether the spot now marks the side to be restricted, which robots must leave.
        seen_by_stationary: whether a stationary camera sees the spot, so that no robot has to.
        seed: (2,) [m] the seed with which the border would be saved now, or None.
    """

    spot: Optional[np.ndarray] = None
    chain: np.ndarray = field(default_factory=lambda: NO_POINTS)
    velocity: Optional[np.ndarray] = None
    closed: bool = False
    seeding: bool = False
    seen_by_stationary: bool = False
    seed: Optional[np.ndarray] = None

    def inside(self) -> Optional[np.ndarray]:
        """Returns a point (2,) [m] inside a closed line, near its centre; None if the line is open."""
        if not self.closed or len(self.chain) < 3:
            return None
        return np.array(Polygon(self.chain).representative_point().coords[0])

    def line_ahead(self, clearance_map: ClearanceMap) -> np.ndarray:
        """Extrapolates the line from the spot up to the next wall, (K, 2) [m]; only the spot if it does not move."""
        if self.velocity is None or self.seeding:
            return np.array([self.spot])
        free_length = float(np.linalg.norm(clearance_map.ray_end(self.spot, self.velocity) - self.spot)) - STEP
        distances = np.arange(0.0, min(LINE_AHEAD, max(0.0, free_length)) + 1e-9, STEP)
        return self.spot + distances[:, None] * self.velocity / np.linalg.norm(self.velocity)

    def look_at(self, ahead: np.ndarray) -> np.ndarray:
        """Returns the point (2,) [m] of the extrapolated line (K, 2) [m] that a robot should look at."""
        speed = float(np.linalg.norm(self.velocity)) if self.velocity is not None else 0.0
        lookahead = min(max(0.5 * REACTION * speed, MIN_LOOKAHEAD), MAX_LOOKAHEAD)
        return ahead[min(int(round(lookahead / STEP)), len(ahead) - 1)]

    def expected_area(self, clearance_map: ClearanceMap) -> Optional[np.ndarray]:
        """Predicts which cells (H, W) bool the border will restrict; None if that is not predictable yet.

        While the person shows the seed, these are the seed's side; before, the area between the line and the straight
        line that joins its ends, since a half-drawn polygon looks like a curve.
        """
        if self.seeding:
            return clearance_map.side_of(self.spot, self.chain, self.closed)
        if len(self.chain) < 2 or float(np.ptp(self.chain, axis=0).max()) < MIN_LINE:
            return None
        area = np.zeros(clearance_map.grid.shape, dtype=np.uint8)
        cv2.fillPoly(area, [np.rint(clearance_map.grid.world_to_grid(self.chain)).astype(np.int32)[:, None]], 1)
        return area.astype(bool)
