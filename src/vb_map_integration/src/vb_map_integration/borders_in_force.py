"""Which borders are in force on a map, what each of them restricts there, and the notices about them.

A border is identified by the floor that it closes off as well as by its line:

- On the map on which a person accepted it, it is in force as drawn.
- On any other map, it waits for a person unless the walls round it are in place and it closes off the same floor.
- While it waits, it closes off more rather than less: the floor where it was accepted, the floor at its second possible
  position and, unless that is much larger, the floor here. If none of them is on the map, it is not in force.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Dict, Iterable, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from vb_core.grid_map import GridMap
from vb_core.notices import Notice, Severity
from vb_map_integration.border import IntegrationError, VirtualBorder, warning
from vb_map_integration.border_region import compute_region
from vb_map_integration.places.border_location import BorderLocation, BorderLocator
from vb_map_integration.restricted_cells import BorderCheck, BorderRegion, Positions, Region
from vb_map_integration.restricted_cells import apply_regions, count_free_parts, join_regions

# status codes: the border waits for a person, or is not in force
TO_BE_CONFIRMED, DOES_NOT_FIT = "to_be_confirmed", "inactive_on_this_map"
# causes of waiting, besides the codes of `IntegrationError`
PLACE, EFFECT = "place_uncertain", "closes_something_else"
# a border closes off the same floor if the IoU of what it closed off and closes off now is at least this
_MIN_SAME_FLOOR_IOU = 0.5
# while it waits, what it closes off now is in force only up to this many times the area that was accepted
_MAX_GROWTH_WHILE_WAITING = 2.0
_MAX_NAMES = 3  # how many borders are named to describe a place


@dataclass(frozen=True)
class BorderStatus:
    """The status of one border on the current map.

    Attributes:
        stored_border: the border in its place's frame.
        map_border: the border in the map's frame.
        code: TO_BE_CONFIRMED, DOES_NOT_FIT, or "" if it is in force unchanged, or disabled.
        cause: why it has the code: PLACE, EFFECT, or the code of the error; "" if it has none.
        region: the region in force; None if there is none.
        region_before: the region that it restricted where it was accepted, as cells of this map; None if there are none,
            or nothing is to be confirmed.
        region_after: the region that will be in force once it is confirmed; None if there is none.
    """

    stored_border: VirtualBorder
    map_border: VirtualBorder
    code: str = ""
    cause: str = ""
    region: Optional[Region] = field(default=None, repr=False)
    region_before: Optional[Region] = field(default=None, repr=False)
    region_after: Optional[Region] = field(default=None, repr=False)

    @property
    def is_in_force(self) -> bool:
        """Whether the border restricts anything on the map."""
        return self.region is not None

    @property
    def reason(self) -> str:
        """The reason as a code: "disabled" or DOES_NOT_FIT if it is not in force, else TO_BE_CONFIRMED or ""."""
        return self.code if self.map_border.enabled else "disabled"

    @property
    def area_m2(self) -> float:
        """The area [m^2] that the border restricts now."""
        return self.region.area_m2 if self.region else 0.0

    @property
    def can_be_confirmed(self) -> bool:
        """Whether a person can accept the border as it is now."""
        return self.code == TO_BE_CONFIRMED and self.cause in (PLACE, EFFECT)

    @property
    def sentence_values(self) -> Dict[str, str]:
        """The values for the sentence that belongs to its code."""
        why = "why_code" if self.cause in (PLACE, EFFECT) else "why"
        values = {"border": self.map_border.name, why: self.cause}
        if self.region_before:
            area_now = self.region_after.area_m2 if self.region_after else 0.0
            values.update(before=f"{self.region_before.area_m2:.1f}", now=f"{area_now:.1f}")
        return values


@dataclass(frozen=True)
class BordersInForce:
    """A map, and what its borders restrict there.

    Attributes:
        physical_map: the map without borders.
        robot_radius: [m] to compute what a robot can reach.
        statuses: the status of each border by its id, the oldest border first.
    """

    physical_map: GridMap
    robot_radius: float
    statuses: Mapping[str, BorderStatus] = field(default_factory=dict)

    def check_border(self, border: VirtualBorder, robot_positions: Positions = ()) -> BorderCheck:
        """Checks what adding a border in the map's frame, or replacing the one with the same id, would do.

        Args:
            robot_positions: (N, 2) [m] of the robots that it applies to.

        Raises:
            IntegrationError: as `compute_region`.
        """
        map_with_others = self.draw_map(excluded_ids=[border.id])
        region = compute_region(self.physical_map, border)
        free_parts = count_free_parts(apply_regions(map_with_others, [region]), self.robot_radius)
        issues = list(region.issues)
        if region.contains_any(self.physical_map.world_to_cell(robot_positions)):
            issues.append(warning("robot_inside"))
        if free_parts > self._free_parts:
            issues.append(warning("splits_free_space"))
        if free_parts == 0 < self._free_parts:
            issues.append(warning("no_free_space_left"))
        return BorderCheck(region, tuple(issues), free_parts)

    @cached_property
    def _free_parts(self) -> int:
        """The number of parts of the free space with all borders in force."""
        return count_free_parts(self.map_with_borders, self.robot_radius)

    @cached_property
    def map_with_borders(self) -> GridMap:
        """The map with all borders in force."""
        return apply_regions(self.physical_map, [status.region for status in self.statuses.values() if status.region])

    def draw_map(self, excluded_ids: Iterable[str]) -> GridMap:
        """Draws the map with the borders in force, without those with excluded ids."""
        statuses = {key: status for key, status in self.statuses.items() if key not in excluded_ids}
        remaining = self if len(statuses) == len(self.statuses) else replace(self, statuses=statuses)
        return remaining.map_with_borders

    @property
    def slow_zones(self) -> Tuple[BorderStatus, ...]:
        """The slow zones in force."""
        statuses = self.statuses.values()
        return tuple(status for status in statuses if status.is_in_force and status.map_border.zone.limits_speed)

    def outlines(self, border_id: str) -> Tuple[np.ndarray, np.ndarray]:
        """Returns the outlines (N, 2) [m] before and after confirmation; empty unless the border waits for it."""
        status = self.statuses[border_id]
        regions = (status.region_before, status.region_after) if status.code == TO_BE_CONFIRMED else (None, None)
        return tuple(region.outline(self.physical_map) if region else np.zeros((0, 2)) for region in regions)

    @property
    def speed_limits(self) -> GridMap:
        """The speed limit of each cell [cm/s], 0: none; in the map's geometry."""
        cells = np.zeros(self.physical_map.shape, np.int8)
        for status in self.slow_zones:
            part = cells[status.region.window]  # type: ignore[union-attr]
            limit = np.int8(max(1, min(127, round(100.0 * status.map_border.max_speed))))
            # a cell keeps a lower limit that it already has
            is_changed = (status.region.mask != 0) & ((part == 0) | (part > limit))  # type: ignore[union-attr]
            part[is_changed] = limit
        return self.physical_map.with_data(cells)


