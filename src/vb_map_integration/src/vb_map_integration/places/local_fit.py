"""Where a border is in a new map by the walls round it: maps bend, and a transform for all of a map is only a start.

The idea: the walls within some metres of a border decide where it is. They are looked for near the place where the map's
transform puts them. If they are found there and nowhere else, the border is where it was. Where they are found but cannot be
told apart from places beside them (a straight wall, an open hall), those a little farther away are asked whether it is where
it is expected; if they do not know either, a person has to confirm it.

Reach and limits were chosen on half of 28 maps that robots recorded, with parts that were displaced by half a metre;
docs/results/maps/README.md has what the other half and further maps gave.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np

from vb_map_integration.places.registration import Transform, WallMap, find_share, refine, thin

REACH = 3.0  # [m] walls this near a border say where it is; those beyond may belong to another part of a bent map
WIDER = 4.5  # [m] the same, where those leave it open
_SPAN, _STEP, _YAWS = 1.0, 0.1, np.radians([-8.0, -5.3, -2.7, 0.0, 2.7, 5.3, 8.0])  # what is searched: [m], [m], [rad]
_NEAR = 0.25  # [m] a wall this far from the next one counts for nothing
_APART = 0.35  # [m] places farther apart are different ones
_MAX_POINTS, _MIN_POINTS = 300, 10  # wall cells that are compared, at most and at least
_LOCAL_REACH = (0.6, 0.4, 0.3, 0.2, 0.15, 0.15)  # [m] as `registration.refine` has it
_SURE = 0.97  # if this share of the walls is found again, no other place is searched
# what it takes to accept a place where the border is expected, and what it takes elsewhere
_EXPECTED = 0.15  # [m]
_AGREEMENT_THERE, _LOWER_THERE, _MARGIN_THERE = 0.8, 0.5, 0.05
_AGREEMENT_ELSEWHERE, _MARGIN_ELSEWHERE = 0.9, 0.1
_KNOWN = 0.5  # share of the walls that the new map has to know


@dataclass(frozen=True)
class LocalFit:
    """What the walls round a border say.

    Attributes:
        transform: from the old map's frame to the new one's, for this border.
        agreement: shares of the walls round it that are found again, in both directions, the lower one first.
        known: share of the old map's walls there that the new map knows.
        margin: 0 .. 1, how much less the next place explains.
        moved_m: [m] how far this is from where it was expected.
    """

    transform: Transform
    agreement: Tuple[float, float]
    known: float
    margin: float
    moved_m: float

    @property
    def is_certain(self) -> bool:
        """Returns whether the border is there: near where it was expected, or elsewhere on more evidence."""
        lower, higher = self.agreement
        if self.known < _KNOWN:
            return False
        if self.moved_m <= _EXPECTED:
            return higher >= _AGREEMENT_THERE and lower >= _LOWER_THERE and self.margin >= _MARGIN_THERE
        return lower >= _AGREEMENT_ELSEWHERE and self.margin >= _MARGIN_ELSEWHERE

    @property
    def is_open(self) -> bool:
        """Returns whether the walls are found, but other places beside this one would do as well."""
        return self.is_possible and self.margin < _MARGIN_THERE

    @property
    def is_possible(self) -> bool:
        """Returns whether the border may be there, as far as the walls tell."""
        return self.known >= _KNOWN and self.agreement[1] >= _AGREEMENT_THERE


def fit_locally(old: WallMap, new: WallMap, start: Transform, outline: np.ndarray) -> Optional[LocalFit]:
    """Finds the walls round a border in a new map; None if there are too few.

    Args:
        start: from the old map's frame to the new one's, where they are expected.
        outline: (N, 2) [m] old map's frame, of the border.
    """
    near = _fit_within(REACH, old, new, start, outline)
    if near is not None and not near.is_open:
        return near
    wider = _fit_within(WIDER, old, new, start, outline)
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

    beside = _APART * np.column_stack([np.cos(_EIGHT), np.sin(_EIGHT)])
    here, *around = _scores(sample, new, start, np.concatenate([[[0.0, 0.0]], beside]))
    if find_share(start.apply(walls), new)[0] >= _SURE and max(around) <= (1.0 - _MARGIN_THERE) * here:
        best, margin = start, 1.0 - max(around) / here
    else:
        steps = np.arange(-round(_SPAN / _STEP), round(_SPAN / _STEP) + 1) * _STEP
        shifts = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        scores = np.array([_scores(sample, new, motion(np.zeros(2), turn), shifts) for turn in _YAWS])
        turn, shift = np.unravel_index(int(np.argmax(scores)), scores.shape)
        apart = np.linalg.norm(shifts - shifts[shift], axis=1) > _APART
        margin = 1.0 - float(scores[:, apart].max()) / max(1e-9, float(scores[turn, shift]))
        best = motion(shifts[shift], float(_YAWS[turn]))
        best = refine(old, new, best, sample, new.walls_near(best.apply(outline), reach), center, _LOCAL_REACH)
    forward, known = find_share(best.apply(walls), new)
    backward, _ = find_share(best.inverse.apply(new.walls_near(best.apply(outline), reach)), old)
    moved = float(np.linalg.norm(best.apply(center)[0] - expected))
    return LocalFit(best, (min(forward, backward), max(forward, backward)), known, margin, moved)


_EIGHT = np.arange(8) * (math.pi / 4.0)


def _scores(walls: np.ndarray, new: WallMap, transform: Transform, shifts: np.ndarray) -> np.ndarray:
    """Scores (K,) 0 .. 1 how near walls (N, 2) are to the new map's, at each of the shifts (K, 2) [m]."""
    points = transform.apply(walls)[None] + shifts[:, None]
    distance, known = new.distances(points.reshape(-1, 2))
    near = np.maximum(0.0, 1.0 - np.square(distance / _NEAR)) * known
    counts = known.reshape(len(shifts), -1).sum(axis=1)
    return near.reshape(len(shifts), -1).sum(axis=1) / np.maximum(counts, _KNOWN * len(walls))
