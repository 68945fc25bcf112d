"""Stage 1: which spots are the pointer's.

The pointer is one thing that moves through time. What was seen within a tenth of a second and close together is one
place; the track is the sequence of places that explains the most floor with the least effort. In metres:

    gain  = the floor that a place adds while something is there: staying adds nothing more, and what stays for
            longer than an ABSENCE counts less and less, a hand that rests and a bright thing alike; coming back
            counts again
    cost  = distance^2 / (time * BRISK) between places: a jump is expensive, a gap that was crossed at the speed of a
            hand is cheap, a pause is free

The best track is found by dynamic programming, place by place in the order of time. What remains is searched again:
a second stroke.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import List, Tuple

import numpy as np
from scipy.spatial import cKDTree

from vb_fusion.stroke.observations import TREMBLE, Sights

MOMENT = 0.1  # [s] a hand's pointer moves by centimetres within it, and cameras with 10 images/s see it
FLOOR = 2.0 * TREMBLE  # [m] width of the floor that a place covers
BRISK = 6.0  # [m/s] at this speed an unseen path costs as much floor as it crosses
BLINK = 3.0 * MOMENT  # [s] a pointer that moves is seen again within it
ABSENCE = 20.0 * MOMENT  # [s] what is seen again after this has come back, and what is seen for longer stays
STRAY = 0.02  # of the spots of the strongest place of the same moment: the rest of a moment with hundreds of spots
LOOK_BACK = 40  # places among which a predecessor is looked for: 4 s, less where more than one thing is seen


@dataclass(frozen=True)
class Places:
    """What was seen in each moment; ordered by time."""

    points: np.ndarray  # (P, 2) [m]
    stamps: np.ndarray  # (P,) [s]
    sights: np.ndarray  # (N,) index of each sight's place


@dataclass(frozen=True)
class Track:
    """One stroke.

    Attributes:
        points: (K, 2) [m] the places of the track, in order of time.
        sights: indices of the sights that belong to it.
        gain: [m] of floor that it explains, less what its jumps cost.
    """

    points: np.ndarray
    sights: np.ndarray
    gain: float


def find_tracks(seen: Sights, widest_gap: float, shortest: float) -> List[Track]:
    """The strokes that were drawn, the one that explains most first; empty if there is none.

    Args:
        seen: in order of time.
        widest_gap: [m] that may be missing between two places of one stroke.
        shortest: [m] of floor that a stroke explains.
    """
    places = find_places(seen)
    weights = np.bincount(places.sights, seen.weights)
    moment = ((places.stamps - places.stamps[0]) / MOMENT).astype(np.int64)
    strongest = np.zeros(int(moment[-1]) + 1)
    np.maximum.at(strongest, moment, weights)
    strong = weights >= STRAY * strongest[moment]
    points, stamps = places.points[strong], places.stamps[strong]
    gains = _gains(points, stamps)
    left = np.arange(len(points))
    tracks: List[Track] = []
    while len(left) >= 2 and len(tracks) < 8:
        chosen, gain = best_path(points[left], stamps[left], gains[left], widest_gap)
        if gain < shortest or len(chosen) < 2:
            break
        line, times = points[left[chosen]], stamps[left[chosen]]
        # the sights beside the track at their own time
        there = np.column_stack([np.interp(seen.stamps, times, line[:, axis]) for axis in range(2)])
        near = np.linalg.norm(seen.points - there, axis=1) <= FLOOR
        near &= (seen.stamps >= times[0] - MOMENT) & (seen.stamps <= times[-1] + MOMENT)
        tracks.append(Track(line, np.flatnonzero(near), gain))
        left = left[cKDTree(line).query(points[left])[0] > FLOOR]
    return tracks


def find_places(seen: Sights) -> Places:
    """The places of each moment."""
    group = np.floor((seen.stamps - seen.stamps[0]) / MOMENT + 0.0031).astype(np.int64)
    # apart where there is a gap along x, then along y, then along x again
    for axis in (0, 1, 0):
        order = np.lexsort((seen.points[:, axis], group))
        new = (np.diff(group[order]) != 0) | (np.diff(seen.points[order, axis]) > FLOOR)
        group[order] = np.concatenate([[0], np.cumsum(new)])
    weights = np.bincount(group, seen.weights)
    x, y, time = (
        np.bincount(group, seen.weights * values) / weights for values in (*seen.points.T, seen.stamps - seen.stamps[0])
    )
    order = np.lexsort((y, x, time))
    rank = np.argsort(order)
    return Places(np.column_stack([x, y])[order], seen.stamps[0] + time[order], rank[group])


def _gains(points: np.ndarray, stamps: np.ndarray) -> np.ndarray:
    """(P,) [m] of floor that each place adds: that of a visit is shared by all places without an ABSENCE between them.

    Places count for the four nodes of a lattice about them, by how near they are: continuous in place.
    """
    scaled = (points - points.min(axis=0)) / FLOOR
    cell = np.floor(scaled).astype(np.int64)
    part = scaled - cell
    stride = int(cell[:, 1].max()) + 2
    corners = [(dx, dy) for dx in (0, 1) for dy in (0, 1)]
    nodes = np.concatenate([(cell[:, 0] + dx) * stride + cell[:, 1] + dy for dx, dy in corners])
    shares = np.concatenate([np.abs(1 - dx - part[:, 0]) * np.abs(1 - dy - part[:, 1]) for dx, dy in corners])
    order = np.lexsort((np.tile(stamps, 4), nodes))
    times = np.tile(stamps, 4)[order]
    first = np.append(True, (np.diff(nodes[order]) != 0) | (np.diff(times) > ABSENCE))
    visit = np.empty(len(order), dtype=np.int64)
    visit[order] = np.cumsum(first) - 1
    company = (np.bincount(visit, shares)[visit] * shares).reshape(4, -1).sum(axis=0)
    # a place alone has 4/9 of its own company on average
    new = 0.5 * FLOOR / np.maximum(0.75 * company, 1.0)
    longest = MOMENT * np.bincount(visit)[visit].reshape(4, -1).max(axis=0)
    return np.maximum(new, _swept(points, stamps)) * np.minimum(1.0, ABSENCE / np.maximum(longest, 1e-9)) ** 2


def _swept(points: np.ndarray, times: np.ndarray) -> np.ndarray:
    """(P,) [m] of floor between a place and its neighbours in time, where the three are passed at one speed.

    A quick hand is seen so seldom that the places alone are less than the line. Strays do not form such rows.
    """
    swept = np.zeros(len(points))
    for back in (1, 2):
        for ahead in (1, 2):
            first, at, last = (slice(0, -back - ahead), slice(back, -ahead), slice(back + ahead, None))
            whole = times[last] - times[first]
            share = (times[at] - times[first]) / np.maximum(whole, 1e-9)
            off = np.linalg.norm(points[first] + share[:, None] * (points[last] - points[first]) - points[at], axis=1)
            way = 0.5 * np.linalg.norm(points[last] - points[first], axis=1)
            straight = np.exp(-((off / np.maximum(0.3 * way, TREMBLE)) ** 2))
            row = np.maximum(way - TREMBLE, 0.0) * straight * 4.0 * share * (1.0 - share) * (whole <= BLINK)
            # the row's ends too, where the stroke may begin or end
            for part, much in ((first, 0.5), (at, 1.0), (last, 0.5)):
                swept[part] = np.maximum(swept[part], much * row)
    return swept


def best_path(
    points: np.ndarray, stamps: np.ndarray, gains: np.ndarray, widest_gap: float, dearest: float = np.inf
) -> Tuple[np.ndarray, float]:
    """Indices of the places (P, 2) [m] of the best track, and what it gains; no jump costs more than the dearest."""
    count = len(points)
    earlier = np.arange(count)[:, None] - np.arange(1, LOOK_BACK + 1)
    origin = np.maximum(earlier, 0)
    way = np.linalg.norm(points[:, None] - points[origin], axis=2)
    time = stamps[:, None] - stamps[origin]
    possible = (earlier >= 0) & (time > 0.0) & ((way <= widest_gap + TREMBLE) | (time <= BLINK))
    effort = np.maximum(way - TREMBLE, 0.0) ** 2 / (np.clip(time, 1e-9, BLINK) * BRISK)
    effort = np.minimum(effort, dearest)
    effort[~possible] = np.inf
    best, previous = gains.copy(), np.full(count, -1)
    for place in range(count):
        value = best[origin[place]] - effort[place]
        chosen = int(np.argmax(value))
        if value[chosen] > 0.0:
            best[place] += value[chosen]
            previous[place] = origin[place, chosen]
    path = [int(np.argmax(best))]
    while previous[path[-1]] >= 0:
        path.append(int(previous[path[-1]]))
    return np.array(path[::-1]), float(best.max())
