"""What a border would do: the check before it is added, changed or previewed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Sequence, Tuple

from vb_core.notices import Notice
from vb_map_integration.border import VirtualBorder
from vb_map_integration.borders.issues import warning
from vb_map_integration.grid.free_parts import count_free_parts
from vb_map_integration.grid.layered_map import LayeredMap
from vb_map_integration.integration import Area, restricted_area


@dataclass(frozen=True)
class CheckResult:
    """Effect that adding or changing a border would have.

    Attributes:
        area: what it would restrict.
        issues: warnings, the integration's first.
        free_parts: number of parts of the free space, see `count_free_parts`.
        layered_map: the map with it.
    """

    area: Area
    issues: Tuple[Notice, ...]
    free_parts: int
    layered_map: LayeredMap


class BorderCheck:
    """Checks borders on maps; what it computed for the last maps is kept.

    Args:
        robot_radius: [m] for what a robot can reach.
    """

    def __init__(self, robot_radius: float) -> None:
        self._radius = robot_radius
        # parts of the free space of a map, and of the map with what was checked last
        self._parts: List[Tuple[LayeredMap, int]] = []

    def __call__(
        self, before: LayeredMap, border: VirtualBorder, robots: Sequence[Sequence[float]] = ()
    ) -> CheckResult:
        """Checks what a border would do on a map.

        Args:
            before: the map and its borders; one of the same id is replaced.
            robots: as of `restricted_area`.

        Raises:
            IntegrationError: with what was found before.
        """
        area = restricted_area(before.physical, border, robots)
        after = before.with_regions({border.id: area if border.zone.restricts else None})
        issues = list(area.issues)
        parts, left = self._count(before), self._count(after)
        self._parts = [(before, parts), (after, left)]
        if left > parts:
            issues.append(warning("splits_free_space"))
        if left == 0 and parts > 0:
            issues.append(warning("no_free_space_left"))
        return CheckResult(area, tuple(issues), left, after)

    def _count(self, layered: LayeredMap) -> int:
        known = [parts for one, parts in self._parts if one is layered]
        return known[0] if known else count_free_parts(layered.map_with_borders, self._radius)
