"""Which place a map shows, and where that place's borders are in it.

The idea: fail closed. A map is recognised by its exact fingerprint; else by the name that a person gave it, and by
registration against the maps at which the borders were drawn, never against the last one seen. Where that is not sure
the borders of the likeliest place stay in force, and a person is asked.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Dict, List, Optional

import numpy as np

from vb_core.grid_map import OCCUPIED_THRESHOLD, GridMap
from vb_map_integration.storage.database import Database, KnownMap
from vb_map_integration.places.registration import (
    IDENTITY,
    MIN_AGREEMENT,
    MIN_OVERLAP,
    Registration,
    WallMap,
    Transform,
    measure_at,
    register_wall_maps,
)

# this many of a place's maps are compared: the first and the newest ones
_COMPARED = 3
# below it a registration says nothing about where the borders are
_PLAUSIBLE_AGREEMENT = 0.8
# shares of agreement that mean nothing between hypotheses none of which is sure
_DOUBT = 0.15
# a map continues the one before if this share of its obstacles are in the same cells
_CONTINUED = 0.95
# a map of which nothing is sure is registered again once this much more floor is known
_GROWN = 1.25


@dataclass(frozen=True)
class PlaceRecognition:
    """What a map was recognised as.

    Attributes:
        place: its number in the database; 0: a new place, which has no borders.
        transform: from the place's frame to the map's.
        certain: False: the borders need confirmation.
        registration: what it rests on; None if none was needed or possible.
        floor_cells: free cells when it was made.
    """

    place: int = 0
    transform: Transform = IDENTITY
    certain: bool = True
    registration: Optional[Registration] = None
    floor_cells: int = 0


class PlaceRecognizer:
    """Recognises maps by the database.

    Args:
        database: it is only read.
        name: of the place, from the launch file; empty: any.
    """

    def __init__(self, database: Database, name: str = "") -> None:
        self._database = database
        self._name = name
        self._wall_maps: Dict[str, WallMap] = {}

    def recognize(
        self, grid: GridMap, map_id: str, before: Optional[GridMap], recognition: PlaceRecognition
    ) -> PlaceRecognition:
        """Recognises what a map shows.

        Args:
            before: the map before it, while this program has been running.
            verdict: what that was recognised as; decides only where to look first.
        """
        known = self._database.find_map(map_id)
        if known is not None:
            return PlaceRecognition(known.place, known.transform)
        candidates = self._candidates()
        if not candidates:
            return PlaceRecognition()
        floor = int(np.count_nonzero((grid.data >= 0) & (grid.data < OCCUPIED_THRESHOLD)))
        wall_map = WallMap(grid)
        continued = before is not None and recognition.place in candidates and is_extension(before, grid)
        if (
            continued
            and recognition.certain
            and self._agrees(candidates[recognition.place], wall_map, recognition.transform)
        ):
            return replace(recognition, floor_cells=floor)
        if continued and not recognition.certain and floor < _GROWN * recognition.floor_cells:
            return recognition
        return replace(self._register(candidates, wall_map, recognition), floor_cells=floor)

    def _candidates(self) -> Dict[int, List[KnownMap]]:
        """Returns the maps of each place that it may be; without maps that could not be taken over."""
        places: Dict[int, List[KnownMap]] = {}
        for one in self._database.maps():
            places.setdefault(one.place, []).append(one)
        names = {place: next((one.name for one in maps if one.id == place), "") for place, maps in places.items()}
        if self._name:
            named = {place for place, name in names.items() if name == self._name}
            chosen = named or {place for place, name in names.items() if not name}
        else:
            chosen = set(places)
        return {place: maps for place, maps in places.items() if place in chosen and self._database.count(place)}

    def _wall_map_of(self, one: KnownMap) -> Optional[WallMap]:
        if one.grid is None:
            return None
        if one.fingerprint not in self._wall_maps:
            self._wall_maps[one.fingerprint] = WallMap(one.grid)
        return self._wall_maps[one.fingerprint]

    def _agrees(self, maps: List[KnownMap], wall_map: WallMap, transform: Transform) -> bool:
        """Returns whether a map fits one at which borders were drawn, where it is expected to be."""
        for one in maps:
            reference = self._wall_map_of(one)
            if reference is None:
                continue
            found = measure_at(reference, wall_map, transform.after(one.transform.inverse))
            if found.agreement >= MIN_AGREEMENT and found.overlap >= MIN_OVERLAP:
                return True
        return False

    def _register(
        self, candidates: Dict[int, List[KnownMap]], wall_map: WallMap, recognition: PlaceRecognition
    ) -> PlaceRecognition:
        best: Dict[int, PlaceRecognition] = {}
        for place, maps in candidates.items():
            for one in maps[:1] + maps[1:][1 - _COMPARED :]:
                reference = self._wall_map_of(one)
                guesses = [IDENTITY, recognition.transform.after(one.transform.inverse)]
                found = register_wall_maps(reference, wall_map, guesses) if reference else None
                if found is None:
                    continue
                if not found.is_unambiguous:
                    found = self._unmoved(reference, wall_map, found, guesses)
                transform = _snap(found.transform.after(one.transform), recognition.transform, wall_map.grid)
                new = PlaceRecognition(place, transform, found.is_unambiguous, found)
                if place not in best or (new.certain, found.score) > (best[place].certain, _score(best[place])):
                    best[place] = new
        certain = [one for one in best.values() if one.certain]
        if len(certain) == 1:
            return certain[0]
        # several floors may have the same walls: then nothing is sure either
        plausible = [
            one for one in best.values() if one.registration and one.registration.agreement >= _PLAUSIBLE_AGREEMENT
        ]
        if plausible:
            return replace(max(plausible, key=_score), certain=False)
        last = self._database.get_value("last_place")
        place = int(last) if last.isdigit() and int(last) in candidates else max(candidates)
        return replace(best[place], certain=False) if place in best else PlaceRecognition(place, IDENTITY, False)

    @staticmethod
    def _unmoved(
        reference: Optional[WallMap], wall_map: WallMap, found: Registration, guesses: List[Transform]
    ) -> Registration:
        """Decides that borders stay where they are, unless another transform is plausible and fits clearly better."""
        assert reference is not None
        still = max((measure_at(reference, wall_map, guess) for guess in guesses), key=lambda one: one.agreement)
        moves = found.agreement >= max(_PLAUSIBLE_AGREEMENT, still.agreement + _DOUBT)
        return found if moves else still


def is_extension(before: GridMap, after: GridMap) -> bool:
    """Returns whether a map is the one before it, grown: the cells are on the same lattice, and obstacles are still there."""
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
    """Replaces a transform by the identity, or by the one in force, if it differs from that by less than half a cell."""
    for known in (IDENTITY, expected):
        apart = np.linalg.norm(transform.apply(grid.corners()) - known.apply(grid.corners()), axis=1).max()
        if apart < 0.5 * grid.resolution + 0.002 * np.ptp(grid.corners(), axis=0).max():
            return known
    return transform


def _score(recognition: PlaceRecognition) -> float:
    return recognition.registration.score if recognition.registration else 0.0
