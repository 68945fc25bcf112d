"""Stage 1: which spots are the pointer's.

The pointer is one thing that moves through time. What was seen within a tenth of a second and close together is one
place; the track is the sequence of places that explains the most floor with the least effort. In metres:

    gain  = the floor that a place adds (a place that is seen for long, or again, adds nothing more)
    cost  = way^2 / (time * BRISK) between two places: a jump is expensive, a gap that was crossed at the speed of a
            hand is cheap, a pause is free

The best track is a shortest path: each place is either on the track, or costs the floor that it would have added.
What remains is searched again: a second stroke.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import List

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from vb_fusion.observations import Sights

MOMENT = 0.1  # [s] a hand's pointer moves by centimetres within it, and cameras with 10 images/s see it
TOGETHER = 0.12  # [m] sights of one moment that are no farther apart are one place
FLOOR = 0.1  # [m] radius of the floor that a place stands for
BRISK = 6.0  # [m/s] at this speed unseen way costs as much floor as it crosses
BLINK = 0.3  # [s] a pointer that moves is seen again within it
SLACK = 0.06  # [m] of two sights of one thing: cameras disagree, hands tremble
BESIDE = 0.15  # [m] a sight so near to the track at its time belongs to it
STRAY = 0.02  # of the spots of the strongest place of the same moment
LOOK_BACK = 40  # places among which a predecessor is looked for: 4 s, less where more than one thing is seen


@dataclass(frozen=True)
class Places:
    """What was seen in each moment; ordered by time."""

    points: np.ndarray  # (P, 2) [m]
    stamps: np.ndarray  # (P,) [s]
    gains: np.ndarray  # (P,) [m] of floor
    sights: np.ndarray  # (N,) index of each sight's place


@dataclass(frozen=True)
class Track:
    """One stroke.

    Attributes:
        points: (K, 2) [m] the places of the track, in order of time.
        stamps: (K,) [s], strictly ascending.
        sights: indices of the sights that belong to it.
        gain: [m] of floor that it explains, less what its jumps cost.
    """

    points: np.ndarray
    stamps: np.ndarray
    sights: np.ndarray
    gain: float


def find_places(seen: Sights) -> Places:
    """The places of each moment, and the floor that each adds."""
    moment = np.floor((seen.stamps - seen.stamps[0]) / MOMENT + 0.0031).astype(np.int64)
    group = moment
    # apart where there is a gap along x, then along y, then along x again
    for axis in (0, 1, 0):
        order = np.lexsort((seen.points[:, axis], group))
        step = np.diff(seen.points[order, axis])
        new = (np.diff(group[order]) != 0) | (step > TOGETHER)
        group = np.empty(len(order), dtype=np.int64)
        group[order] = np.concatenate([[0], np.cumsum(new)])
    weights = np.bincount(group, seen.weights)
    x, y, t = (
        np.bincount(group, seen.weights * v) / weights
        for v in (seen.points[:, 0], seen.points[:, 1], seen.stamps - seen.stamps[0])
    )
    order = np.lexsort((y, x, t))
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    points, times, weights = np.column_stack([x, y])[order], t[order], weights[order]
    # where a moment holds hundreds of spots, a place that has one of them is a stray
    when = np.empty(len(order), dtype=np.int64)
    when[rank[group]] = moment
    most = np.zeros(int(moment.max()) + 1)
    np.maximum.at(most, when, weights)
    strong = weights >= STRAY * most[when]
    gains = np.zeros(len(order))
    gains[strong] = _gains(points[strong], times[strong], weights[strong])
    return Places(points, seen.stamps[0] + times, gains, rank[group])


def _gains(points: np.ndarray, times: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(P,) [m] of floor that each place adds.

    The floor about a place is shared among all moments in which it was seen. It counts little if, in these moments,
    much more floor was seen elsewhere: the pointer cannot be in two places, so what stays while the pointer moves is
    something else that is bright.
    """
    nearby = _Lattice(points)
    floor = 1.5 * FLOOR / np.maximum(nearby.total(np.ones(len(points))), 3.0)
    gains = floor * np.minimum(1.0, weights / _weighted_median(weights, floor))
    gains = np.maximum(gains, _swept(points, times))
    elsewhere = np.zeros(len(points))
    for lag in range(1, 6):
        at_once = (times[lag:] - times[:-lag] <= MOMENT) & (
            np.linalg.norm(points[lag:] - points[:-lag], axis=1) > TOGETHER + BRISK * (times[lag:] - times[:-lag])
        )
        elsewhere[lag:] += at_once * gains[:-lag]
        elsewhere[:-lag] += at_once * gains[lag:]
    rival = nearby.total(elsewhere) / nearby.total(gains)
    return gains / (1.0 + 0.25 * rival**2)


def _weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    order = np.argsort(values, kind="stable")
    summed = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(summed, 0.5 * summed[-1])]])


def _swept(points: np.ndarray, times: np.ndarray) -> np.ndarray:
    """(P,) [m] of floor between a place and its neighbours in time, where the three are passed at one speed.

    A quick hand is seen so seldom that the places alone are less than the line. Strays do not lie in such rows.
    """
    swept = np.zeros(len(points))
    for back in (1, 2):
        for ahead in (1, 2):
            if len(points) <= back + ahead:
                continue
            first, at, last = points[: -back - ahead], points[back:-ahead], points[back + ahead :]
            whole = times[back + ahead :] - times[: -back - ahead]
            share = (times[back:-ahead] - times[: -back - ahead]) / np.maximum(whole, 1e-9)
            off = np.linalg.norm(first + share[:, None] * (last - first) - at, axis=1)
            way = np.linalg.norm(last - first, axis=1) / 2.0
            straight = np.exp(-((off / np.maximum(0.3 * way, SLACK)) ** 2))
            slow = np.maximum(1.0 - (2.0 * way / np.maximum(BRISK * whole, 1e-9)) ** 4, 0.0)
            row = np.maximum(way - SLACK, 0.0) * straight * slow * (whole <= BLINK)
            swept[back:-ahead] = np.maximum(swept[back:-ahead], row)
    return swept


