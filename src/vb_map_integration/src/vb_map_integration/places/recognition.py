"""Recognises which place a map shows, and locates that place's borders on it.

Recognition fails closed. A map is recognised by its exact fingerprint; else by the name that a person gave it and by
registration in the maps on which borders were drawn, never in the last map seen. A transform is proposed if none else
fits nearly as well. Otherwise the likeliest place's borders stay where they are. Each border is then located by the
walls round it. If they settle which place it is, nobody is asked: maps of one place agree in 50 to 97 % of their walls.
Different floors with the same outer walls may agree as much, but not round most of the borders.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Dict, List, NamedTuple, Optional, Tuple

import numpy as np

from vb_core.grid_map import OCCUPIED_THRESHOLD, GridMap, Transform
from vb_map_integration.places.border_location import BorderLocator, wall_map_of
from vb_map_integration.places.registration import Registration, evaluate_transform, register_maps
from vb_map_integration.places.walls import WallMap
from vb_map_integration.storage.border_database import Database, StoredMap

# how many of a place's maps are compared: the first and the newest ones
_MAPS_COMPARED = 3
# a registration with a lower agreement is no evidence of where the borders are
_PLAUSIBLE_AGREEMENT = 0.8
# from this agreement on, borders may be where a registration puts them
_POSSIBLE_AGREEMENT = 0.5
# smaller differences in agreement between hypotheses mean nothing if none is certain
_MIN_LEAD = 0.15
# a map continues the previous one if this share of the previous one's obstacles are still in the same cells
_MIN_KEPT_SHARE = 0.95
# a map that was not recognised for certain is registered again once its known floor has grown by this factor
_GROWTH = 1.25


@dataclass(frozen=True)
class PlaceRecognition:
    """What a map was recognised as.

    Attributes:
        place: the place's number in the database; 0: a new place, which has no borders.
        transform: transform from the place's frame to the map's.
        is_certain: if False, the borders need confirmation.
        floor_cells: number of free cells of the map when it was recognised.
        other_transform: a second possible transform, until a person confirms one; None if there is none.
        is_likely: whether a check of the walls round the borders may make it certain.
    """

    place: int = 0
    transform: Transform = Transform()
    is_certain: bool = True
    floor_cells: int = 0
    other_transform: Optional[Transform] = None
    is_likely: bool = False


class _Candidate(NamedTuple):
    """A possible recognition of a map, and the registration that it is based on."""

    recognition: PlaceRecognition
    registration: Registration

    @property
    def rank(self) -> Tuple[bool, bool, float]:
        return self.recognition.is_certain, self.registration.is_clearly_best, self.registration.score

    @property
    def is_plausible(self) -> bool:
        return self.registration.is_clearly_best or self.registration.agreement >= _PLAUSIBLE_AGREEMENT


class PlaceRecognizer:
    """Recognises maps by comparing them with those in the database.

    Args:
        database: the database, which is only read.
        name: the place's name, from the launch file; empty: any.
    """

    def __init__(self, database: Database, name: str = "") -> None:
        self._database = database
        self._name = name

    def recognize(
        self, grid: GridMap, map_id: str, previous_map: Optional[GridMap], recognition: PlaceRecognition
    ) -> PlaceRecognition:
        """Recognises which place a map shows.

        Args:
            previous_map: the previous map since this program was started; None for the first.
            recognition: what the previous map was recognised as; the search starts there.
        """
        stored = self._database.maps().get(map_id)
        named_place = self._database.find_place(self._name)
        # if the stored place has no borders, the map may still show the named place, which has some
        if stored is not None and (named_place in (0, stored.place) or self._database.borders(stored.place)):
            name = self._database.place_name(stored.place)
            has_expected_name = not self._name or name in ("", self._name)
            return PlaceRecognition(stored.place, stored.transform, is_certain=has_expected_name)
        candidates = self._candidates()
        if not candidates:
            return PlaceRecognition()
        floor = int(np.count_nonzero((grid.data >= 0) & (grid.data < OCCUPIED_THRESHOLD)))
        wall_map = WallMap(grid)
        if previous_map is not None and recognition.place in candidates and is_extension(previous_map, grid):
            if recognition.is_certain:
                for stored_map in candidates[recognition.place]:
                    expected = recognition.transform.after(stored_map.transform.inverse)
                    if evaluate_transform(wall_map_of(stored_map), wall_map, expected).walls_agree:
                        return replace(recognition, floor_cells=floor)
            elif floor < _GROWTH * recognition.floor_cells:
                return recognition
        recognition = replace(self._register(candidates, wall_map, recognition), floor_cells=floor)
        if recognition.is_likely:
            maps = self._database.maps_of(recognition.place)
            locator = BorderLocator(grid, map_id, maps, recognition.transform, recognition.other_transform)
            locations = [locator.locate(border) for border in self._database.borders(recognition.place)]
            comparable = [location for location in locations if location.floor_is_known]
            most_agree = 2 * sum(location.walls_agree for location in comparable) > len(comparable)
            recognition = replace(recognition, is_certain=most_agree)
        return recognition

    def _candidates(self) -> Dict[int, List[StoredMap]]:
        """Returns, for each place with borders that the current map may show, the place's maps."""
        places: Dict[int, List[StoredMap]] = {}
        for stored_map in self._database.maps().values():
            if self._database.borders(stored_map.place):
                places.setdefault(stored_map.place, []).append(stored_map)
        if not self._name:
            return places
        name = self._name if self._database.find_place(self._name) else ""
        return {place: maps for place, maps in places.items() if self._database.place_name(place) == name}

    def _register(
        self, places: Dict[int, List[StoredMap]], wall_map: WallMap, recognition: PlaceRecognition
    ) -> PlaceRecognition:
        """Recognises a map by registration in maps of places; the search starts at an earlier recognition."""
        best: Dict[int, _Candidate] = {}
        for place, maps in places.items():
            for stored_map in maps[:1] + maps[1:][1 - _MAPS_COMPARED :]:
                candidate = self._compare(stored_map, wall_map, recognition)
                if candidate is not None and (place not in best or candidate.rank > best[place].rank):
                    best[place] = candidate
        certain = [candidate.recognition for candidate in best.values() if candidate.recognition.is_certain]
        if len(certain) == 1:
            return certain[0]
        # several floors may have the same walls: then none is certain
        plausible = [candidate for candidate in best.values() if candidate.is_plausible]
        if plausible:
            likeliest = max(plausible, key=lambda candidate: candidate.rank)
            others = [other.registration.agreement for other in plausible if other is not likeliest]
            is_ahead = likeliest.registration.agreement >= max(others, default=0.0) + _MIN_LEAD
            is_likely = likeliest.registration.is_clearly_best and is_ahead
            return replace(likeliest.recognition, is_certain=False, is_likely=is_likely)
        last = self._database.last_place
        place = last if last in places else max(places)
        unsure = best[place].recognition if place in best else PlaceRecognition(place)
        return replace(unsure, is_certain=False)

    def _compare(self, stored_map: StoredMap, wall_map: WallMap, start: PlaceRecognition) -> Optional[_Candidate]:
        """Registers one stored map in the new map; returns None if one of them has no walls."""
        reference = wall_map_of(stored_map)
        guesses = [Transform(), start.transform.after(stored_map.transform.inverse)]
        registration = register_maps(reference, wall_map, guesses)
        if registration is None:
            return None
        other_transform = None
        if not (registration.is_certain or registration.is_clearly_best):
            # borders stay where they are, unless another transform is plausible and fits clearly better
            unmoved = [evaluate_transform(reference, wall_map, guess) for guess in guesses]
            best_unmoved = max(unmoved, key=lambda candidate: candidate.agreement)
            is_moved = registration.agreement >= max(_PLAUSIBLE_AGREEMENT, best_unmoved.agreement + _MIN_LEAD)
            registration, other = (registration, best_unmoved) if is_moved else (best_unmoved, registration)
            if other.agreement >= _POSSIBLE_AGREEMENT and other.transform != registration.transform:
                other_transform = other.transform.after(stored_map.transform)
        transform = registration.transform.after(stored_map.transform)
        transform = _snap(transform, start.transform, wall_map.grid)
        certain = registration.is_certain
        recognition = PlaceRecognition(stored_map.place, transform, certain, other_transform=other_transform)
        return _Candidate(recognition, registration)


