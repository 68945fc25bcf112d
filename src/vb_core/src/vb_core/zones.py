"""What the area of a border means for robots: one table of zones.

Code that reads, checks, integrates, offers or shows a border asks its zone, and seldom needs to know which zones there are.
vb_msgs/VirtualBorder repeats the names and numbers, and a test compares them. The words for people are in
languages/<language>/zones.yaml: page_zone_<name>, border_unkept_<name>.

>>> AVOID.value(0.75), SLOW.value(1.0), SLOW.limits_speed
(75, 0, True)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Callable, Dict, List


@dataclass(frozen=True)
class Zone:
    """A kind of zone.

    Attributes:
        number: the zone's number in vb_msgs/VirtualBorder.
        is_respected_by: returns whether a robot, a localised vb_core.capabilities.ConnectedRobot, keeps its rule.
        restricts: whether its area is marked in the map with borders.
        soft: whether robots may go there if the detour is long: delta is below 1.
        limits_speed: whether it has a speed limit.
        occupancy: delta of its borders, unless a border sets another one.
    """

    name: str
    number: int
    is_respected_by: Callable[[Any], bool]
    restricts: bool = True
    soft: bool = False
    limits_speed: bool = False
    occupancy: float = 1.0

    def value(self, occupancy: float) -> int:
        """Returns delta as an occupancy value of the map, 0 .. 100, or 0 if the zone does not change the map."""
        return int(round(100.0 * occupancy)) if self.restricts else 0


KEEP_OUT, AVOID, SLOW = _ZONES = (
    Zone("keep_out", 0, lambda robot: robot.accepts_goals or robot.has_driver),
    # robots take a cheap detour, and cross the area if it is the only path
    Zone("avoid", 1, lambda robot: robot.accepts_goals, soft=True, occupancy=0.75),
    Zone(
        "slow",
        2,
        lambda robot: robot.has_driver or (robot.has_navigation and robot.obeys_speed),
        restricts=False,
        limits_speed=True,
    ),
)
ZONES: Dict[str, Zone] = {zone.name: zone for zone in _ZONES}


def zone_by_number(number: int) -> Zone:
    """Returns the zone with a number of vb_msgs/VirtualBorder. Robots keep out of an unknown zone."""
    return next((zone for zone in _ZONES if zone.number == number), KEEP_OUT)


def table() -> List[Dict[str, Any]]:
    """Returns what the page must know about each zone, the usual zone first, as plain values."""
    return [{"name": zone.name, "limits_speed": zone.limits_speed} for zone in _ZONES]
