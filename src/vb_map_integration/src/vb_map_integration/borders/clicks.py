"""Clicks on the map that become a border: the chain's points, its end, the seed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Optional, Sequence

import numpy as np

from vb_core.errors import CodedError
from vb_core.parameters import Parameters, param
from vb_map_integration.border import MAX_COORDINATE, MAX_POINTS, VirtualBorder


@dataclass(frozen=True)
class ClickParams(Parameters):
    """Parameters of clicks."""

    closing_distance: float = param(0.15, "m", above=0.0)
    occupancy: float = param(1.0, low=0.0, high=1.0)


class Clicks:
    """Collects clicks.

    Each click is the chain's next point. A click on the first point, once there are three, closes a polygon; a click
    on the last point, once there are two, ends a separating curve. The click after that is the seed.

    Attributes:
        points: [m] of the chain so far.
        closed: None while the chain grows; then polygon (True) or separating curve (False).
    """

    def __init__(self, params: Optional[ClickParams] = None) -> None:
        self._params = params or ClickParams()
        self.points: List[np.ndarray] = []
        self.closed: Optional[bool] = None

    def click(self, point: Sequence[float]) -> Optional[VirtualBorder]:
        """Adds a click at (x, y) [m]; returns the border if it was the seed.

        The clicks are kept until `cancel`: if the border is refused, the next click is another seed.

        Raises:
            CodedError: "bad_points" for an invalid point, "too_many_points", or what `VirtualBorder` raises.
        """
        place = np.array(point, dtype=float)
        if place.shape != (2,) or not np.isfinite(place).all() or np.abs(place).max() > MAX_COORDINATE:
            raise CodedError("bad_points")
        if self.closed is not None:
            return VirtualBorder(np.array(self.points), place, self._params.occupancy, self.closed)
        count = len(self.points)
        to_first, to_last = (
            float(np.linalg.norm(place - self.points[index])) if self.points else np.inf for index in (0, -1)
        )
        if count >= 3 and to_first <= min(self._params.closing_distance, to_last):
            self.end(closed=True)
        elif to_last <= self._params.closing_distance:
            if count >= 2:
                self.end(closed=False)
        elif count >= MAX_POINTS:
            raise CodedError("too_many_points", most=MAX_POINTS)
        else:
            self.points.append(place)
        return None

    def end(self, closed: bool) -> None:
        """Ends the chain; the next click is the seed.

        Raises:
            CodedError: "too_few_points"; the chain goes on.
        """
        # a seed anywhere: only the chain is in question
        VirtualBorder(np.array(self.points).reshape(-1, 2), (0.0, 0.0), closed=closed)
        self.closed = closed

    def remove_last(self) -> None:
        """Undoes the chain's end, or else its last point.

        Raises:
            CodedError: "no_point_to_remove".
        """
        if self.closed is not None:
            self.closed = None
        elif self.points:
            self.points.pop()
        else:
            raise CodedError("no_point_to_remove")

    def cancel(self) -> None:
        """Forgets everything."""
        self.points, self.closed = [], None

    def describe(self) -> str:
        """Returns a sentence that says what the next click does."""
        if self.closed is not None:
            return "click a point on the side that is to be restricted"
        if not self.points:
            return "click the first point of a border"
        more = ["click the next point"]
        if len(self.points) >= 2:
            more.append("the last one again to end a separating curve")
        if len(self.points) >= 3:
            more.append("the first one to close a polygon")
        return f"{len(self.points)} point(s): " + ", ".join(more)