class _Lattice:
    """Sums of what lies within about FLOOR, by a tent about each point of a square lattice: continuous in place."""

    def __init__(self, points: np.ndarray) -> None:
        scaled = (points - points.min(axis=0)) / FLOOR
        cell = np.floor(scaled).astype(np.int64)
        part = scaled - cell
        stride = int(cell[:, 1].max()) + 2
        keys, shares = [], []
        for dx in (0, 1):
            for dy in (0, 1):
                keys.append((cell[:, 0] + dx) * stride + cell[:, 1] + dy)
                shares.append(np.abs(1 - dx - part[:, 0]) * np.abs(1 - dy - part[:, 1]))
        self._shares = np.concatenate(shares)
        self._nodes = np.unique(np.concatenate(keys), return_inverse=True)[1]

    def total(self, values: np.ndarray) -> np.ndarray:
        """The sum of values (P,) about each point; a point alone counts itself once in the mean."""
        at_node = np.bincount(self._nodes, np.tile(values, 4) * self._shares)
        return 2.25 * (at_node[self._nodes] * self._shares).reshape(4, -1).sum(axis=0)


def find_tracks(seen: Sights, widest_gap: float, shortest: float) -> List[Track]:
    """The strokes that were drawn, the one that explains most first; empty if there is none.

    Args:
        seen: in order of time.
        widest_gap: [m] that may be missing between two places of one stroke.
        shortest: [m] of floor that a stroke explains.
    """
    places = find_places(seen)
    left = np.flatnonzero(places.gains > 0.0)
    tracks: List[Track] = []
    while len(left) >= 2 and len(tracks) < 8:
        chosen, gain = _best_path(places, left, widest_gap)
        if gain < shortest or len(chosen) < 2:
            break
        chosen = _without_leaps(places, chosen)
        points, stamps = places.points[chosen], places.stamps[chosen]
        track = Track(points, stamps, _sights_of(seen, points, stamps), gain)
        tracks.append(track)
        free = cKDTree(points).query(places.points[left])[0] > BESIDE
        left = left[free]
    return tracks


def _best_path(places: Places, left: np.ndarray, widest_gap: float):
    """Indices of the places of the best track among those left, and its gain [m]."""
    points, stamps, gains = places.points[left], places.stamps[left], places.gains[left]
    count = len(left)
    before = np.concatenate([[0.0], np.cumsum(gains)])  # gains of all places before each
    later = np.repeat(np.arange(count), LOOK_BACK)
    earlier = later - np.tile(np.arange(1, LOOK_BACK + 1), count)
    inside = earlier >= 0
    later, earlier = later[inside], earlier[inside]
    way = np.linalg.norm(points[later] - points[earlier], axis=1)
    time = stamps[later] - stamps[earlier]
    near = (time > 0.0) & ((way <= widest_gap + SLACK) | (time <= BLINK))
    later, earlier, way, time = later[near], earlier[near], way[near], time[near]
    effort = np.maximum(way - SLACK, 0.0) ** 2 / (time * BRISK)
    skipped = before[later] - before[earlier + 1]
    source, sink = count, count + 1
    every = np.arange(count)
    rows = np.concatenate([earlier, np.full(count, source), every])
    columns = np.concatenate([later, every, np.full(count, sink)])
    costs = np.concatenate([effort + skipped, before[:-1], before[-1] - before[1:]])
    # a sparse matrix drops edges that cost nothing
    graph = csr_matrix((np.maximum(costs, 0.0) + 1e-12, (rows, columns)), shape=(count + 2, count + 2))
    cost, previous = dijkstra(graph, indices=source, return_predecessors=True)
    chosen = []
    place = int(previous[sink])
    while place != source:
        chosen.append(place)
        place = int(previous[place])
    return left[chosen[::-1]], float(before[-1] - cost[sink])


def _without_leaps(places: Places, chosen: np.ndarray) -> np.ndarray:
    """The track without ends that it leaps to: a still thing beside the line that was bright before or after.

    A hand gets up speed and is seen while it does; a leap is one step that is far longer than the next one of the
    line, to an end that covers less floor than the leap does.
    """
    for _ in range(2):
        points = places.points[chosen]
        ways = np.linalg.norm(np.diff(points, axis=0), axis=1)
        for step in np.flatnonzero(ways > 2.0 * TOGETHER)[::-1]:
            line = ways[step + 1 : step + 4]
            end, rest = (3.0 * np.linalg.norm(part.std(axis=0)) for part in (points[: step + 1], points[step + 1 :]))
            if len(line) and line.max() < 0.4 * ways[step] and end < min(ways[step], rest):
                chosen = chosen[step + 1 :]
                break
        chosen = chosen[::-1]
    return chosen


def _sights_of(seen: Sights, points: np.ndarray, stamps: np.ndarray) -> np.ndarray:
    """The sights beside the track at their own time."""
    there = np.column_stack([np.interp(seen.stamps, stamps, points[:, k]) for k in range(2)])
    near = np.linalg.norm(seen.points - there, axis=1) <= BESIDE
    near &= (seen.stamps >= stamps[0] - MOMENT) & (seen.stamps <= stamps[-1] + MOMENT)
    return np.flatnonzero(near)
