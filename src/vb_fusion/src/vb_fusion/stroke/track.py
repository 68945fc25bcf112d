"""Stage 1: which spots are the pointer's.

The pointer is one thing that moves through time. What was seen within a moment and close together is one place; the
track is the sequence of places that explains the most floor with the least effort. In metres:

    gain  = the floor that a place adds: staying and coming back add nothing more, and what is there for longer than
            MAX_DWELL counts less and less, unless its place has a trend over time: then it is a slow hand. Places that are
            passed at one speed add the path between them
    cost  = distance^2 / (time * UNSEEN_SPEED) between places: a gap that was crossed at the speed of a hand is cheap, a
            pause is free. Hands flick, too: beyond a TREMOR the cost grows with the logarithm only, as the likelihood
            of an error with heavy tails does. So a rest behind a flick belongs to the stroke, and a stray does not pay

The best track is found by dynamic programming, place by place in the order of time. The branches that it leaves are
the other strokes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import List, Tuple, Union

import numpy as np
from scipy.spatial import cKDTree

from vb_fusion.stroke.observations import LOCALIZATION_ERROR, TIME_BIN, TREMOR, Observations, time_bins

PLACE_WIDTH = 2.0 * TREMOR  # [m] width of the floor that a place covers
UNSEEN_SPEED = 6.0  # [m/s] at this speed an unseen path costs as much floor as it crosses
MAX_DROPOUTS = 3.0  # usual intervals between moments within which a moving pointer is seen again
MAX_DWELL = 20.0 * TIME_BIN  # [s] a hand seldom rests for longer; a bright thing stays
MAX_CROWD = 3.0  # places of one moment that count in full: the pointer, a bright thing and a stray
SHORTEST_STROKE = 1.5 * PLACE_WIDTH  # [m] of floor that a stroke explains
# places between unseen steps that are more than a stray or a glint, which is seen for a third of a second
LEAST_SEEN = 5
SEEN = 0.04  # [m] what a place gains where light moves: a slow hand is seen there often, a stray once
LOOK_BACK = 40  # places among which a predecessor is looked for: 4 s, less where more than one thing is seen
# places of one moment, the strongest ones: looking back reaches further than a dropout, whatever glitters
MAX_SIMULTANEOUS_PLACES = 10


@dataclass(frozen=True)
class Places:
    """Candidate places of the pointer, ordered by time."""

    points: np.ndarray  # (P, 2) [m]
    stamps: np.ndarray  # (P,) [s]
    bins: np.ndarray  # (P,) int
    cameras: np.ndarray  # (P,) how many cameras saw each
    mobile: np.ndarray  # (P,) bool, seen by no camera that stands still

    @cached_property
    def dropout(self) -> float:
        """[s] within which a moving pointer is seen again: some of the intervals at which these cameras see anything."""
        moments = np.unique(self.bins)
        usual = float(np.median(np.diff(moments))) if len(moments) > 1 else 1.0
        return MAX_DROPOUTS * TIME_BIN * usual


def find_places(seen: Observations) -> Places:
    """Finds the places of each time bin: where cameras saw most, at most MAX_SIMULTANEOUS_PLACES of them."""
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
    mobile = np.bincount(group, ~seen.mobile) == 0
    # equal weights are sums in another order elsewhere
    order = np.lexsort((y, x, -np.round(weights, 6), moment))
    order = order[np.arange(len(order)) - np.searchsorted(moment[order], moment[order]) < MAX_SIMULTANEOUS_PLACES]
    order = order[np.lexsort((y[order], x[order], time[order], moment[order]))]
    cameras = np.bincount(witnesses)
    return Places(np.column_stack([x, y])[order], time[order], moment[order], cameras[order], mobile[order])


def find_strokes(seen: Observations, places: Places, widest_gap: float) -> List[np.ndarray]:
    """Finds the strokes that were drawn; returns the indices of the observations of each, in order of time.

    Args:
        seen: in order of time.
        places: what is at one place in them.
        widest_gap: [m] that may be missing between two places of one stroke.
    """
    points, stamps, dropout = places.points, places.stamps, places.dropout
    _, moment, crowd = np.unique(places.bins, return_inverse=True, return_counts=True)
    # among many things seen at once, each is the less likely the pointer; and a camera that stands still knows better where
    # it is than one on a robot
    trust = np.minimum(1.0, MAX_CROWD / crowd)[moment]
    trust[places.mobile & (np.bincount(moment, ~places.mobile) > 0)[moment]] *= TREMOR / LOCALIZATION_ERROR
    explained = floor_gains(points, stamps, dropout)
    floor = explained * trust
    gain, previous = find_best_steps(places, floor, TREMOR)
    strokes: List[np.ndarray] = []
    free = np.ones(len(points), dtype=bool)
    worth = gain
    while free.any():
        end = int(np.argmax(np.where(free, worth, -np.inf)))
        if worth[end] < SHORTEST_STROKE:
            break
        line = trace_path(end, previous, free)
        free[line] = False
        free[free] = cKDTree(points[line]).query(points[free])[0] > PLACE_WIDTH
        for piece in _divide(line, points[line], stamps[line], explained[line], dropout, widest_gap + TREMOR):
            strokes.append(_beside(seen, places, piece))
            free[_beside(places, places, piece)] = False
        worth = gain - _before_branch(gain, floor, previous, free)
    return strokes


def _divide(
    line: np.ndarray, at: np.ndarray, times: np.ndarray, floor: np.ndarray, dropout: float, widest: float
) -> List[np.ndarray]:
    """Divides a track, the indices of its places, into strokes: where nothing was seen over more than `widest` [m].

    A step is seen if the floor that its two places explain covers it, within a dropout. What is only a few places
    between an unseen step and one after a pause is a stray or a glint, and no stepping stone; a quick hand's rest is not.
    """
    covered = PLACE_WIDTH + np.where(np.diff(times) > dropout, 0.0, floor[:-1] + floor[1:])
    unseen = np.flatnonzero(np.hypot(*np.diff(at, axis=0).T) > covered) + 1
    runs: List[List[np.ndarray]] = []  # of pieces, without a pause between them
    for piece in np.split(np.arange(len(line)), unseen):
        if not runs or times[piece[0]] - times[piece[0] - 1] > dropout:
            runs.append([])
        runs[-1].append(piece)

    def is_stray(piece: np.ndarray) -> bool:
        return len(piece) < LEAST_SEEN and floor[piece].sum() < 0.5 * LEAST_SEEN * PLACE_WIDTH

    for number, run in enumerate(runs):
        while number > 0 and run and is_stray(run[0]):
            del run[0]
        while number < len(runs) - 1 and run and is_stray(run[-1]):
            del run[-1]
    strokes: List[np.ndarray] = []
    for run in filter(None, runs):
        piece = np.concatenate(run)
        if strokes and np.hypot(*(at[piece[0]] - at[strokes[-1][-1]])) <= widest:
            strokes[-1] = np.concatenate([strokes[-1], piece])
        else:
            strokes.append(piece)
    return [line[stroke] for stroke in strokes]


def _beside(seen: Union[Observations, Places], places: Places, line: np.ndarray) -> np.ndarray:
    """Returns the indices of what was seen beside a line, the indices of its places, at its own time.

    The pointer is in one place, so a robot's spot that is off by no more than its localisation error is still the pointer.
    """
    times = places.stamps[line]
    first, last = np.searchsorted(seen.stamps, (times[0] - TIME_BIN, times[-1] + TIME_BIN))
    x, y, mobile = (
        np.interp(seen.stamps[first:last], times, column[line]) for column in (*places.points.T, places.mobile)
    )
    reach = PLACE_WIDTH + LOCALIZATION_ERROR * np.maximum(mobile, seen.mobile[first:last])
    off = np.hypot(*(seen.points[first:last] - np.column_stack([x, y])).T)
    return first + np.flatnonzero(off <= reach)


def _before_branch(gain: np.ndarray, floor: np.ndarray, previous: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Returns what (P,) the best track that ends at each place gained before its first free place in a row."""
    root = np.zeros(len(gain))
    for place, (before, is_free) in enumerate(zip(previous.tolist(), free.tolist())):
        if is_free and before >= 0:
            # the jump to another stroke is not that stroke's price
            root[place] = root[before] if free[before] else gain[place] - floor[place]
    return root


