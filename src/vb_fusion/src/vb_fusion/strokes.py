"""Stage 1: which spots are the pointer's, as strokes, and which strokes make the border's line.

There is one pointer, which moves through time. Observations close together in one time bin form a cluster. A track has
at most one cluster of each time bin. The best track explains the most floor at the least cost.

    time bin   1   2   3   4   5   6   7
    pointer    o---o---o-------o---o---o     each cluster adds new floor; one unseen step costs little
    glint                  x                 jumping there and back would cost more than the floor there is worth
    lamp       #   #   #   #   #   #   #     adds its floor only once

In metres:

    gain = the floor that a cluster covers and no other did. Light that stays longer than MAX_DWELL gains less and less,
           unless its position has a trend over time, as a slow hand's has. Positions passed at constant speed also gain
           the floor between them.
    cost = (distance - TREMOR)^2 / (time * UNSEEN_SPEED) of a step, where a pause longer than a dropout gives no more time

So a gap crossed at the speed of a hand is cheap, and a tremor is free. Hands also flick, and a rest after a flick belongs
to the stroke. So a cost beyond TREMOR grows only logarithmically, like the negative log likelihood of a heavy-tailed error.

Dynamic programming finds the best track, cluster by cluster in order of time. Its time bins and its floor are then
removed. The best track of the rest is the next stroke. The line is the widest stroke and those that continue its ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Sequence, Tuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from vb_core import geometry
from vb_core.errors import CodedError
from vb_fusion.observations import LOCALIZATION_ERROR, MAX_DROPOUTS, TIME_BIN, TREMOR, Observations

CLUSTER_WIDTH = 2.0 * TREMOR  # [m] width of the floor that a cluster covers. A stroke explains at least one
UNSEEN_SPEED = 6.0  # [m/s] at this speed an unseen step costs as much floor as it crosses
MAX_DWELL = 20.0 * TIME_BIN  # [s] a hand seldom rests for longer, but a bright object stays
MAX_CROWD = 3.0  # clusters of one time bin that count in full: the pointer, a bright object and a stray
MIN_SEEN = 5  # clusters. A shorter run between two unseen steps is a stray or a glint, seen for a third of a second
MAX_SIMULTANEOUS_CLUSTERS = 10  # clusters of one time bin, the strongest ones
# clusters among which a predecessor is sought. They span more than a dropout, however much glitters
LOOK_BACK = int(MAX_DROPOUTS + 1.0) * MAX_SIMULTANEOUS_CLUSTERS


@dataclass(frozen=True)
class DrawnLine:
    """The line that becomes the border.

    Attributes:
        line: the line's observations, in the order in which it runs.
        left_out: observations that may have been drawn, but are not part of the line.
        joined: whether several strokes were joined.
        dropout_time: [s] time within which the moving pointer was seen again.
    """

    line: Observations
    left_out: Observations
    joined: bool
    dropout_time: float


def find_drawn_line(observations: Observations, max_gap: float, min_expansion: float, min_spots: int) -> DrawnLine:
    """Finds the line that was drawn among all observations.

    Args:
        observations: observations in order of time.
        max_gap: [m] widest gap that is bridged, within a stroke or between two.
        min_expansion: [m] diagonal of the bounding box of the shortest line.
        min_spots: least number of spots of a line.

    Raises:
        CodedError: "no_line".
    """
    clusters = find_clusters(observations)
    strokes, ends = find_strokes(observations, clusters, max_gap)
    # the strokes that could be a line alone, the widest first. Moving back and forth also explains much floor
    sized = [(geometry.bounding_diagonal(observations.points[stroke]), stroke) for stroke in strokes]
    sized.sort(key=lambda sized_stroke: sized_stroke[0], reverse=True)
    wide = [stroke for size, stroke in sized if size > min_expansion - 2.0 * TREMOR]
    candidates = [stroke for stroke in wide if observations.spots[stroke].sum() >= min_spots]
    if not candidates:
        raise CodedError("no_line", spots=int(observations.spots.sum()), shortest=f"{min_expansion:g}")
    line, unjoined, joined = _join_strokes(observations, candidates, max_gap)
    left_out = np.setdiff1d(np.concatenate([np.zeros(0, dtype=int), *unjoined, *ends]), line)
    return DrawnLine(observations.select(line), observations.select(left_out), joined, clusters.dropout_time)


def find_clusters(observations: Observations) -> Observations:
    """Finds the strongest clusters of each time bin, at most MAX_SIMULTANEOUS_CLUSTERS, in order of time."""
    group = observations.time_bins
    # split at gaps along x, then along y, then along x again
    for axis in (0, 1, 0):
        order = np.lexsort((observations.points[:, axis], group))
        new = (np.diff(group[order]) != 0) | (np.diff(observations.points[order, axis]) > CLUSTER_WIDTH)
        group[order] = np.concatenate([[0], np.cumsum(new)])
    clusters = observations.merge(group)
    x, y = clusters.points.T
    # weights are rounded because another computer may sum equal ones in another order
    strongest_first = np.lexsort((y, x, -np.round(clusters.weights, 6), clusters.time_bins))
    bins = clusters.time_bins[strongest_first]
    rank_in_bin = np.arange(len(bins)) - np.searchsorted(bins, bins)
    return clusters.select(np.sort(strongest_first[rank_in_bin < MAX_SIMULTANEOUS_CLUSTERS]))


def find_strokes(
    observations: Observations, clusters: Observations, max_gap: float
) -> Tuple[List[np.ndarray], List[np.ndarray]]:
    """Finds the strokes that were drawn.

    Args:
        observations: observations in order of time.
        clusters: clusters of these observations, in order of time.
        max_gap: [m] widest gap between two clusters of one stroke.

    Returns:
        The indices of the observations of each stroke, in order of time, and those of each glint before or after them.
        A glint may be the beginning or the end of the drawing, but was seen too seldom to tell.
    """
    points, stamps, bins, dropout = clusters.points, clusters.stamps, clusters.time_bins, clusters.dropout_time
    explained = floor_gains(points, stamps, dropout)
    # a cluster is less likely to be the pointer if many are seen at once, and a stationary camera's pose is known better
    # than that of a camera on a robot
    trust = np.minimum(1.0, MAX_CROWD / np.bincount(bins)[bins])
    trust[clusters.mobile & (np.bincount(bins, ~clusters.mobile) > 0)[bins]] *= TREMOR / LOCALIZATION_ERROR
    gains = explained * trust
    strokes: List[np.ndarray] = []
    ends: List[np.ndarray] = []
    free = np.arange(len(points))
    while gains[free].sum() >= CLUSTER_WIDTH:
        track, gain = find_best_track(points[free], stamps[free], dropout, gains[free], TREMOR)
        if gain < CLUSTER_WIDTH:
            break
        line = free[track]
        pieces, glints = _divide(line, points[line], stamps[line], explained[line], dropout, max_gap + TREMOR)
        if pieces and not strokes:
            ends = [_observations_near(observations, clusters, glint) for glint in glints]
        strokes += [_observations_near(observations, clusters, piece) for piece in pieces]
        # the pointer is at one place at a time, and floor is explained once
        is_taken = np.isin(bins[free], bins[line])
        free = free[~is_taken & (cKDTree(points[line]).query(points[free])[0] > CLUSTER_WIDTH)]
    return strokes, ends


def _divide(
    line: np.ndarray, points: np.ndarray, times: np.ndarray, explained: np.ndarray, dropout: float, widest: float
) -> Tuple[List[np.ndarray], List[np.ndarray]]:
    """Divides a track, the indices of its clusters, into strokes where nothing was seen over more than `widest` [m].

    A step is seen if the floor that its two clusters explain covers it, within a dropout. Few clusters isolated
    between an unseen step and a pause are a stray or a glint and are dropped; a quick hand's rest is kept.

    Returns:
        The strokes, and the glints before the first and after the last of them.
    """
    covered = CLUSTER_WIDTH + np.where(np.diff(times) > dropout, 0.0, explained[:-1] + explained[1:])
    unseen = np.flatnonzero(np.hypot(*np.diff(points, axis=0).T) > covered) + 1
    pieces = np.split(np.arange(len(line)), unseen)
    runs = _drop_short_pieces_beside_pauses(_split_at_pauses(pieces, times, dropout))
    strokes = _join_across_gaps([np.concatenate(run) for run in runs if run], points, widest)
    within = range(strokes[0][0], strokes[-1][-1] + 1) if strokes else range(0)
    # a single cluster is a stray
    glints = [piece for piece in pieces if len(piece) > 1 and piece[0] not in within]
    return [line[stroke] for stroke in strokes], [line[glint] for glint in glints]


def _split_at_pauses(pieces: Sequence[np.ndarray], times: np.ndarray, dropout: float) -> List[List[np.ndarray]]:
    """Splits a track's pieces into runs without a pause."""
    runs: List[List[np.ndarray]] = []
    for piece in pieces:
        if not runs or times[piece[0]] - times[piece[0] - 1] > dropout:
            runs.append([])
        runs[-1].append(piece)
    return runs


