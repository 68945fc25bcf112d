"""Stage 1: which spots are the pointer's.

The pointer is one thing that moves through time. What was seen within a moment and close together is one place; the
track is the sequence of places that explains the most floor with the least effort. In metres:

    gain  = the floor that a place adds: staying and coming back add nothing more, and what is there for longer than
            MAX_DWELL counts less and less. Places that are passed at one speed add the path between them
    cost  = distance^2 / (time * UNSEEN_SPEED) between places: a gap that was crossed at the speed of a hand is cheap, a
            pause is free. Hands flick, too: beyond a TREMOR the cost grows with the logarithm only, as the likelihood
            of an error with heavy tails does. So a rest behind a flick belongs to the stroke, and a stray does not pay

The best track is found by dynamic programming, place by place in the order of time. The branches that it leaves are
the other strokes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Tuple

import numpy as np
from scipy.spatial import cKDTree

from vb_fusion.resumable_loop import ResumableLoop
from vb_fusion.stroke.observations import TIME_BIN, TREMOR, Observations, time_bins

PLACE_WIDTH = 2.0 * TREMOR  # [m] width of the floor that a place covers
UNSEEN_SPEED = 6.0  # [m/s] at this speed an unseen path costs as much floor as it crosses
MAX_DROPOUT = 3.0 * TIME_BIN  # [s] within which a moving pointer is seen again
MAX_DWELL = 20.0 * TIME_BIN  # [s] a hand seldom rests for longer; a bright thing stays
LOOK_BACK = 40  # places among which a predecessor is looked for: 4 s, less where more than one thing is seen
# places of one moment, the strongest ones: looking back reaches further than MAX_DROPOUT, whatever glitters
MAX_SIMULTANEOUS_PLACES = 10


@dataclass(frozen=True)
class Places:
    """Candidate places of the pointer, ordered by time."""

    points: np.ndarray  # (P, 2) [m]
    stamps: np.ndarray  # (P,) [s]
    bins: np.ndarray  # (P,) int
    cameras: np.ndarray  # (P,) how many cameras saw each

    def before(self, time_bin: int) -> "Places":
        """Returns the places of earlier time bins."""
        count = int(np.searchsorted(self.bins, time_bin))
        return Places(self.points[:count], self.stamps[:count], self.bins[:count], self.cameras[:count])

    def concatenate(self, others: "Places") -> "Places":
        """Returns these places and then the others."""
        return Places(
            np.vstack([self.points, others.points]),
            np.concatenate([self.stamps, others.stamps]),
            np.concatenate([self.bins, others.bins]),
            np.concatenate([self.cameras, others.cameras]),
        )


@dataclass(frozen=True)
class PointerTrack:
    """One stroke.

    Attributes:
        points: (K, 2) [m] the places of the track, in order of time.
        observations: indices of the observations that belong to it.
        gain: [m] of floor that it explains, less what its jumps cost.
    """

    points: np.ndarray
    observations: np.ndarray
    gain: float


def find_places(seen: Observations) -> Places:
    """Finds the places of each time bin: where cameras saw most, at most a MAX_SIMULTANEOUS_PLACES of them."""
    moment_of = time_bins(seen.stamps)
    group = moment_of.copy()
    # apart where there is a gap along x, then along y, then along x again
    for axis in (0, 1, 0):
        order = np.lexsort((seen.points[:, axis], group))
        new = (np.diff(group[order]) != 0) | (np.diff(seen.points[order, axis]) > PLACE_WIDTH)
        group[order] = np.concatenate([[0], np.cumsum(new)])
    weights = np.bincount(group, seen.weights)
    x, y, time = (np.bincount(group, seen.weights * values) / weights for values in (*seen.points.T, seen.stamps))
    moment = np.empty(len(weights), dtype=np.int64)
    moment[group] = moment_of
    witnesses = np.unique(np.column_stack([group, seen.cameras]), axis=0)[:, 0]
    # equal weights are sums in another order elsewhere
    order = np.lexsort((y, x, -np.round(weights, 6), moment))
    order = order[np.arange(len(order)) - np.searchsorted(moment[order], moment[order]) < MAX_SIMULTANEOUS_PLACES]
    order = order[np.lexsort((y[order], x[order], time[order], moment[order]))]
    return Places(np.column_stack([x, y])[order], time[order], moment[order], np.bincount(witnesses)[order])


def find_tracks(
    seen: Observations, places: Places, widest_gap: float, shortest: float, loop: ResumableLoop
) -> List[PointerTrack]:
    """Finds the strokes that were drawn, the one that explains most first; none if there is none.

    Args:
        seen: in order of time.
        places: what is at one place in them.
        widest_gap: [m] that may be missing between two places of one stroke.
        shortest: [m] of floor that a stroke explains.
        loop: the steps through places that were here before.
    """
    points, stamps = places.points, places.stamps
    gain, previous = find_best_steps(points, stamps, floor_gains(points, stamps), widest_gap, TREMOR, loop)
    tracks: List[PointerTrack] = []
    free = np.ones(len(points), dtype=bool)
    worth = gain
    while len(tracks) < 8 and free.any():
        end = int(np.argmax(np.where(free, worth, -np.inf)))
        if worth[end] < shortest:
            break
        line = trace_path(end, previous, free)
        free[line] = False
        if len(line) > 1:
            tracks.append(PointerTrack(points[line], _beside(seen, points[line], stamps[line]), float(worth[end])))
            free[free] = cKDTree(points[line]).query(points[free])[0] > PLACE_WIDTH
        worth = _from_branch(gain, previous, free)
    return tracks


def _beside(seen: Observations, line: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Returns the indices of the observations beside a line of places at their own time."""
    first, last = np.searchsorted(seen.stamps, (times[0] - TIME_BIN, times[-1] + TIME_BIN))
    there = np.column_stack([np.interp(seen.stamps[first:last], times, axis) for axis in line.T])
    return first + np.flatnonzero(np.hypot(*(seen.points[first:last] - there).T) <= PLACE_WIDTH)