def compute_borders_in_force(
    borders: Iterable[VirtualBorder],
    locator: BorderLocator,
    previous: BordersInForce,
    drawn_regions: Mapping[str, Region],
) -> BordersInForce:
    """Computes which borders are in force on a map, and what they restrict there.

    Args:
        borders: the stored borders, in the frame of their place.
        locator: has the physical map, and finds where the borders are on it.
        previous: the previous result for the same locator, from which unchanged borders take their statuses.
        drawn_regions: by border id, those of borders that were just drawn on this map.
    """
    statuses: Dict[str, BorderStatus] = {}
    for border in borders:
        status = previous.statuses.get(border.id)
        if status is None or status.stored_border is not border:
            status = _decide_status(border, locator.locate(border), locator.grid, drawn_regions.get(border.id))
        statuses[border.id] = status
    return replace(previous, statuses=statuses)


def _decide_status(
    stored: VirtualBorder, location: BorderLocation, grid: GridMap, drawn_region: Optional[Region]
) -> BorderStatus:
    """Decides which region of a border is in force, and whether to ask a person. In doubt, the larger one is."""
    border = location.border
    if not border.enabled:
        return BorderStatus(stored, border)
    current, error = (drawn_region, "") if drawn_region else _find_region(grid, border)
    if location.accepted is None:
        return BorderStatus(stored, border, "" if current else DOES_NOT_FIT, error, current, region_after=current)
    before = current
    # polygons and walls close off the same floor wherever they are, because their line alone decides
    if not (border.closed or border.is_wall):
        # there is none if other limits were valid when the border was accepted
        accepted, _ = _find_region(location.accepted_map, location.accepted)
        before = accepted.transfer(location.transform, grid) if accepted else None
    cause = error
    if not cause and location.floor_is_known and not location.walls_agree:
        cause = PLACE
    # both are the same object if the line alone decides: then there is nothing to compare
    if current is not None and before is not current and not cause:
        if before is None or before.iou(current) < _MIN_SAME_FLOOR_IOU:
            cause = EFFECT
    possible = [current, *(_find_region(grid, other)[0] for other in location.alternatives)]
    if not cause:
        return BorderStatus(stored, border, region=join_regions(possible), region_after=current)
    # until a person answers, the border restricts what it restricted before, and nothing that is much larger
    if before is not None:
        max_area = _MAX_GROWTH_WHILE_WAITING * before.area_m2
        possible = [before, *(region for region in possible if region is not None and region.area_m2 <= max_area)]
    region = join_regions(possible)
    code = TO_BE_CONFIRMED if region else DOES_NOT_FIT
    return BorderStatus(stored, border, code, cause, region, before, current)