def _drop_short_pieces_beside_pauses(runs: Sequence[List[np.ndarray]]) -> List[List[np.ndarray]]:
    """Returns the runs without the strays and glints at their ends: pieces of few clusters next to a pause."""
    kept = []
    for number, run in enumerate(runs):
        long_pieces = [index for index, piece in enumerate(run) if len(piece) >= MIN_SEEN]
        begin = 0 if number == 0 else min(long_pieces, default=len(run))
        end = len(run) if number == len(runs) - 1 else max(long_pieces, default=-1) + 1
        kept.append(run[begin:end])
    return kept


def _join_across_gaps(pieces: Sequence[np.ndarray], points: np.ndarray, widest: float) -> List[np.ndarray]:
    """Joins successive pieces into strokes, unless a gap between them is wider than `widest` [m]."""
    strokes: List[np.ndarray] = []
    for piece in pieces:
        if strokes and np.hypot(*(points[piece[0]] - points[strokes[-1][-1]])) <= widest:
            strokes[-1] = np.concatenate([strokes[-1], piece])
        else:
            strokes.append(piece)
    return strokes


def _observations_near(observations: Observations, clusters: Observations, line: np.ndarray) -> np.ndarray:
    """Returns the indices of the observations beside a line, given as the indices of its clusters, at its own times.

    As there is one pointer, a robot's spot that is off by no more than the localisation error is still the pointer.
    """
    pointer = clusters.select(line)
    began, ended = pointer.stamps[[0, -1]]
    first, last = np.searchsorted(observations.stamps, (began - TIME_BIN, ended + TIME_BIN))
    nearby = observations.select(slice(first, last))
    x, y, mobile = (np.interp(nearby.stamps, pointer.stamps, column) for column in (*pointer.points.T, pointer.mobile))
    reach = CLUSTER_WIDTH + LOCALIZATION_ERROR * np.maximum(mobile, nearby.mobile)
    distances = np.hypot(*(nearby.points - np.column_stack([x, y])).T)
    return first + np.flatnonzero(distances <= reach)


