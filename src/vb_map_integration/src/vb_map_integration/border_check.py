"""What a border would do: the check before it is added, changed or previewed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Mapping, Optional, Sequence, Tuple

from vb_core.errors import CodedError
from vb_core.parameters import Parameters, param
from vb_map_integration.border import VirtualBorder
from vb_map_integration.borders.issues import WARNING, IntegrationError, Issue, make_issue
from vb_map_integration.grid.layered_map import LayeredMap, Region
from vb_map_integration.grid.reachability import Reachability, check_reachability
from vb_map_integration.integration import Area, restricted_area


@dataclass(frozen=True)
class IntegratorParams(Parameters):
    """The map integrator's parameters."""

    robot_radius: float = param(0.18, "m", low=0.0)
    check_reachability: bool = param(True)
    dock: list = param([], "m")
    robot_name: str = param("")
    robots: list = param([])
    map_name: str = param("")

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.dock) not in (0, 2):
            raise CodedError("bad_parameter", f"dock: expected x and y or nothing, got {self.dock!r}")


@dataclass(frozen=True)
class CheckResult:
    """Effect that adding or changing a border would have.

    Attributes:
        area: what it would restrict.
        issues: warnings, the integration's first.
        reachability: parts of the free space and goals out of reach; None if not requested.
        layered_map: the map with it.
    """

    area: Area
    issues: Tuple[Issue, ...]
    reachability: Optional[Reachability]
    layered_map: LayeredMap


class BorderCheck:
    """Checks borders on maps; what it computed for the last maps is kept.

    Args:
        params: of the integrator.
    """

    def __init__(self, params: IntegratorParams) -> None:
        self._params = params
        # parts of the free space of a map, and of the map with what was checked last
        self._parts: List[Tuple[LayeredMap, int]] = []

    def __call__(
        self,
        before: LayeredMap,
        border: VirtualBorder,
        places: Optional[Mapping[str, Sequence[float]]] = None,
        goals: Optional[Sequence[Sequence[float]]] = None,
    ) -> CheckResult:
        """Checks what a border would do on a map.

        Args:
            before: the map and its borders; one of the same id is replaced.
            places: positions [m] by name ("robot"); being inside is a warning.
            goals: (N, 2) [m], places whose reachability is checked.

        Raises:
            IntegrationError: with all issues.
        """
        check_robots(border, self._params)
        places = dict(places or {})
        if self._params.dock:
            places["dock"] = self._params.dock
        area = restricted_area(before.physical, border, places)
        after = before.with_regions({border.id: Region.of(area) if border.zone.restricts else None})
        issues = list(area.issues)
        found: Optional[Reachability] = None
        if goals is not None or self._params.check_reachability:
            parts = self._count_parts(before, places)
            found = self._reach(after, places, () if goals is None else goals)
            self._parts = [(before, parts), (after, found.free_parts)]
            if found.free_parts > parts:
                issues.append(make_issue(WARNING, "splits_free_space"))
            if found.free_parts == 0 and parts > 0:
                issues.append(make_issue(WARNING, "no_free_space_left"))
        return CheckResult(area, tuple(issues), found, after)

    def _count_parts(self, layered: LayeredMap, places: Mapping[str, Sequence[float]]) -> int:
        known = [parts for one, parts in self._parts if one is layered]
        return known[0] if known else self._reach(layered, places, ()).free_parts

    def _reach(self, layered: LayeredMap, places: Mapping[str, Sequence[float]], goals: Sequence) -> Reachability:
        return check_reachability(
            layered.map_with_borders, goals, robot=places.get("robot"), radius=self._params.robot_radius
        )


def check_robots(border: VirtualBorder, params: IntegratorParams) -> None:
    """Refuses a border for robots that are not known, if any are; raises IntegrationError "unknown_robot"."""
    known = params.robots
    unknown = [robot for robot in border.robots if known and robot not in known]
    if unknown:
        raise IntegrationError("unknown_robot", robot=", ".join(unknown), known=", ".join(map(str, known)))
