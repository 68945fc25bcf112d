"""Locates a border on a new map by the walls round it: maps are distorted, so the whole map's transform is only a start.

The walls within some metres of a border decide where it is. They are searched for near the position where the map's
transform puts them. If they are found there and nowhere else, the border is there too. If their position is ambiguous
(along a straight wall, in an open hall), walls a little farther away are included, which may confirm that the border is
where it is expected; if that stays ambiguous, a person has to confirm it.

Reach and limits were chosen on half of 28 maps that robots recorded, with parts displaced by half a metre;
docs/results/maps/README.md has the results on the other half and on further maps.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Mapping, Optional, Tuple

import numpy as np

from vb_core.grid_map import GridMap, Transform
from vb_map_integration.border import VirtualBorder
from vb_map_integration.places.registration import WallMap, compare_walls, refine, subsample
from vb_map_integration.storage.border_database import StoredMap

_MIN_SEEN_SHARE = 0.5  # share of a border's points that the map must know before a person is asked about the border
WALL_RADIUS = 3.0  # [m] walls this near a border decide where it is; others may be distorted differently
WIDER_WALL_RADIUS = 4.5  # [m] the same, where those are ambiguous
_MAX_WALLS = 300  # wall cells that are compared: `count` of `registration.subsample`
_MIN_WALLS = 10  # with fewer wall cells round it, a border cannot be located
# [m] from the expected position, in x and in y, at which walls are searched for
_SEARCH_STEPS = np.arange(-10, 11) * 0.1
_SEARCH_SHIFTS = np.stack(np.meshgrid(_SEARCH_STEPS, _SEARCH_STEPS), axis=-1).reshape(-1, 2)
_SEARCH_YAWS = np.radians([-8.0, -5.3, -2.7, 0.0, 2.7, 5.3, 8.0])  # [rad]
_REACHES = (0.6, 0.4, 0.3, 0.2, 0.15, 0.15)  # [m] `reaches` of `registration.refine`
_SCORED_DISTANCE = 0.25  # [m] a wall cell this far from the new map's nearest wall scores 0
_MIN_SEPARATION = 0.35  # [m] positions farther apart than this count as different
_EIGHT_ANGLES = np.arange(8) * (np.pi / 4.0)  # [rad]
_SHIFTS_ASIDE = _MIN_SEPARATION * np.column_stack([np.cos(_EIGHT_ANGLES), np.sin(_EIGHT_ANGLES)])
_NO_SEARCH_SHARE = 0.97  # no search if this share of the walls is found again where expected, and clearly less nearby
_MIN_KNOWN = 0.5  # share of the walls that must be in the known part of the new map
# a position is accepted from these agreements (see `LocalFit.agreement`) and this margin on
_EXPECTED_DISTANCE = 0.15  # [m] a border farther from where it is expected needs the higher values, ..._ELSEWHERE
_MIN_HIGHER_AGREEMENT = 0.8
_MIN_LOWER_AGREEMENT = 0.5
_MIN_MARGIN = 0.05
_MIN_AGREEMENT_ELSEWHERE = 0.9
_MIN_MARGIN_ELSEWHERE = 0.1


@dataclass(frozen=True)
class BorderLocation:
    """Where a border is on the current map.

    Attributes:
        border: the border at its position on this map.
        walls_agree: whether the walls round it confirm the position.
        floor_is_known: whether the map knows the floor there; until it does, no person is asked about the border.
        alternatives: the border at other possible positions, until a person says where it is.
        accepted: the border as a person accepted it, on `accepted_map`; None if that is the current map.
        accepted_map: the map on which it was accepted.
        transform: transform from that map's frame to the current one's.
    """

    border: VirtualBorder
    walls_agree: bool = True
    floor_is_known: bool = True
    alternatives: Tuple[VirtualBorder, ...] = ()
    accepted: Optional[VirtualBorder] = None
    accepted_map: Optional[GridMap] = None
    transform: Transform = Transform()


@dataclass(frozen=True)
class BorderLocator:
    """Locates the borders of a place on one map of it.

    Attributes:
        grid, map_id: the map, and its fingerprint.
        stored_maps: the place's stored maps by fingerprint, the oldest first.
        transform: transform from the place's frame to the map's.
        other_transform: a second possible one; None if there is none.
    """

    grid: GridMap
    map_id: str
    stored_maps: Mapping[str, StoredMap]
    transform: Transform
    other_transform: Optional[Transform]

    @cached_property
    def _walls(self) -> WallMap:  # only needed for a border that was accepted on another map
        return WallMap(self.grid)

    def locate(self, border: VirtualBorder) -> BorderLocation:
        """Locates a stored border: where the walls round it are if these settle its position, else where it is expected."""
        stored = self.stored_maps.get(border.map_id) or next(iter(self.stored_maps.values()), None)
        if stored is None or stored.fingerprint == self.map_id:
            return BorderLocation(border.transform(self.transform))
        accepted = border.transform(stored.transform)
        expected = self.transform.after(stored.transform.inverse)
        fit = fit_locally(wall_map_of(stored), self._walls, expected, accepted.points)
        points = expected.apply(np.concatenate([accepted.points, [accepted.seed]]))
        floor_is_known = float(self._walls.is_known(points).mean()) >= _MIN_SEEN_SHARE
        walls_agree = fit is not None and fit.is_certain
        transform = fit.transform if fit is not None and walls_agree else expected
        alternatives = []
        if fit is not None and fit.is_possible and not walls_agree:
            alternatives.append(accepted.transform(fit.transform))
        if self.other_transform is not None:
            alternatives.append(border.transform(self.other_transform))
        here = accepted.transform(transform)
        return BorderLocation(here, walls_agree, floor_is_known, tuple(alternatives), accepted, stored.grid, transform)


@lru_cache(maxsize=64)
def wall_map_of(stored_map: StoredMap) -> WallMap:
    """Returns the walls of a stored map."""
    return WallMap(stored_map.grid)


@dataclass(frozen=True)
class LocalFit:
    """Where the walls round a border are in a new map, and how well they fit there.

    Attributes:
        transform: from the old map's frame to the new one's, for this border.
        agreement: shares of the walls round it that are found again, of both directions, the lower one first.
        known_share: share of the old map's walls there that are in the known part of the new map.
        margin: 0 .. 1, how much lower the score of the next best position is, as a share.
        moved_m: [m] distance from the expected position.
    """

    transform: Transform
    agreement: Tuple[float, float]
    known_share: float
    margin: float
    moved_m: float

    @property
    def is_certain(self) -> bool:
        """Whether the border is certainly there: near where it was expected, or elsewhere on more evidence."""
        lower, higher = self.agreement
        if self.moved_m > _EXPECTED_DISTANCE:
            is_found = lower >= _MIN_AGREEMENT_ELSEWHERE and self.margin >= _MIN_MARGIN_ELSEWHERE
        else:
            is_found = higher >= _MIN_HIGHER_AGREEMENT and lower >= _MIN_LOWER_AGREEMENT and self.margin >= _MIN_MARGIN
        return is_found and self.known_share >= _MIN_KNOWN

    @property
    def is_possible(self) -> bool:
        """Whether the walls allow that the border is there."""
        return self.known_share >= _MIN_KNOWN and self.agreement[1] >= _MIN_HIGHER_AGREEMENT


def fit_locally(old: WallMap, new: WallMap, expected: Transform, outline: np.ndarray) -> Optional[LocalFit]:
    """Finds the walls round a border in a new map; None if there are too few.

    Args:
        expected: the transform from the old map's frame to the new one's at which they are expected.
        outline: (N, 2) [m] the border's, in the old map's frame.
    """
    near = _fit(WALL_RADIUS, old, new, expected, outline)
    # if the walls are found, but fit other positions about as well, or if there are too few, more walls may decide
    if near is not None and not (near.is_possible and near.margin < _MIN_MARGIN):
        return near
    wider = _fit(WIDER_WALL_RADIUS, old, new, expected, outline)
    return wider if wider is not None and wider.is_certain and wider.moved_m <= _EXPECTED_DISTANCE else near


def _fit(radius: float, old: WallMap, new: WallMap, expected: Transform, outline: np.ndarray) -> Optional[LocalFit]:
    """Finds the walls within a radius [m] of a border in a new map, as `fit_locally` does."""
    walls = old.walls_near(outline, radius)
    if len(walls) < _MIN_WALLS:
        return None
    sample = subsample(walls, _MAX_WALLS)
    center = outline.mean(axis=0)
    here, *aside = _scores(sample, new, expected, np.concatenate([[[0.0, 0.0]], _SHIFTS_ASIDE]))
    share, _ = compare_walls(expected.apply(walls), new)
    if share >= _NO_SEARCH_SHARE and max(aside) <= (1.0 - _MIN_MARGIN) * here:
        best = expected
        margin = 1.0 - max(aside) / here
    else:
        best, margin = _search(sample, new, expected, center)
        new_walls = new.walls_near(best.apply(outline), radius)
        best = refine(old, new, best, (sample, new_walls), center, _REACHES)
    forward, known_share = compare_walls(best.apply(walls), new)
    new_walls = new.walls_near(best.apply(outline), radius)
    backward, _ = compare_walls(best.inverse.apply(new_walls), old)
    agreement = min(forward, backward), max(forward, backward)
    moved = float(np.linalg.norm(best.apply(center)[0] - expected.apply(center)[0]))
    return LocalFit(best, agreement, known_share, margin, moved)


def _search(walls: np.ndarray, new: WallMap, expected: Transform, center: np.ndarray) -> Tuple[Transform, float]:
    """Searches a grid of positions round the expected one; returns the best transform, and its `LocalFit.margin`."""
    expected_center = expected.apply(center)[0]
    yaws = expected.yaw + _SEARCH_YAWS
    transforms = [Transform.rotation_about(center, expected_center, yaw) for yaw in yaws]
    scores = np.array([_scores(walls, new, transform, _SEARCH_SHIFTS) for transform in transforms])
    yaw_index, shift_index = np.unravel_index(int(np.argmax(scores)), scores.shape)
    best_shift = _SEARCH_SHIFTS[shift_index]
    is_apart = np.linalg.norm(_SEARCH_SHIFTS - best_shift, axis=1) > _MIN_SEPARATION
    best_apart = float(scores[:, is_apart].max())
    margin = 1.0 - best_apart / max(1e-9, float(scores[yaw_index, shift_index]))
    return Transform.rotation_about(center, expected_center + best_shift, yaws[yaw_index]), margin


def _scores(walls: np.ndarray, new: WallMap, transform: Transform, shifts: np.ndarray) -> np.ndarray:
    """Scores (K,), 0 .. 1, how near walls (N, 2) are to the new map's, at each of the shifts (K, 2) [m]."""
    points = transform.apply(walls) + shifts[:, None]
    distances, is_known = new.distances(points.reshape(-1, 2))
    nearness = np.maximum(0.0, 1.0 - np.square(distances / _SCORED_DISTANCE))
    shape = len(shifts), len(walls)
    sums = (nearness * is_known).reshape(shape).sum(axis=1)
    known_counts = is_known.reshape(shape).sum(axis=1)
    min_count = _MIN_KNOWN * len(walls)
    return sums / np.maximum(known_counts, min_count)
