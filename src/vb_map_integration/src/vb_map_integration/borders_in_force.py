"""What is in force on a map: the map with borders, a verdict for each border, and notices about them.

A border is identified by the floor that it closes off as well as by its line. On the map on which a person accepted it,
it is in force as drawn. On any other map it counts as the same if the walls round it are where they should be and it
closes off the same floor; else it waits for a person. Meanwhile, to be safe, it restricts what it closed off before,
what it closes off now unless that is much more, and its second possible position; nothing if none is on the map.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from functools import cached_property
from typing import Callable, Dict, Iterable, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from vb_core.grid_map import GridMap
from vb_core.notices import Notice, Severity
from vb_map_integration.border import IntegrationError, VirtualBorder
from vb_map_integration.integration import Integration, Region, apply_regions, integrate, join_regions
from vb_map_integration.places.recognition import BorderLocation

# verdict codes: the border waits for a person, or is not in force
TO_BE_CONFIRMED, DOES_NOT_FIT = "to_be_confirmed", "inactive_on_this_map"
# reasons for waiting, besides the codes of `IntegrationError`
PLACE, EFFECT = "$place_uncertain", "$closes_something_else"
# a border closes off the same floor if the IoU of what it closed off and closes off now is at least this
_SAME_EFFECT = 0.5
# while it waits, what it closes off now is in force only up to this many times the area that was accepted
_MAX_GROWTH_WHILE_WAITING = 2.0
_NAMED = 3  # how many borders are named to describe a place


@dataclass(frozen=True)
class Verdict:
    """The status of one border on the current map.

    Attributes:
        stored: the border in its place's frame.
        border: the border in the map's frame.
        code: TO_BE_CONFIRMED, DOES_NOT_FIT, or "" if it is in force unchanged, or disabled.
        why: PLACE, EFFECT, or the code of the error; "" if none applies.
        region: the region in force; None if there is none.
        before: the region that it restricted when it was accepted, on this map; None if not needed or off the map.
        after: the region that it will restrict once confirmed; None if there is none.
    """

    stored: VirtualBorder
    border: VirtualBorder
    code: str = ""
    why: str = ""
    region: Optional[Region] = field(default=None, repr=False)
    before: Optional[Region] = field(default=None, repr=False)
    after: Optional[Region] = field(default=None, repr=False)

    @property
    def can_be_confirmed(self) -> bool:
        """Whether a person can accept the border as it is now."""
        return self.code == TO_BE_CONFIRMED and self.why in (PLACE, EFFECT)

    @property
    def values(self) -> Dict[str, str]:
        """The values for the sentence that belongs to its code."""
        before, after = (region.area_m2 if region else 0.0 for region in (self.before, self.after))
        areas = {"before": f"{before:.1f}", "now": f"{after:.1f}"} if self.before else {}
        return {"border": self.border.name, "why": self.why, **areas}


@dataclass(frozen=True)
class InForce:
    """What is in force on a map.

    Attributes:
        physical: the map without borders.
        verdicts: by border id, the oldest first.
    """

    physical: GridMap
    verdicts: Mapping[str, Verdict] = field(default_factory=dict)

    @cached_property
    def map_with_borders(self) -> GridMap:
        """The map with all borders in force."""
        return apply_regions(self.physical, self.regions())

    def regions(self, without: Iterable[str] = ()) -> List[Region]:
        """Returns the regions of the borders in force, except `without`; those of slow zones have the value 0."""
        return [
            verdict.region
            for key, verdict in self.verdicts.items()
            if verdict.region is not None and key not in without
        ]

    @property
    def slow_zones(self) -> Tuple[Verdict, ...]:
        """The slow zones in force."""
        return tuple(
            verdict
            for verdict in self.verdicts.values()
            if verdict.region is not None and verdict.border.zone.limits_speed
        )

    def area_m2(self, border_id: str) -> float:
        """Returns the area [m^2] that a border restricts now; 0 if it is not in force."""
        region = self.verdicts[border_id].region if border_id in self.verdicts else None
        return region.area_m2 if region else 0.0

    def status(self, border: VirtualBorder) -> Tuple[bool, str]:
        """Returns whether a border is in force now, and its status code.

        Returns:
            (in force, code): "to_be_confirmed" or "" if it is in force, else "disabled" or "inactive_on_this_map".
        """
        verdict = self.verdicts[border.id]
        if not border.enabled:
            return False, "disabled"
        return verdict.code != DOES_NOT_FIT, verdict.code

    def outlines(self, border_id: str) -> Tuple[np.ndarray, np.ndarray]:
        """Returns the outlines (N, 2) [m] before and after confirmation; empty unless the border waits for it."""
        verdict = self.verdicts[border_id]
        regions = (verdict.before, verdict.after) if verdict.code == TO_BE_CONFIRMED else (None, None)
        return tuple(  # type: ignore[return-value]
            region.outline(self.physical) if region else np.zeros((0, 2)) for region in regions
        )

    @property
    def speed_limits(self) -> GridMap:
        """The speed limit of each cell [cm/s], 0: none; in the map's geometry."""
        cells = np.zeros(self.physical.shape, np.int8)
        for verdict in self.slow_zones:
            part, inside = cells[verdict.region.window], verdict.region.mask != 0  # type: ignore[union-attr]
            limit = np.int8(max(1, min(127, round(100.0 * verdict.border.max_speed))))
            part[inside] = np.where(part[inside] == 0, limit, np.minimum(part[inside], limit))
        return self.physical.with_data(cells)


