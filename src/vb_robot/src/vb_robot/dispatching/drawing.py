"""Derives from a drawing what a robot should look at, and which floor the border will probably restrict.

The idea: a robot does not look at the spot but at where the ceiling cameras will lose it, before they do; and since
navigation does not know a border before it is saved, its paths avoid what the border will probably restrict.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Optional

import cv2
import numpy as np

from vb_core.grid_layers import clearance_grid, nearest_cell, sample
from vb_core.grid_map import GridMap, distance_to
from vb_robot.clearance_map import TRAVEL_MARGIN, ClearanceMap

STEP = 0.05  # [m] between places of an extrapolated line
HORIZON = 2.0  # [m] how far the line is extrapolated to where no stationary camera sees it
# Beyond the edge of what they see people notice that nobody sees the spot, and hold still. A quick hand is farther by
# then: the robot looks at the middle of the stretch that it may have come, as long as both ends are in view.
MIN_LOOKAHEAD, REACTION, HALF_VIEW = 0.3, 1.2, 0.6  # [m] at least, [s] until the hand rests, [m] at most
NEARBY = 1.0  # [m] unseen floor counts this near to the spot on any side
MIN_GAP = 0.15  # [m] narrower shadows, as of a table's leg, do not count
MIN_LINE = 0.3  # [m] a shorter line does not count yet
NO_POINTS = np.zeros((0, 2))


@dataclass(frozen=True)
class DrawingState:
    """The drawing so far, map frame.

    Attributes:
        spot: (2,) [m] where the spot is, or was last; None: not known.
        chain: (M, 2) [m] what has been drawn.
        velocity: (2,) [m/s] how the spot moves, or None.
        closed: whether the chain is a polygon.
        seeding: the spot marks the side to be restricted: stay off that side.
        ordered: whether the chain's points are in the order of the line.
        seen_by_stationary: a stationary camera sees the spot, so a robot need not take risks.
        focus: (2,) [m] what the robot should look at. None: the spot.
        stretch: (K, 2) [m] what it should see if it can: where the line probably goes on while no stationary camera
            sees it. It leads past the focus; the part up to there must be seen.
        searched_length: [m] of the stretch that a robot has looked at in vain: the spot is farther on, or hidden
            from there.
    """

    spot: Optional[np.ndarray] = None
    chain: np.ndarray = field(default_factory=lambda: NO_POINTS)
    velocity: Optional[np.ndarray] = None
    closed: bool = False
    seeding: bool = False
    ordered: bool = True
    seen_by_stationary: bool = False
    focus: Optional[np.ndarray] = None
    stretch: np.ndarray = field(default_factory=lambda: NO_POINTS)
    searched_length: float = 0.0

    @property
    def direction(self) -> Optional[np.ndarray]:
        """Unit vector (2,) along which the spot moves, or None."""
        return None if self.velocity is None else self.velocity / np.linalg.norm(self.velocity)

    @property
    def look_at(self) -> np.ndarray:
        """The place (2,) [m] that the robot should look at."""
        return self.spot if self.focus is None else self.focus

    @property
    def required_points(self) -> np.ndarray:
        """The places (K, 2) [m] that a viewpoint must show; a spot that no stationary camera sees is among them."""
        wanted = [self.look_at, *self.stretch[:1]]
        if self.searched_length > 0.0:
            return np.array(wanted[:1])
        return np.array(wanted if self.seen_by_stationary else [*wanted, self.spot])

    def line_ahead(self, length: float) -> np.ndarray:
        """Extrapolates the line, (K, 2) [m], as far as what is looked at; the spot alone if it does not move."""
        if self.direction is None:
            return np.array([self.spot])
        if self.focus is not None:
            length = max(length, float(np.dot(self.look_at - self.spot, self.direction)))
        return self.spot + np.linspace(0.0, length, 6)[:, None] * self.direction

    def with_target(self, clearance_map: ClearanceMap, unseen: Optional["UnseenFloor"]) -> "DrawingState":
        """Returns the same with what a robot is to look at.

        While stationary cameras see the spot: the stretch on which they will lose it if it goes straight on, or else
        the floor beside it that they do not see. When they do not: from where it was seen last on, and
        where that has been searched in vain, the end of what has been.
        """
        if self.seeding:
            return self
        spot, stretch = self.spot, NO_POINTS
        if self.direction is not None and (unseen is not None or not self.seen_by_stationary):
            # straight on, but not into a wall
            room = float(np.linalg.norm(clearance_map.ray_end(spot, self.direction) - spot)) - 0.05
            stretch = spot + np.arange(0.0, min(HORIZON, max(0.0, room)) + 1e-9, STEP)[:, None] * self.direction
            if self.seen_by_stationary and unseen is not None:
                stretch = unseen.first_unseen_part(stretch)
        elif not self.seen_by_stationary:
            stretch = spot[None]
        if len(stretch):
            speed = float(np.linalg.norm(self.velocity)) if self.velocity is not None else 0.0
            ahead = max(MIN_LOOKAHEAD, min(0.5 * REACTION * speed, HALF_VIEW), self.searched_length)
            ahead = min(int(round(ahead / STEP)), len(stretch) - 1)
            return replace(self, focus=stretch[ahead], stretch=stretch)
        place = unseen.nearest(spot) if self.seen_by_stationary and unseen is not None else None
        return self if place is None else replace(self, focus=place)

    def expected_area(self, clearance_map: ClearanceMap) -> Optional[np.ndarray]:
        """Predicts (H, W) bool what the border will restrict or run through; None if that cannot be told yet.

        The line, and while the seed is shown, the seed's side; before, what the line encloses together with the straight
        line between its ends, since a polygon that is half drawn looks like a curve.
        """
        side = clearance_map.side_of(self.spot, self.chain, self.closed) if self.seeding else None
        chain = np.asarray(self.chain, dtype=float).reshape(-1, 2)
        if side is None and (len(chain) < 2 or float(np.ptp(chain, axis=0).max()) < MIN_LINE):
            return None
        canvas = np.zeros(clearance_map.grid.shape, dtype=np.uint8)
        pixels = np.rint(clearance_map.grid.world_to_grid(chain)).astype(np.int32)
        if self.ordered or side is not None:
            cv2.polylines(canvas, [pixels.reshape(-1, 1, 2)], self.closed, 1)
        if side is not None:
            canvas[side] = 1
        elif self.ordered:
            cv2.fillPoly(canvas, [pixels.reshape(-1, 1, 2)], 1)
        else:
            inside = clearance_map.grid.contains_cells(pixels[:, ::-1])
            canvas[pixels[inside, 1], pixels[inside, 0]] = 1
        return canvas.astype(bool) if canvas.any() else None


class UnseenFloor:
    """Floor that no stationary camera sees, without narrow shadows.

    Args:
        coverage: how many cameras see each cell; 0: none; -1: no floor. See camera_coverage_node.
    """

    def __init__(self, coverage: GridMap) -> None:
        self._grid = coverage
        core = distance_to(coverage.data != 0) * coverage.resolution >= 0.5 * MIN_GAP
        # what was taken off the edges of the wide parts is given back
        self.mask = (coverage.data == 0) & (distance_to(core) * coverage.resolution <= 0.5 * MIN_GAP)

    def at(self, points: np.ndarray) -> np.ndarray:
        """Returns (N,) bool: which points (N, 2) [m] no stationary camera sees."""
        return sample(self._grid, self.mask, points) > 0

    def nearest(self, point: np.ndarray) -> Optional[np.ndarray]:
        """Finds the nearest place (2,) [m] that no stationary camera sees, not farther than NEARBY."""
        cell, center = nearest_cell(self._grid, self.mask, point, NEARBY)
        return None if cell is None else center

    def first_unseen_part(self, line: np.ndarray) -> np.ndarray:
        """Returns the first part (K, 2) [m] of a line (N, 2) that no stationary camera sees; empty if they see all of it."""
        hidden = self.at(line)
        if not hidden.any():
            return NO_POINTS
        begin = int(np.argmax(hidden))
        seen_again = np.flatnonzero(~hidden[begin:])
        return line[begin : begin + int(seen_again[0])] if len(seen_again) else line[begin:]


class KeepOutArea:
    """Judges paths by an area (H, W) bool that the robot's footprint must not touch."""

    def __init__(self, clearance_map: ClearanceMap, area: np.ndarray) -> None:
        self._grid = clearance_map.grid
        self._gap = clearance_grid(area, clearance_map.grid.resolution, edge=False)
        # along an edge the cells make the gap tremble
        self._tremble = 1.5 * clearance_map.grid.resolution
        self._needed = clearance_map.radius + TRAVEL_MARGIN + self._tremble

    def allows_ends(self, places: np.ndarray) -> np.ndarray:
        """Returns (N,) bool: at which places (N, 2) [m] a path may end: near the area the border would lock the robot in."""
        return self._gaps(places) >= self._needed

    def allows(self, route: Optional[np.ndarray]) -> bool:
        """Returns whether a path (N, 2) [m] keeps off the area; None does not.

        A robot that is too near or inside already may leave, but nowhere come nearer again.
        """
        if route is None or not len(route):
            return False
        gaps = np.minimum(self._gaps(route), self._needed)
        nowhere_nearer = (gaps >= np.maximum.accumulate(gaps) - self._tremble).all()
        return bool(nowhere_nearer and gaps[-1] >= self._needed - self._tremble)

    def _gaps(self, points: np.ndarray) -> np.ndarray:
        return sample(self._grid, self._gap, points, outside=np.inf)