def floor_gains(points: np.ndarray, stamps: np.ndarray, dropout: float) -> np.ndarray:
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
    # along a line, company is on average two thirds of the places in a width: all of them add the line's length
    new = PLACE_WIDTH / np.maximum(1.5 * company, 2.0)
    # a thing that is not seen for longer than a dropout was not there
    there = np.bincount(node[order], np.where(first, TIME_BIN, np.minimum(pause, dropout)))
    moved = np.minimum(1.0, (_moved(points, stamps, shares, node) / PLACE_WIDTH) ** 2)
    still = there * (1.0 - moved)
    moving = SEEN * (moved[node] * shares).reshape(4, -1).sum(axis=0) * np.minimum(1.0, 0.5 * company)
    stay = still[node].reshape(4, -1).max(axis=0)
    gains = (np.maximum(new, _swept(points, stamps, dropout)) + moving) * np.minimum(
        1.0, MAX_DWELL / np.maximum(stay, TIME_BIN)
    ) ** 2
    # in tenths of a millimetre, so that equal places are equal on every computer; never quite nothing
    return np.round(gains, 4) + 1e-5


def _moved(points: np.ndarray, stamps: np.ndarray, shares: np.ndarray, node: np.ndarray) -> np.ndarray:
    """Returns by how much [m] the light at each node moved while it was there: a trend of place over time."""
    total = np.maximum(np.bincount(node, shares), 1e-9)
    t, x, y = (np.tile(values - values.mean(), 4) for values in (stamps, *points.T))
    t = t - (np.bincount(node, shares * t) / total)[node]
    spread = np.bincount(node, shares * t * t)
    # an even movement lasts for the root of 12 standard deviations of its times
    trend = [np.bincount(node, shares * t * axis) for axis in (x, y)]
    return np.sqrt(12.0 / total / np.maximum(spread, 1e-12)) * np.hypot(*trend)


