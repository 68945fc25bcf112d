"""Recognises which place a map shows, and locates that place's borders on it.

Recognition fails closed. A map is recognised by its exact fingerprint; else by the name that a person gave it and by
registration against the maps on which borders were drawn, never against the last map seen. A transform that no other
comes near is proposed; without one, the borders of the most likely place stay where they are. Each border is then
searched for by the walls round it. If these settle which place it is, nobody is asked: maps of one place agree in 50
to 97 % of their walls, and so may different floors with the same outer walls, but not round most of the borders.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Dict, List, Optional, Tuple

import cv2
import numpy as np

from vb_core.grid_map import OCCUPIED_THRESHOLD, GridMap
from vb_map_integration.border import IntegrationError, VirtualBorder
from vb_map_integration.integration import Region, integrate
from vb_map_integration.places.local_fit import fit_locally
from vb_map_integration.places.registration import IDENTITY, Registration, Transform, WallMap, measure, register
from vb_map_integration.storage.database import Database, KnownMap

# how many of a place's maps are compared: the first and the newest ones
_COMPARED = 3
# a registration with a lower agreement is no evidence of where the borders are
_PLAUSIBLE_AGREEMENT = 0.8
# from this agreement on, borders may be where a registration puts them
_POSSIBLE_AGREEMENT = 0.5
# share of a border's line that must be in the known part of the map before a person is asked about it
_SEEN = 0.5
# smaller differences in agreement between hypotheses mean nothing if none is certain
_DOUBT = 0.15
# a map continues the previous one if this share of the previous one's obstacles are still in the same cells
_CONTINUED = 0.95
# a map that was not recognised for certain is registered again once its known floor has grown by this factor
_GROWN = 1.25


@dataclass(frozen=True)
class PlaceRecognition:
    """What a map was recognised as.

    Attributes:
        place: the place's number in the database; 0: a new place, which has no borders.
        transform: transform from the place's frame to the map's.
        certain: if False, the borders need confirmation.
        floor_cells: number of free cells of the map when it was recognised.
        other: a second possible transform, until a person confirms one; None if there is none.
        likely: whether a check of the walls round the borders may make it certain.
    """

    place: int = 0
    transform: Transform = IDENTITY
    certain: bool = True
    floor_cells: int = 0
    other: Optional[Transform] = None
    likely: bool = False


@dataclass(frozen=True)
class BorderLocation:
    """Where a border is on the current map.

    Attributes:
        border: the border at its position on this map.
        walls_agree: whether the walls round it confirm the position.
        floor_is_known: whether the map knows the floor there; until it does, no person is asked about the border.
        others: the border at other possible positions, until a person says where it is.
        accepted: the border as a person accepted it, on `accepted_on`; None if that is the current map.
        accepted_on: the map on which it was accepted.
        transform: transform from that map's frame to the current one's.
    """

    border: VirtualBorder
    walls_agree: bool = True
    floor_is_known: bool = True
    others: Tuple[VirtualBorder, ...] = ()
    accepted: Optional[VirtualBorder] = None
    accepted_on: Optional[GridMap] = None
    transform: Transform = Transform()

    def region_before(self, grid: GridMap) -> Optional[Region]:
        """Returns what it restricted on the map where it was accepted, as free cells of this map; None if none."""
        assert self.accepted is not None and self.accepted_on is not None
        try:
            effect = integrate(self.accepted_on, self.accepted)
        except IntegrationError:  # accepted by an earlier version with other limits
            return None
        corners = self.accepted_on.grid_to_world([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        start, *ends = grid.world_to_grid(self.transform.apply(corners))
        matrix = np.column_stack([*(end - start for end in ends), start])
        restricted = effect.restricted_cells.view(np.uint8)
        here = cv2.warpAffine(restricted, matrix, grid.shape[::-1], flags=cv2.INTER_NEAREST)
        left, top, width, height = cv2.boundingRect(here)
        window = slice(top, top + height), slice(left, left + width)
        free = (grid.data[window] >= 0) & (grid.data[window] < OCCUPIED_THRESHOLD)
        mask = here[window] * free * np.uint8(255)
        count = cv2.countNonZero(mask)
        return Region(window, mask, effect.value, False, count * grid.resolution**2) if count else None


class PlaceRecognizer:
    """Recognises maps by comparing them with those in the database.

    Args:
        database: the database, which is only read.
        name: the place's name, from the launch file; empty: any.
    """

    def __init__(self, database: Database, name: str = "") -> None:
        self._database = database
        self._name = name
        self._wall_maps: Dict[str, WallMap] = {}

    def recognize(
        self, grid: GridMap, map_id: str, before: Optional[GridMap], recognition: PlaceRecognition
    ) -> PlaceRecognition:
        """Recognises which place a map shows.

        Args:
            before: the previous map since this program was started; None for the first.
            recognition: what the previous map was recognised as; the search starts there.
        """
        stored, named = self._database.find_map(map_id), self._database.find_place(self._name)
        # if the stored place has no borders, the map may still show the named place, which has some
        if stored is not None and (named in (0, stored.place) or self._database.borders(stored.place)):
            name = self._database.get_name(stored.place)
            return PlaceRecognition(stored.place, stored.transform, not self._name or name in ("", self._name))
        candidates = self._candidates()
        if not candidates:
            return PlaceRecognition()
        floor = int(np.count_nonzero((grid.data >= 0) & (grid.data < OCCUPIED_THRESHOLD)))
        wall_map = WallMap(grid)
        if before is not None and recognition.place in candidates and is_extension(before, grid):
            maps, transform = candidates[recognition.place], recognition.transform
            if recognition.certain and self._agrees(maps, wall_map, transform):
                return replace(recognition, floor_cells=floor)
            if not recognition.certain and floor < _GROWN * recognition.floor_cells:
                return recognition
        recognition = replace(self._register(candidates, wall_map, recognition), floor_cells=floor)
        if recognition.likely:
            self.start_map(grid, map_id, recognition)
            recognition = replace(recognition, certain=self._walls_round_borders_agree())
        return recognition

    def _walls_round_borders_agree(self) -> bool:
        """Returns whether most of the borders on known floor have the walls round them where they should be."""
        places = [self.locate(border) for border in self._database.borders(self._recognition.place)]
        comparable = [place for place in places if place.floor_is_known]
        return 2 * sum(place.walls_agree for place in comparable) > len(comparable)

    def _candidates(self) -> Dict[int, List[KnownMap]]:
        """Returns, for each place with borders that the current map may show, the place's maps."""
        places: Dict[int, List[KnownMap]] = {}
        for known_map in self._database.maps():
            if self._database.borders(known_map.place):
                places.setdefault(known_map.place, []).append(known_map)
        if not self._name:
            return places
        name = self._name if self._database.find_place(self._name) else ""
        return {place: maps for place, maps in places.items() if self._database.get_name(place) == name}

    def _wall_map_of(self, known_map: KnownMap) -> WallMap:
        if known_map.fingerprint not in self._wall_maps:
            self._wall_maps[known_map.fingerprint] = WallMap(known_map.grid)
        return self._wall_maps[known_map.fingerprint]

    def _agrees(self, maps: List[KnownMap], wall_map: WallMap, transform: Transform) -> bool:
        """Returns whether a map agrees, at its expected transform, with one of a place's stored maps."""
        starts = ((self._wall_map_of(known_map), transform.after(known_map.transform.inverse)) for known_map in maps)
        return any(measure(reference, wall_map, start).agrees for reference, start in starts)

    def _register(
        self, candidates: Dict[int, List[KnownMap]], wall_map: WallMap, recognition: PlaceRecognition
    ) -> PlaceRecognition:
        best: Dict[int, Tuple[PlaceRecognition, Registration]] = {}
        for place, maps in candidates.items():
            for stored_map in maps[:1] + maps[1:][1 - _COMPARED :]:
                reference = self._wall_map_of(stored_map)
                guesses = [IDENTITY, recognition.transform.after(stored_map.transform.inverse)]
                registration = register(reference, wall_map, guesses)
                if registration is None:
                    continue
                other = None
                if not (registration.is_unambiguous or registration.is_unique):
                    registration, other = self._prefer_unmoved(reference, wall_map, registration, guesses)
                    other = other.after(stored_map.transform) if other else None
                transform = _snap(
                    registration.transform.after(stored_map.transform), recognition.transform, wall_map.grid
                )
                new = PlaceRecognition(place, transform, registration.is_unambiguous, other=other), registration
                if place not in best or _rank(new) > _rank(best[place]):
                    best[place] = new
        certain = [candidate for candidate, _ in best.values() if candidate.certain]
        if len(certain) == 1:
            return certain[0]
        # several floors may have the same walls: then none is certain
        plausible = [
            candidate
            for candidate in best.values()
            if candidate[1].is_unique or candidate[1].agreement >= _PLAUSIBLE_AGREEMENT
        ]
        if plausible:
            likeliest, registration = max(plausible, key=_rank)
            others = [other.agreement for candidate, other in plausible if candidate is not likeliest]
            likely = registration.is_unique and registration.agreement >= max(others, default=0.0) + _DOUBT
            return replace(likeliest, certain=False, likely=likely)
        last = self._database.last_place
        place = last if last in candidates else max(candidates)
        return replace(best[place][0], certain=False) if place in best else PlaceRecognition(place, IDENTITY, False)

    @staticmethod
    def _prefer_unmoved(
        reference: WallMap, wall_map: WallMap, registration: Registration, guesses: List[Transform]
    ) -> Tuple[Registration, Optional[Transform]]:
        """Leaves borders where they are, unless another transform is plausible and fits clearly better.

        Returns:
            The proposed registration, and the other transform if it is possible too.
        """
        still = max(
            (measure(reference, wall_map, guess) for guess in guesses), key=lambda candidate: candidate.agreement
        )
        moves = registration.agreement >= max(_PLAUSIBLE_AGREEMENT, still.agreement + _DOUBT)
        proposed, other = (registration, still) if moves else (still, registration)
        possible = other.agreement >= _POSSIBLE_AGREEMENT and other.transform != proposed.transform
        return proposed, other.transform if possible else None

    # ------------------------------------------------------------- borders
    def start_map(self, grid: GridMap, map_id: str, recognition: PlaceRecognition) -> None:
        """Prepares `locate` for a map and what it was recognised as."""
        self._current, self._current_id, self._recognition = grid, map_id, recognition
        self._maps = {
            known_map.fingerprint: known_map
            for known_map in self._database.maps()
            if known_map.place == recognition.place
        }
        self._current_walls: Optional[WallMap] = None

    def locate(self, border: VirtualBorder) -> BorderLocation:
        """Finds where a stored border of the current map's place is on that map.

        If the walls round it settle its position, it is there, else where it is expected.
        """
        recognition = self._recognition
        stored = self._maps.get(border.map_id) or next(iter(self._maps.values()), None)
        if stored is None or stored.fingerprint == self._current_id:
            return BorderLocation(border.moved(recognition.transform))
        accepted = border.moved(stored.transform)
        start = recognition.transform.after(stored.transform.inverse)
        if self._current_walls is None:
            self._current_walls = WallMap(self._current)
        fit = fit_locally(self._wall_map_of(stored), self._current_walls, start, accepted.points)
        here = start.apply(np.concatenate([accepted.points, [accepted.seed]]))
        floor_is_known = float(self._current_walls.is_known(here).mean()) >= _SEEN
        walls_agree = fit is not None and fit.is_certain
        others = [accepted.moved(fit.transform)] if fit is not None and fit.is_possible and not walls_agree else []
        others += [border.moved(recognition.other)] if recognition.other is not None else []
        transform = fit.transform if fit is not None and walls_agree else start
        return BorderLocation(
            accepted.moved(transform), walls_agree, floor_is_known, tuple(others), accepted, stored.grid, transform
        )