def _from_branch(gain: np.ndarray, previous: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Returns what (P,) the best track that ends at each place gains behind the last place that is not free."""
    root = np.zeros(len(gain))
    for place, (before, is_free) in enumerate(zip(previous.tolist(), free.tolist())):
        if is_free and before >= 0:
            root[place] = root[before] if free[before] else gain[before]
    return gain - root


def floor_gains(points: np.ndarray, stamps: np.ndarray) -> np.ndarray:
    """Returns the floor (P,) [m] that each place adds: all that see the same floor share it.

    Places count for the four nodes of a lattice about them, by how near they are: continuous in place.
    """
    scaled = points / PLACE_WIDTH
    cell = np.floor(scaled).astype(np.int64)
    part = scaled - cell
    cell -= cell.min(axis=0)
    stride = int(cell[:, 1].max()) + 2
    corners = [(dx, dy) for dx in (0, 1) for dy in (0, 1)]
    nodes = np.concatenate([(cell[:, 0] + dx) * stride + cell[:, 1] + dy for dx, dy in corners])
    shares = np.concatenate([np.abs(1 - dx - part[:, 0]) * np.abs(1 - dy - part[:, 1]) for dx, dy in corners])
    order = np.lexsort((np.tile(stamps, 4), nodes))
    pause = np.append(0.0, np.diff(np.tile(stamps, 4)[order]))
    first = np.append(True, np.diff(nodes[order]) != 0)
    node = np.empty(len(order), dtype=np.int64)
    node[order] = np.cumsum(first) - 1
    company = (np.bincount(node, shares)[node] * shares).reshape(4, -1).sum(axis=0)
    # a place alone has, on average, 4/9 of its own company
    new = 0.5 * PLACE_WIDTH / np.maximum(0.75 * company, 1.0)
    # a thing that is not seen for longer than a MAX_DROPOUT was not there
    there = np.bincount(node[order], np.where(first, TIME_BIN, np.minimum(pause, MAX_DROPOUT)))
    stay = there[node].reshape(4, -1).max(axis=0)
    gains = np.maximum(new, _swept(points, stamps)) * np.minimum(1.0, MAX_DWELL / stay) ** 2
    # in tenths of a millimetre, so that what stays for long has got its gain for good; never quite nothing
    return np.round(gains, 4) + 1e-5


def _swept(points: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Returns the floor (P,) [m] between a place and its neighbours in time, where the three are passed at one speed.

    A quick hand is seen so seldom that the places alone are less than the line. Strays do not form such rows.
    """
    swept = np.zeros(len(points))
    for back in (1, 2):
        for ahead in (1, 2):
            first, at, last = (slice(0, -back - ahead), slice(back, -ahead), slice(back + ahead, None))
            whole = times[last] - times[first]
            share = (times[at] - times[first]) / np.maximum(whole, 1e-9)
            off = np.hypot(*(points[first] + share[:, None] * (points[last] - points[first]) - points[at]).T)
            way = 0.5 * np.hypot(*(points[last] - points[first]).T)
            straight = np.exp(-((off / np.maximum(0.3 * way, TREMOR)) ** 2))
            # two places and one of them again are no row: the middle one is in the middle of the time
            row = np.maximum(way - TREMOR, 0.0) * straight * 4.0 * share * (1.0 - share)
            row[(whole > MAX_DROPOUT) | (2.0 * way > UNSEEN_SPEED * whole)] = 0.0
            # the row's ends too, where the stroke may begin or end
            for part, much in ((first, 0.5), (at, 1.0), (last, 0.5)):
                swept[part] = np.maximum(swept[part], much * row)
    return swept


def find_best_steps(
    points: np.ndarray, stamps: np.ndarray, gains: np.ndarray, widest_gap: float, flick: float, loop: ResumableLoop
) -> Tuple[np.ndarray, np.ndarray]:
    """Finds the best track that ends at each of the places (P, 2) [m].

    The cost of a jump beyond a flick grows with its logarithm.

    Returns:
        (P,) what the track gains [m], and (P,) the place before; -1 where a track begins.
    """
    first, states = loop.resume(np.column_stack([points, stamps, gains]), 2)
    count = len(points)
    earlier = np.arange(first, count)[:, None] - np.arange(1, LOOK_BACK + 1)
    origin = np.maximum(earlier, 0)
    way = np.hypot(*(points[first:, None] - points[origin]).transpose(2, 0, 1))
    time = stamps[first:, None] - stamps[origin]
    possible = (earlier >= 0) & (time > 0.0) & ((way <= widest_gap + TREMOR) | (time <= MAX_DROPOUT))
    effort = np.maximum(way - TREMOR, 0.0) ** 2 / (np.clip(time, 1e-9, MAX_DROPOUT) * UNSEEN_SPEED)
    effort = flick * np.log1p(effort / flick)
    effort[~possible] = np.inf
    best = states[:, 0]
    for row, place in enumerate(range(first, count)):
        value = best[origin[row]] - effort[row]
        chosen = int(value.argmax())
        goes_on = value[chosen] > 0.0
        states[place] = gains[place] + (value[chosen] if goes_on else 0.0), origin[row, chosen] if goes_on else -1
    return best, states[:, 1].astype(int)


def trace_path(end: int, previous: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Returns the indices of the places of the track that ends at a place, as far as they are free."""
    before = np.where(free[previous], previous, -1).tolist()
    path = [end]
    while before[path[-1]] >= 0:
        path.append(before[path[-1]])
    return np.array(path[::-1])