def _join_strokes(
    observations: Observations, strokes: List[np.ndarray], max_gap: float
) -> Tuple[np.ndarray, List[np.ndarray], bool]:
    """Joins to the first stroke those that continue from its ends; strokes are the indices of their observations.

    Returns:
        The line's observations as indices, in the order in which it runs; the strokes left out; whether any was joined.
    """
    line, *others = strokes
    while others:
        # the nearest pair of an end of the line and an end of another stroke
        line_ends = observations.points[line[[0, -1]]]
        distances = np.array([cdist(line_ends, observations.points[other[[0, -1]]]) for other in others])
        number, line_end, other_end = np.unravel_index(int(np.argmin(distances)), distances.shape)
        if distances[number, line_end, other_end] > max_gap + TREMOR:
            break
        # the stroke must run away from the line's end, or up to its start
        other = others.pop(number)
        other = other[::-1] if line_end == other_end else other
        line = np.concatenate([line, other] if line_end else [other, line])
    return line, others, len(others) < len(strokes) - 1


def floor_gains(points: np.ndarray, stamps: np.ndarray, dropout: float) -> np.ndarray:
    """Returns the floor (P,) [m] that each cluster adds. Clusters on the same floor share it."""
    nodes, shares = _lattice_shares(points)
    # the number of clusters at each cluster, itself included, independent of where it lies between the nodes
    crowding = (np.bincount(nodes.ravel(), shares.ravel())[nodes] * shares).sum(axis=0) / (shares**2).sum(axis=0)
    # along a line, this is on average 1.5 times the clusters in a width. Together they then add the line's length
    new = CLUSTER_WIDTH / np.maximum(crowding / 1.5, 2.0)
    longest_stay = _stationary_times(points, stamps, dropout, nodes, shares)[nodes].max(axis=0)
    dwell_factor = np.minimum(1.0, MAX_DWELL / np.maximum(longest_stay, TIME_BIN)) ** 2
    gains = np.maximum(new, _swept(points, stamps, dropout)) * dwell_factor
    # gains are rounded to 0.1 mm, so that equal clusters are equal on every computer, and are never exactly zero
    return np.round(gains, 4) + 1e-5