def is_extension(before: GridMap, after: GridMap) -> bool:
    """Returns whether a map is the previous one, grown: on the same lattice of cells, and with its obstacles."""
    if abs(before.resolution - after.resolution) > 1e-6 or abs(before.origin[2] - after.origin[2]) > 1e-9:
        return False
    offset = after.world_to_grid(before.cell_to_world([[0, 0]]))[0]
    column, row = np.rint(offset).astype(int)
    if np.abs(offset - (column, row)).max() > 1e-3:
        return False
    rows, columns = np.nonzero(before.data >= OCCUPIED_THRESHOLD)
    rows, columns = rows + row, columns + column
    inside = (rows >= 0) & (columns >= 0) & (rows < after.shape[0]) & (columns < after.shape[1])
    same = np.count_nonzero(after.data[rows[inside], columns[inside]] >= OCCUPIED_THRESHOLD)
    return len(rows) > 0 and same >= _CONTINUED * len(rows)


def _snap(transform: Transform, expected: Transform, grid: GridMap) -> Transform:
    """Snaps a transform to the identity or the expected one if it is within half a cell + 0.2 % of the map's size."""
    for target in (IDENTITY, expected):
        distance = np.linalg.norm(transform.apply(grid.corners()) - target.apply(grid.corners()), axis=1).max()
        if distance < 0.5 * grid.resolution + 0.002 * np.ptp(grid.corners(), axis=0).max():
            return target
    return transform


def _rank(candidate: Tuple[PlaceRecognition, Registration]) -> Tuple[bool, bool, float]:
    """Ranks a possible recognition of a map, with the registration that it is based on."""
    return candidate[0].certain, candidate[1].is_unique, candidate[1].score
