"""Finds a border in a new map by the walls round it: maps are distorted, so the whole map's transform is only a start.

The walls within some metres of a border decide where it is. They are searched for near the position where the map's
transform puts them. If they are found there and nowhere else, the border is there too. If their position is ambiguous
(along a straight wall, in an open hall), walls a little farther away are included, which may confirm that the border is
where it is expected; if that stays ambiguous, a person has to confirm it.

Reach and limits were chosen on half of 28 maps that robots recorded, with parts displaced by half a metre;
docs/results/maps/README.md has the results on the other half and on further maps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np

from vb_map_integration.places.registration import Transform, WallMap, find_share, refine, thin

WALL_RADIUS = 3.0  # [m] walls this near a border decide where it is; others may be distorted differently
WIDER_WALL_RADIUS = 4.5  # [m] the same, where those are ambiguous
_SPAN, _STEP, _YAWS = 1.0, 0.1, np.radians([-8.0, -5.3, -2.7, 0.0, 2.7, 5.3, 8.0])  # the search grid: [m], [m], [rad]
_NEAR = 0.25  # [m] a wall cell this far from the new map's nearest wall scores 0
_MIN_SEPARATION = 0.35  # [m] positions farther apart than this count as different
_MAX_POINTS, _MIN_POINTS = 300, 10  # wall cells that are compared: `most` of `thin`, and the minimum
_LOCAL_REACH = (0.6, 0.4, 0.3, 0.2, 0.15, 0.15)  # [m] `reaches` of `registration.refine`
_NO_SEARCH_SHARE = 0.97  # no search if this share of the walls is found again where expected, and clearly less nearby
# what it takes to accept a position where the border is expected, and elsewhere
_EXPECTED = 0.15  # [m]
_AGREEMENT_THERE, _LOWER_THERE, _MARGIN_THERE = 0.8, 0.5, 0.05
_AGREEMENT_ELSEWHERE, _MARGIN_ELSEWHERE = 0.9, 0.1
_KNOWN = 0.5  # share of the walls that must be in the known part of the new map


@dataclass(frozen=True)
class LocalFit:
    """Where the walls round a border are in a new map, and how well they fit there.

    Attributes:
        transform: from the old map's frame to the new one's, for this border.
        agreement: shares of the walls round it that are found again, of both directions, the lower one first.
        known: share of the old map's walls there that are in the known part of the new map.
        margin: 0 .. 1, how much lower the score of the next best position is, as a share.
        moved_m: [m] distance from the expected position.
    """

    transform: Transform
    agreement: Tuple[float, float]
    known: float
    margin: float
    moved_m: float

    @property
    def is_certain(self) -> bool:
        """Whether the border is certainly there: near where it was expected, or elsewhere on more evidence."""
        lower, higher = self.agreement
        if self.known < _KNOWN:
            return False
        if self.moved_m <= _EXPECTED:
            return higher >= _AGREEMENT_THERE and lower >= _LOWER_THERE and self.margin >= _MARGIN_THERE
        return lower >= _AGREEMENT_ELSEWHERE and self.margin >= _MARGIN_ELSEWHERE

    @property
    def is_ambiguous(self) -> bool:
        """Whether the walls are found, but fit other positions about as well."""
        return self.is_possible and self.margin < _MARGIN_THERE

    @property
    def is_possible(self) -> bool:
        """Whether the walls allow that the border is there."""
        return self.known >= _KNOWN and self.agreement[1] >= _AGREEMENT_THERE


def fit_locally(old: WallMap, new: WallMap, start: Transform, outline: np.ndarray) -> Optional[LocalFit]:
    """Finds the walls round a border in a new map; None if there are too few.

    Args:
        start: from the old map's frame to the new one's, as expected.
        outline: (N, 2) [m] the border's, in the old map's frame.
    """
    near = _fit_within(WALL_RADIUS, old, new, start, outline)
    if near is not None and not near.is_ambiguous:
        return near
    wider = _fit_within(WIDER_WALL_RADIUS, old, new, start, outline)
    return wider if wider is not None and wider.is_certain and wider.moved_m <= _EXPECTED else near


def _fit_within(reach: float, old: WallMap, new: WallMap, start: Transform, outline: np.ndarray) -> Optional[LocalFit]:
    walls = old.walls_near(outline, reach)
    if len(walls) < _MIN_POINTS:
        return None
    sample = thin(walls, _MAX_POINTS)
    center = outline.mean(axis=0)
    expected = start.apply(center)[0]

    def motion(shift: np.ndarray, turn: float) -> Transform:
        yaw = start.yaw + turn
        x, y = expected + shift - Transform(0.0, 0.0, yaw).apply(center)[0]
        return Transform(float(x), float(y), math.remainder(yaw, 2.0 * math.pi))

    beside = _MIN_SEPARATION * np.column_stack([np.cos(_EIGHT), np.sin(_EIGHT)])
    here, *around = _scores(sample, new, start, np.concatenate([[[0.0, 0.0]], beside]))
    if find_share(start.apply(walls), new)[0] >= _NO_SEARCH_SHARE and max(around) <= (1.0 - _MARGIN_THERE) * here:
        best, margin = start, 1.0 - max(around) / here
    else:
        steps = np.arange(-round(_SPAN / _STEP), round(_SPAN / _STEP) + 1) * _STEP
        shifts = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        scores = np.array([_scores(sample, new, motion(np.zeros(2), turn), shifts) for turn in _YAWS])
        turn, shift = np.unravel_index(int(np.argmax(scores)), scores.shape)
        apart = np.linalg.norm(shifts - shifts[shift], axis=1) > _MIN_SEPARATION
        margin = 1.0 - float(scores[:, apart].max()) / max(1e-9, float(scores[turn, shift]))
        best = motion(shifts[shift], float(_YAWS[turn]))
        best = refine(old, new, best, sample, new.walls_near(best.apply(outline), reach), center, _LOCAL_REACH)
    forward, known = find_share(best.apply(walls), new)
    backward, _ = find_share(best.inverse.apply(new.walls_near(best.apply(outline), reach)), old)
    moved = float(np.linalg.norm(best.apply(center)[0] - expected))
    return LocalFit(best, (min(forward, backward), max(forward, backward)), known, margin, moved)


_EIGHT = np.arange(8) * (math.pi / 4.0)


def _scores(walls: np.ndarray, new: WallMap, transform: Transform, shifts: np.ndarray) -> np.ndarray:
    """Scores (K,), 0 .. 1, how near walls (N, 2) are to the new map's, at each of the shifts (K, 2) [m]."""
    points = transform.apply(walls)[None] + shifts[:, None]
    distance, is_known = new.distances(points.reshape(-1, 2))
    near = np.maximum(0.0, 1.0 - np.square(distance / _NEAR)) * is_known
    counts = is_known.reshape(len(shifts), -1).sum(axis=1)
    return near.reshape(len(shifts), -1).sum(axis=1) / np.maximum(counts, _KNOWN * len(walls))
