"""The virtual border V = (P, s, delta) of the paper, Sect. 3, and the error that refuses one.

All code that draws, stores, checks or shows borders passes them on in this form.

>>> border = VirtualBorder(points=[(1.0, 1.0), (2.0, 1.0), (2.0, 2.0), (1.0, 2.0)], seed=(1.5, 1.5), closed=True)
>>> border.zone.name, border.enabled, border.points.shape
('keep_out', True, (4, 2))
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Optional, Tuple

import numpy as np

from vb_core import geometry
from vb_core.errors import CodedError
from vb_core.notices import Notice, Severity
from vb_core.zones import KEEP_OUT, ZONES, Zone
from vb_map_integration.places.transform import Transform

# more than a person draws: over three minutes without a pause, at 25 spots a second
MAX_POINTS = 5000
# a chain counts as closed if the gap between its ends is at most this share of its length
CLOSING_SHARE = 0.15
# [m] no floor is farther from the origin: larger values come from a fault
MAX_COORDINATE = 1e6

MAX_NAME = 200  # characters
# [m/s] the highest value that a cell of the speed limit map can hold: 127 cm/s
MAX_SPEED = 1.27


def warning(code: str, **values: Any) -> Notice:
    """Makes a warning: a border with this issue can still be added."""
    return Notice.from_error(CodedError(code, **values), Severity.WARNING)


class IntegrationError(CodedError):
    """Raised when a border is refused. Nothing was changed.

    Attributes:
        warnings: the warnings found before the error.
    """

    warnings: Tuple[Notice, ...] = ()


@dataclass(frozen=True, eq=False)
class VirtualBorder:
    """A virtual border.

    Attributes:
        points: (N, 2) float64 [m], map frame; P, the polygonal chain; if closed, the first point is not repeated.
        seed: (2,) float64 [m], map frame; s, a point on the side to be restricted.
        occupancy: delta, 0 .. 1; above .005 in a zone that is marked in the map, below 1 in a soft zone.
        closed: polygon (True) or separating curve (False); None decides by the gap between the chain's ends.
        id, name: what the store, and what people, call it by.
        enabled: the user's switch.
        created, modified: [s] ROS time.
        robots: names of the robots that it applies to; empty: all.
        wall: a virtual wall: the open chain itself may not be crossed, both sides stay usable, the seed is not used.
        zone: what the area means for robots (vb_core.zones); may be given by its name.
        max_speed: [m/s] in a zone that limits it; 0 elsewhere.
        map_id: fingerprint of the map on which a person accepted it; "" until then.

    Raises:
        IntegrationError: "bad_points", "too_few_points", "too_many_points", "bad_seed", "bad_occupancy",
            "bad_time", "bad_name", "bad_zone", "bad_speed".
    """

    points: np.ndarray
    seed: np.ndarray
    occupancy: float = 1.0
    closed: Optional[bool] = None
    id: str = ""
    name: str = ""
    enabled: bool = True
    created: float = 0.0
    modified: float = 0.0
    robots: Tuple[str, ...] = ()
    wall: bool = False
    zone: Zone = KEEP_OUT
    max_speed: float = 0.0
    map_id: str = ""

    def __post_init__(self) -> None:
        points = _coordinates(self.points, "bad_points")
        if len(points) > MAX_POINTS:
            raise IntegrationError("too_many_points", most=MAX_POINTS)
        if len(points) > 1:
            points = points[np.concatenate([[True], (np.diff(points, axis=0) != 0.0).any(axis=1)])]
        closed = False if self.wall else self.closed
        if closed is None:
            closed = _looks_closed(points)
        if closed and len(points) > 1 and (points[0] == points[-1]).all():
            points = points[:-1]
        least = 3 if closed else 2
        if len(points) < least:
            raise IntegrationError("too_few_points", least=least, count=len(points))
        seed = _coordinates(points[0] if self.wall else self.seed, "bad_seed")
        if len(seed) != 1:
            raise IntegrationError("bad_seed")
        occupancy = _number(self.occupancy, "bad_occupancy")
        if not 0.0 <= occupancy <= 1.0:
            raise IntegrationError("bad_occupancy")
        zone = self.zone if isinstance(self.zone, Zone) else ZONES.get(str(self.zone))
        if zone is None:
            raise IntegrationError("bad_zone", zone=self.zone, known=", ".join(ZONES))
        if (zone.soft and occupancy >= 1.0) or (zone.restricts and zone.value(occupancy) == 0):
            raise IntegrationError("bad_occupancy")
        speed = _number(self.max_speed, "bad_speed", speed=self.max_speed)
        slow = zone.limits_speed
        if not 0.0 <= speed <= MAX_SPEED or slow != (speed > 0.0) or (slow and self.wall):
            raise IntegrationError("bad_speed", speed=speed)
        for key in ("created", "modified"):
            value = _number(getattr(self, key), "bad_time", key=key)
            if value < 0.0:
                raise IntegrationError("bad_time", key=key)
            object.__setattr__(self, key, value)
        for key in ("id", "name"):
            text = getattr(self, key)
            if not isinstance(text, str) or len(text) > MAX_NAME or not (text.isprintable() or not text):
                raise IntegrationError("bad_name", key=key)
        points.setflags(write=False)
        seed.setflags(write=False)
        robots = (self.robots,) if isinstance(self.robots, str) else self.robots
        checked = {"points": points, "seed": seed[0], "occupancy": occupancy, "zone": zone, "max_speed": speed}
        checked.update(closed=bool(closed), enabled=bool(self.enabled), wall=bool(self.wall))
        checked.update(robots=tuple(str(robot) for robot in robots if str(robot)))
        for key, value in checked.items():
            object.__setattr__(self, key, value)

    def replace(self, **changes: object) -> "VirtualBorder":
        """Returns a copy with some fields replaced, validated again."""
        return dataclasses.replace(self, **changes)

    @property
    def value(self) -> int:
        """delta as an occupancy value of the map, 0 .. 100."""
        return self.zone.value(self.occupancy)

    def moved(self, transform: Transform) -> "VirtualBorder":
        """Moves the border into the frame of another map."""
        if not any(transform):
            return self
        return self.replace(points=transform.apply(self.points), seed=transform.apply(self.seed)[0])

    def same_area(self, other: "VirtualBorder") -> bool:
        """Returns whether both borders restrict the same cells on any map, whatever their occupancy."""
        return (
            self.closed == other.closed
            and self.wall == other.wall
            and np.array_equal(self.points, other.points)
            and np.array_equal(self.seed, other.seed)
        )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, VirtualBorder):
            return NotImplemented
        plain = [field.name for field in dataclasses.fields(self) if field.name not in ("points", "seed")]
        return self.same_area(other) and all(getattr(self, key) == getattr(other, key) for key in plain)

    __hash__ = None  # type: ignore[assignment]


def _coordinates(values: object, code: str) -> np.ndarray:
    """Copies coordinates to (N, 2) float64, all finite; raises IntegrationError with a code if it cannot."""
    try:
        points = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise IntegrationError(code) from None
    if points.size == 0:
        points = points.reshape(0, 2)
    elif points.ndim == 1:
        points = points.reshape(1, -1)
    # nan compares as false
    if points.ndim != 2 or points.shape[1] != 2 or not (np.abs(points) <= MAX_COORDINATE).all():
        raise IntegrationError(code)
    return points


def _number(value: object, code: str, **values: object) -> float:
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise IntegrationError(code, **values)
    return number


def _looks_closed(points: np.ndarray) -> bool:
    if len(points) < 3:
        return False
    gap = float(np.linalg.norm(points[-1] - points[0]))
    return gap <= CLOSING_SHARE * geometry.chain_length(points)