def is_extension(previous: GridMap, current: GridMap) -> bool:
    """Returns whether a map is the previous one, grown: on the same lattice of cells, and with its obstacles."""
    has_other_resolution = abs(previous.resolution - current.resolution) > 1e-6
    has_other_yaw = abs(previous.origin[2] - current.origin[2]) > 1e-9
    if has_other_resolution or has_other_yaw:
        return False
    offset = current.world_to_grid(previous.cell_to_world([[0, 0]]))[0]
    column, row = np.rint(offset).astype(int)
    if np.abs(offset - (column, row)).max() > 1e-3:
        return False
    obstacles = np.argwhere(previous.data >= OCCUPIED_THRESHOLD) + (row, column)
    on_map = obstacles[current.contains_cells(obstacles)]
    is_still_there = current.data[tuple(on_map.T)] >= OCCUPIED_THRESHOLD
    return len(obstacles) > 0 and np.count_nonzero(is_still_there) >= _MIN_KEPT_SHARE * len(obstacles)


def _snap(transform: Transform, expected: Transform, grid: GridMap) -> Transform:
    """Snaps a transform to the identity or the expected one if it is within half a cell + 0.2 % of the map's size."""
    corners = grid.corners()
    tolerance = 0.5 * grid.resolution + 0.002 * np.ptp(corners, axis=0).max()
    for target in (Transform(), expected):
        shifts = transform.apply(corners) - target.apply(corners)
        if np.linalg.norm(shifts, axis=1).max() < tolerance:
            return target
    return transform