def _lattice_shares(points: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Shares each cluster among the four lattice nodes round it, bilinearly, so that gains are continuous in position.

    Returns:
        (4, P) the nodes, numbered from 0, and (4, P) their shares of the cluster, which add up to 1.
    """
    scaled = points / CLUSTER_WIDTH
    cell = np.floor(scaled).astype(np.int64)
    part = scaled - cell
    cell -= cell.min(axis=0)
    stride = int(cell[:, 1].max()) + 2
    corners = [(dx, dy) for dx in (0, 1) for dy in (0, 1)]
    keys = [(cell[:, 0] + dx) * stride + cell[:, 1] + dy for dx, dy in corners]
    shares = [np.abs(1 - dx - part[:, 0]) * np.abs(1 - dy - part[:, 1]) for dx, dy in corners]
    return np.unique(keys, return_inverse=True)[1].reshape(4, -1), np.array(shares)


def _stationary_times(
    points: np.ndarray, stamps: np.ndarray, dropout: float, nodes: np.ndarray, shares: np.ndarray
) -> np.ndarray:
    """Returns for how long [s] light stayed at each node. Light that moved on slowly counts less, or not at all.

    `nodes` and `shares` are (4, P), as `_lattice_shares` returns them.
    """
    node, share = nodes.ravel(), shares.ravel()
    time, x, y = (np.tile(values - values.mean(), len(nodes)) for values in (stamps, *points.T))
    order = np.lexsort((time, node))
    is_first = np.append(True, np.diff(node[order]) != 0)
    # light not seen for longer than a dropout was not there
    pauses = np.append(0.0, np.minimum(np.diff(time[order]), dropout))
    lit_times = np.bincount(node[order], np.where(is_first, TIME_BIN, pauses))
    # the distance moved is the slope of a weighted regression of position on time, cov(position, time) / var(time),
    # times the duration. A uniform movement lasts for sqrt(12) standard deviations of its times
    total = np.maximum(np.bincount(node, share), 1e-9)
    deviation = time - (np.bincount(node, share * time) / total)[node]
    variance = np.bincount(node, share * deviation * deviation)
    covariance = np.hypot(*(np.bincount(node, share * deviation * axis) for axis in (x, y)))
    moved = np.sqrt(12.0 / total / np.maximum(variance, 1e-12)) * covariance
    return lit_times * (1.0 - np.minimum(1.0, (moved / CLUSTER_WIDTH) ** 2))


def _swept(points: np.ndarray, times: np.ndarray, dropout: float) -> np.ndarray:
    """Returns the floor (P,) [m] between a cluster and its neighbours in time if the three are passed at one speed.

    A quick hand is seen so seldom that its clusters alone cover less than its line. Strays do not form such rows.
    """
    swept = np.zeros(len(points))
    for back, forth in ((1, 1), (1, 2), (2, 1), (2, 2)):
        before, middle, after = (slice(0, -back - forth), slice(back, -forth), slice(back + forth, None))
        whole = times[after] - times[before]
        share = (times[middle] - times[before]) / np.maximum(whole, 1e-9)
        offset = np.hypot(*(points[before] + share[:, None] * (points[after] - points[before]) - points[middle]).T)
        half_distance = 0.5 * np.hypot(*(points[after] - points[before]).T)
        straight = np.exp(-((offset / np.maximum(0.3 * half_distance, TREMOR)) ** 2))
        # the middle cluster of a row is seen halfway in time. If only two are seen, one of them twice, it is not
        row = np.maximum(half_distance - TREMOR, 0.0) * straight * 4.0 * share * (1.0 - share)
        row[(whole > dropout) | (2.0 * half_distance > UNSEEN_SPEED * whole)] = 0.0
        # the row's ends too, where the stroke may begin or end
        for part, weight in ((before, 0.5), (middle, 1.0), (after, 0.5)):
            swept[part] = np.maximum(swept[part], weight * row)
    return swept


def find_best_track(
    points: np.ndarray, stamps: np.ndarray, dropout: float, gains: np.ndarray, free_jump: float
) -> Tuple[np.ndarray, float]:
    """Finds the track that gains most among clusters (P, 2) [m], given in order of time.

    Beyond `free_jump` [m] the cost of a jump grows only logarithmically.

    Returns:
        The indices of the track's clusters, and its gain [m].
    """
    count = len(points)
    candidates = np.arange(count)[:, None] - np.arange(1, LOOK_BACK + 1)
    predecessor = np.maximum(candidates, 0)
    distance = np.hypot(*(points[:, None] - points[predecessor]).transpose(2, 0, 1))
    time = stamps[:, None] - stamps[predecessor]
    cost = np.maximum(distance - TREMOR, 0.0) ** 2 / (np.clip(time, 1e-9, dropout) * UNSEEN_SPEED)
    cost = free_jump * np.log1p(cost / free_jump)
    cost[(candidates < 0) | (time <= 0.0)] = np.inf
    # the gain less the cost of the best track that ends at each cluster
    totals = gains.copy()
    best_predecessor = np.full(count, -1)
    for cluster in range(count):
        value = totals[predecessor[cluster]] - cost[cluster]
        chosen = int(value.argmax())
        if value[chosen] > 0.0:
            totals[cluster] += value[chosen]
            best_predecessor[cluster] = predecessor[cluster, chosen]
    track = [int(totals.argmax())]
    while best_predecessor[track[-1]] >= 0:
        track.append(int(best_predecessor[track[-1]]))
    return np.array(track[::-1]), float(totals.max())
