"""Stage 1: which spots are the pointer's.

The pointer is one thing that moves through time. What was seen within a tenth of a second and close together is one
place; the track is the sequence of places that explains the most floor with the least effort. In metres:

    gain  = the floor that a place adds while something is there: staying for long adds nothing more, so that what
            stays, a hand that rests or a bright thing, counts once; coming back counts again
    cost  = distance^2 / (time * BRISK) between places: a jump is expensive, a gap that was crossed at the speed of a
            hand is cheap, a pause is free

The best track is a shortest path: each place is either on the track, or costs the floor that it would have added.
What remains is searched again: a second stroke.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import List, Tuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from vb_fusion.observations import TREMBLE, Sights

MOMENT = 0.1  # [s] a hand's pointer moves by centimetres within it, and cameras with 10 images/s see it
FLOOR = 2.0 * TREMBLE  # [m] width of the floor that a place covers
BRISK = 6.0  # [m/s] at this speed an unseen path costs as much floor as it crosses
BLINK = 3.0 * MOMENT  # [s] a pointer that moves is seen again within it
ABSENCE = 10.0 * MOMENT  # [s] what is seen again after this has come back
STRAY = 0.02  # of the spots of the strongest place of the same moment: the rest of a moment with hundreds of spots
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
        new = (np.diff(group[order]) != 0) | (np.diff(seen.points[order, axis]) > FLOOR)
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
    when = np.empty(len(order), dtype=np.int64)
    when[rank[group]] = moment
    most = np.zeros(int(moment.max()) + 1)
    np.maximum.at(most, when, weights)
    strong = weights >= STRAY * most[when]
    gains = np.zeros(len(order))
    gains[strong] = np.maximum(_new_floor(points[strong], times[strong]), _swept(points[strong], times[strong]))
    return Places(points, seen.stamps[0] + times, gains, rank[group])


def _new_floor(points: np.ndarray, times: np.ndarray) -> np.ndarray:
    """(P,) [m] of floor that each place adds: shared among all that was seen there without an ABSENCE between.

    Places count for the four nodes of a lattice about them, by how near they are: continuous in place.
    """
    scaled = (points - points.min(axis=0)) / FLOOR
    cell = np.floor(scaled).astype(np.int64)
    part = scaled - cell
    stride = int(cell[:, 1].max()) + 2
    corners = [(dx, dy) for dx in (0, 1) for dy in (0, 1)]
    nodes = np.concatenate([(cell[:, 0] + dx) * stride + cell[:, 1] + dy for dx, dy in corners])
    shares = np.concatenate([np.abs(1 - dx - part[:, 0]) * np.abs(1 - dy - part[:, 1]) for dx, dy in corners])
    order = np.lexsort((np.tile(times, 4), nodes))
    visit = np.empty(len(order), dtype=np.int64)
    new = (np.diff(nodes[order]) != 0) | (np.diff(np.tile(times, 4)[order]) > ABSENCE)
    visit[order] = np.concatenate([[0], np.cumsum(new)])
    company = (np.bincount(visit, shares)[visit] * shares).reshape(4, -1).sum(axis=0)
    # a place alone has 4/9 of its own company on average
    return 0.5 * FLOOR / np.maximum(0.75 * company, 1.0)


def _swept(points: np.ndarray, times: np.ndarray) -> np.ndarray:
    """(P,) [m] of floor between a place and its neighbours in time, where the three are passed at one speed.

    A quick hand is seen so seldom that the places alone are less than the line. Strays do not form such rows.
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
            straight = np.exp(-((off / np.maximum(0.3 * way, TREMBLE)) ** 2))
            slow = np.maximum(1.0 - (2.0 * way / np.maximum(BRISK * whole, 1e-9)) ** 4, 0.0)
            row = np.maximum(way - TREMBLE, 0.0) * straight * slow * (whole <= BLINK)
            swept[back:-ahead] = np.maximum(swept[back:-ahead], row)
            # the ends of the row, where the stroke may begin or end
            swept[: -back - ahead] = np.maximum(swept[: -back - ahead], 0.5 * row)
            swept[back + ahead :] = np.maximum(swept[back + ahead :], 0.5 * row)
    return swept


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
        leapt = _leapt_to(places, chosen)
        if leapt.any():
            left = np.setdiff1d(left, chosen[leapt])
            continue
        points, stamps = places.points[chosen], places.stamps[chosen]
        track = Track(points, stamps, _sights_of(seen, points, stamps), gain)
        tracks.append(track)
        free = cKDTree(points).query(places.points[left])[0] > FLOOR
        left = left[free]
    return tracks


def _best_path(places: Places, left: np.ndarray, widest_gap: float) -> Tuple[np.ndarray, float]:
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
    near = (time > 0.0) & ((way <= widest_gap + TREMBLE) | (time <= BLINK))
    later, earlier, way, time = later[near], earlier[near], way[near], time[near]
    effort = np.maximum(way - TREMBLE, 0.0) ** 2 / (np.minimum(time, BLINK) * BRISK)
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


def _leapt_to(places: Places, chosen: np.ndarray) -> np.ndarray:
    """(K,) which places of a track are a rest at its beginning or end that it leaps from or to.

    A hand is about as quick before and after; a step that is far quicker than the next ones of the line, and leads
    to where it rests, leads to something else that is bright.
    """
    leapt = np.zeros(len(chosen), dtype=bool)
    points, stamps = places.points[chosen], places.stamps[chosen]
    ways = np.linalg.norm(np.diff(points, axis=0), axis=1)
    for step in np.flatnonzero(ways > 2.0 * FLOOR):
        for rest, line in (
            (slice(0, step + 1), ways[step + 1 : step + 4]),
            (slice(step + 1, len(chosen)), ways[max(step - 3, 0) : step]),
        ):
            away = np.linalg.norm(points[rest] - points[rest].mean(axis=0), axis=1)
            rests = away.max() < 1.5 * FLOOR and stamps[rest][-1] - stamps[rest][0] > BLINK
            leapt[rest] |= rests and len(line) > 0 and line.max() < 0.4 * ways[step]
    return leapt & ~leapt.all()


def _sights_of(seen: Sights, points: np.ndarray, stamps: np.ndarray) -> np.ndarray:
    """The sights beside the track at their own time."""
    there = np.column_stack([np.interp(seen.stamps, stamps, points[:, k]) for k in range(2)])
    near = np.linalg.norm(seen.points - there, axis=1) <= FLOOR
    near &= (seen.stamps >= stamps[0] - MOMENT) & (seen.stamps <= stamps[-1] + MOMENT)
    return np.flatnonzero(near)