def _swept(points: np.ndarray, times: np.ndarray, dropout: float) -> np.ndarray:
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
            row[(whole > dropout) | (2.0 * way > UNSEEN_SPEED * whole)] = 0.0
            # the row's ends too, where the stroke may begin or end
            for part, much in ((first, 0.5), (at, 1.0), (last, 0.5)):
                swept[part] = np.maximum(swept[part], much * row)
    return swept


def find_best_steps(places: Places, gains: np.ndarray, flick: float) -> Tuple[np.ndarray, np.ndarray]:
    """Finds the best track that ends at each of the places (P, 2) [m].

    The cost of a jump beyond a flick grows with its logarithm.

    Returns:
        (P,) what the track gains [m], and (P,) the place before; -1 where a track begins.
    """
    points, stamps, dropout = places.points, places.stamps, places.dropout
    count = len(points)
    earlier = np.arange(count)[:, None] - np.arange(1, LOOK_BACK + 1)
    origin = np.maximum(earlier, 0)
    way = np.hypot(*(points[:, None] - points[origin]).transpose(2, 0, 1))
    time = stamps[:, None] - stamps[origin]
    possible = (earlier >= 0) & (time > 0.0)
    effort = np.maximum(way - TREMOR, 0.0) ** 2 / (np.clip(time, 1e-9, dropout) * UNSEEN_SPEED)
    effort = flick * np.log1p(effort / flick)
    effort[~possible] = np.inf
    best, previous = gains.copy(), np.full(count, -1)
    for place in range(count):
        value = best[origin[place]] - effort[place]
        chosen = int(value.argmax())
        if value[chosen] > 0.0:
            best[place] += value[chosen]
            previous[place] = origin[place, chosen]
    return best, previous


def trace_path(end: int, previous: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Returns the indices of the places of the track that ends at a place, as far as they are free."""
    before = np.where(free[previous], previous, -1).tolist()
    path = [end]
    while before[path[-1]] >= 0:
        path.append(before[path[-1]])
    return np.array(path[::-1])