def _find_region(grid: GridMap, border: VirtualBorder) -> Tuple[Optional[BorderRegion], str]:
    """Finds the region that a border restricts. Returns None, and the code that says why, if there is none."""
    try:
        return compute_region(grid, border), ""
    except IntegrationError as error:
        return None, error.code


def find_notices(statuses: Sequence[BorderStatus], is_certain: bool, place_name: str) -> List[Notice]:
    """Returns the notices about a map's place, and about borders that have changed on this map.

    Args:
        is_certain: whether it is known for certain which place the map shows.
        place_name: the place's name; "" if it has none.
    """
    notices = []
    borders = [status.map_border for status in statuses]
    waiting = [status.map_border for status in statuses if status.can_be_confirmed]
    if not is_certain:
        values = {"count": str(len(borders)), **_describe_place(place_name, borders)}
        notices.append(Notice("borders_unconfirmed", Severity.WARNING, values=values))
    elif waiting:
        values = {"count": str(len(waiting)), "borders": _list_names(waiting)}
        notices.append(Notice("borders_to_confirm", Severity.WARNING, values=values))
    for status in statuses:
        if status.code:
            border_id = status.map_border.id
            notices.append(Notice(status.code, Severity.WARNING, border_id=border_id, values=status.sentence_values))
    return notices


def _describe_place(name: str, borders: Iterable[VirtualBorder]) -> Dict[str, str]:
    """Describes a place to people: by the name that they gave it, else by its borders and their date."""
    if name:
        return {"place_code": "place_named", "map": name}
    drawn = sorted(borders, key=lambda border: border.created)
    if not drawn:
        return {"place_code": "place_before"}
    date = time.strftime("%Y-%m-%d", time.localtime(drawn[0].created))
    return {"place_code": "place_of_borders", "borders": _list_names(drawn), "date": date}


def _list_names(borders: Sequence[VirtualBorder]) -> str:
    """Lists the names of the first few borders."""
    listed = [border.name for border in borders[:_MAX_NAMES]]
    if len(borders) > _MAX_NAMES:
        listed.append("...")
    return ", ".join(listed)