def compute_in_force(
    grid: GridMap,
    borders: Iterable[VirtualBorder],
    locate: Callable[[VirtualBorder], BorderLocation],
    before: Optional[InForce] = None,
    checked: Optional[Integration] = None,
) -> InForce:
    """Computes what is in force on a map.

    Args:
        grid: the physical map.
        borders: the stored borders, in the frame of their place.
        locate: finds where a border is on the map.
        before: the previous result for the same map and the same `locate`: the verdicts of unchanged borders are taken
            from it.
        checked: a border of them that was just integrated into this map, and need not be again.
    """
    earlier = before.verdicts if before else {}
    verdicts: Dict[str, Verdict] = {}
    for border in borders:
        verdict = earlier.get(border.id)
        is_same = verdict is not None and verdict.stored is border
        verdicts[border.id] = verdict if is_same else _judge(border, locate(border), grid, checked)
    return InForce(grid, verdicts)


def _judge(stored: VirtualBorder, location: BorderLocation, grid: GridMap, checked: Optional[Integration]) -> Verdict:
    """Decides which region of a border is in force, and whether to ask a person; if in doubt, more is in force."""
    border = location.border
    if not border.enabled:
        return Verdict(stored, border)
    current, error = _find_region(grid, border, checked)
    if location.accepted is None:
        return Verdict(stored, border, "" if current else DOES_NOT_FIT, error, current, after=current)
    # a closed line or a wall closes off the same wherever it is, as the line alone decides
    before = current if border.closed or border.wall else location.region_before(grid)
    why = error
    if not why and location.floor_is_known and not location.walls_agree:
        why = PLACE
    # they are the same object if the line alone decides: then there is nothing to compare
    if not why and before is not current and (before is None or before.iou(current) < _SAME_EFFECT):
        why = EFFECT
    possible = [current, *(_find_region(grid, other, checked)[0] for other in location.others)]
    if not why:
        return Verdict(stored, border, region=join_regions(possible), after=current)
    region = _region_while_waiting(before, possible)
    return Verdict(stored, border, TO_BE_CONFIRMED if region else DOES_NOT_FIT, why, region, before, current)


def _region_while_waiting(before: Optional[Region], possible: List[Optional[Region]]) -> Optional[Region]:
    """Joins what is in force until a person answers: `before`, and each possible region that is not much larger."""
    if before is None:
        return join_regions(possible)
    most = _MAX_GROWTH_WHILE_WAITING * before.area_m2
    return join_regions([before, *(region for region in possible if region is not None and region.area_m2 <= most)])


def _find_region(grid: GridMap, border: VirtualBorder, checked: Optional[Integration]) -> Tuple[Optional[Region], str]:
    """Finds the region that a border restricts; else returns None and the code that says why there is none."""
    # on its way to the frame of its place and back a border may have moved by a rounding error: then it is not the same
    if checked and checked.prior is grid and checked.value == border.value and checked.border.same_area(border):
        return checked, ""
    try:
        return integrate(grid, border), ""
    except IntegrationError as error:
        return None, error.code


def find_notices(verdicts: Sequence[Verdict], is_certain: bool, place_name: str) -> List[Notice]:
    """Returns the notices about a map's place, and about borders that have changed on this map.

    Args:
        is_certain: whether it is known for certain which place the map shows.
        place_name: the place's name; "" if it has none.
    """
    notices = []
    waiting = [verdict.border for verdict in verdicts if verdict.can_be_confirmed]
    if not is_certain:
        values = {"count": str(len(verdicts)), **_describe_place(place_name, [verdict.border for verdict in verdicts])}
        notices.append(Notice("borders_unconfirmed", Severity.WARNING, values=values))
    elif waiting:
        values = {"count": str(len(waiting)), "borders": _names(waiting)}
        notices.append(Notice("borders_to_confirm", Severity.WARNING, values=values))
    return notices + [
        Notice(verdict.code, Severity.WARNING, border_id=verdict.border.id, values=verdict.values)
        for verdict in verdicts
        if verdict.code
    ]


def _describe_place(name: str, borders: Iterable[VirtualBorder]) -> Dict[str, str]:
    """Describes a place to people: by the name that they gave it, else by its borders and their date."""
    if name:
        return {"place": "$place_named", "map": name}
    drawn = sorted(borders, key=lambda border: border.created)
    if not drawn:
        return {"place": "$place_before"}
    date = time.strftime("%Y-%m-%d", time.localtime(drawn[0].created))
    return {"place": "$place_of_borders", "borders": _names(drawn), "date": date}


def _names(borders: Sequence[VirtualBorder]) -> str:
    """Lists the names of the first few borders."""
    return ", ".join(border.name for border in borders[:_NAMED]) + (", ..." if len(borders) > _NAMED else "")
