"""Stage 2, second half: the stroke as a line that is walked once.

The sights of a track, in order of time, become stations some centimetres apart: a spot held still is one station,
however long. Where the pointer runs along what it had drawn before, in either direction, the later pass goes into the
stations of the earlier one, so that a line drawn twice is one line that was seen twice as often.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

import numpy as np
from scipy.spatial import cKDTree


STEP = 0.05  # [m] between stations: what a hand trembles
SAME_LINE = 0.1  # [m] passes that are no farther apart are one line: a border is not drawn narrower
WIDEST_STATION = 0.1  # [m] of line that one station stands for; more of it was not seen


@dataclass(frozen=True)
class Trace:
    """Stations along a stroke, in the order in which they were drawn first.

    Attributes:
        points: (K, 2) [m].
        weights: (K,) [m] of the line that each stands for.
        sights: (N, 2) [m] the sights it was made of.
        of_sight: (N,) the station that each sight belongs to.
        sight_weights: (N,) [m] each sight's part of its station's weight.
    """

    points: np.ndarray
    weights: np.ndarray
    sights: np.ndarray
    of_sight: np.ndarray
    sight_weights: np.ndarray

    def select(self, stations: np.ndarray) -> "Trace":
        """The trace along these stations (indices, in this order)."""
        place = np.full(len(self.points), -1)
        place[stations] = np.arange(len(stations))
        kept = place[self.of_sight] >= 0
        return Trace(
            self.points[stations], self.weights[stations], self.sights[kept], place[self.of_sight[kept]],
            self.sight_weights[kept],
        )


def trace_of(points: np.ndarray, trust: np.ndarray, widest_gap: float) -> Optional[Trace]:
    """The trace of sights (N, 2) [m] with weights (N,), in the order in which they were drawn."""
    if len(points) < 3:
        return None
    return _passes_merged(points, trust, _stations(points, trust), widest_gap)


def _stations(points: np.ndarray, trust: np.ndarray) -> np.ndarray:
    """(N,) the station of each sight: a new one begins where the pointer has left the last by STEP."""
    half = min(2, (len(points) - 1) // 2)
    window = np.arange(-half, half + 1)
    rows = np.clip(np.arange(len(points))[:, None] + window, 0, len(points) - 1)
    calm = (points[rows] * trust[rows][..., None]).sum(axis=1) / trust[rows].sum(axis=1)[:, None]
    station = np.empty(len(points), dtype=np.int64)
    number, seen, x, y = 0, 0, 0.0, 0.0
    for row, (px, py) in enumerate(calm.tolist()):
        if seen and (px - x / seen) ** 2 + (py - y / seen) ** 2 > STEP**2:
            number, seen, x, y = number + 1, 0, 0.0, 0.0
        seen, x, y = seen + 1, x + px, y + py
        station[row] = number
    return station


def _means(points: np.ndarray, trust: np.ndarray, station: np.ndarray, count: int) -> np.ndarray:
    total = np.maximum(np.bincount(station, trust, count), 1e-12)
    return np.column_stack([np.bincount(station, trust * points[:, k], count) / total for k in range(2)])


def _passes_merged(points: np.ndarray, trust: np.ndarray, station: np.ndarray, widest_gap: float) -> Optional[Trace]:
    count = int(station.max()) + 1
    at = _means(points, trust, station, count)
    earlier = _earlier_pass(at)
    kept = np.ones(count, dtype=bool)
    for first, last in _runs(earlier >= 0):
        length = np.linalg.norm(np.diff(at[first : last + 1], axis=0), axis=1).sum()
        inner = first > 0 and last + 1 < count
        if length < 3.0 * SAME_LINE or (inner and np.linalg.norm(at[last + 1] - at[first - 1]) > widest_gap):
            continue
        kept[first : last + 1] = False
    if kept.sum() < 2:
        return None
    # a repeated station's sights go to the nearest one that is kept
    place = np.cumsum(kept) - 1
    gone = np.flatnonzero(~kept)
    if len(gone):
        place[gone] = cKDTree(at[kept]).query(at[gone])[1]
    of_sight = place[station]
    count = int(kept.sum())
    at = _means(points, trust, of_sight, count)
    ways = np.minimum(np.linalg.norm(np.diff(at, axis=0), axis=1), WIDEST_STATION)
    weights = 0.5 * (np.append(ways, 0.0) + np.append(0.0, ways)) + 0.1 * STEP
    total = np.bincount(of_sight, trust, count)
    return Trace(at, weights, points, of_sight, weights[of_sight] * trust / total[of_sight])


def _earlier_pass(at: np.ndarray) -> np.ndarray:
    """(K,) for each station the first one of an earlier pass over the same line, -1 where there is none."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(at, axis=0), axis=1))])
    index = np.arange(len(at))
    heading = at[np.minimum(index + 2, len(at) - 1)] - at[np.maximum(index - 2, 0)]
    heading = heading / np.maximum(np.linalg.norm(heading, axis=1), 1e-9)[:, None]
    pairs = cKDTree(at).query_pairs(SAME_LINE, output_type="ndarray")
    found = np.full(len(at), -1)
    if len(pairs) == 0:
        return found
    before, after = pairs.min(axis=1), pairs.max(axis=1)
    same_way = (heading[before] * heading[after]).sum(axis=1)
    apart = arc[after] - arc[before]
    # where the pointer turns round and comes back it is on the same line at once
    again = ((same_way > 0.7) & (apart > 4.0 * SAME_LINE)) | ((same_way < -0.7) & (apart > 1.5 * SAME_LINE))
    order = np.argsort(-before[again], kind="stable")
    found[after[again][order]] = before[again][order]
    return found


def _runs(flags: np.ndarray):
    """(first, last) of each run of true flags; a hole of up to two between true ones belongs to the run."""
    flags = flags.copy()
    for hole in (1, 2):
        for k in np.flatnonzero(flags[: -hole - 1] & flags[hole + 1 :]) if len(flags) > hole + 1 else ():
            flags[k : k + hole + 1] = True
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    return [(int(first), int(last) - 1) for first, last in zip(edges[::2], edges[1::2])]
