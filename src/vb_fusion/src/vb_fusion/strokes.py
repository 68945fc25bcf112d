"""Stage 1 of extraction.py: which spots are the pointer's, as strokes, and which strokes make the border's line.

There is one pointer, which moves through time. Observations close together in one time bin form a cluster. A track has
at most one cluster of each time bin. The best track covers the most floor at the least cost.

    time bin   1   2   3   4   5   6   7
    pointer    o---o---o-------o---o---o     each cluster adds new floor; one unseen step costs little
    glint                  x                 jumping there and back would cost more than its floor gains
    lamp       #   #   #   #   #   #   #     adds its floor only once

In metres:

    gain = the floor that a cluster covers and no other cluster does. Light that stays longer than MAX_DWELL gains less
           and less, unless its position has a trend over time, as that of a slow hand has: then a cluster gains at least
           MIN_GAIN. Positions passed at constant speed also gain the floor between them.
    cost = (distance - TREMOR)^2 / (time * UNSEEN_SPEED) of a step, where a pause longer than a dropout gives no more time

So a gap crossed at the speed of a hand is cheap, and a tremor is free. Hands also flick, and a stroke goes on after a
flick: a cost beyond TREMOR grows only logarithmically, like the negative log likelihood of a heavy-tailed error.

Dynamic programming finds the best track, cluster by cluster in order of time. Its time bins and its floor are then
removed. The best track of what is left is the next stroke. The line is the widest stroke with those that continue it.
"""

from __future__ import annotations

from typing import List, Sequence, Tuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from vb_core import geometry
from vb_core.errors import CodedError
from vb_fusion.observations import CLUSTER_WIDTH, DROPOUT_FACTOR, LOCALIZATION_ERROR, MAX_SIMULTANEOUS_CLUSTERS
from vb_fusion.observations import TIME_BIN, TREMOR, Observations

UNSEEN_SPEED = 6.0  # [m/s] at this speed an unseen step costs as much floor as it crosses
MAX_DWELL = 20.0 * TIME_BIN  # [s] a hand seldom rests for longer, but a bright object stays
# [m] that a cluster of moving light adds at least. Otherwise a slow line, whose clusters each add millimetres, would be left
# for each stray nearby: its floor would be worth more than the clusters missed meanwhile
MIN_GAIN = 0.02
MAX_CROWD = 3.0  # clusters of one time bin that count in full: the pointer, a bright object and a stray
MIN_SEEN = 5  # clusters. A shorter run between two unseen steps is a stray or a glint, seen for a third of a second
# clusters among which a predecessor is sought. They span more than a dropout, however much glitters
LOOK_BACK = int(DROPOUT_FACTOR + 1.0) * MAX_SIMULTANEOUS_CLUSTERS


def find_drawn_line(
    observations: Observations, clusters: Observations, max_gap: float, min_expansion: float, min_spots: int
) -> Tuple[Observations, Observations, bool]:
    """Finds the line that was drawn among all observations.

    Args:
        observations: observations in order of time.
        clusters: clusters of these observations, in order of time.
        max_gap: [m] widest gap that is bridged, within a stroke or between two.
        min_expansion: [m] diagonal of the bounding box of the shortest line.
        min_spots: least number of spots of a line.

    Returns:
        The line's observations, in the order in which it runs; other observations that may have been drawn; and whether
        several strokes were joined.

    Raises:
        CodedError: "no_line".
    """
    strokes, glints = find_strokes(observations, clusters, max_gap)

    def expansion(stroke: np.ndarray) -> float:
        return geometry.bounding_diagonal(observations.points[stroke])

    # the strokes that could be a line alone
    wide = [stroke for stroke in strokes if expansion(stroke) > min_expansion - 2.0 * TREMOR]
    candidates = [stroke for stroke in wide if observations.spot_counts[stroke].sum() >= min_spots]
    if not candidates:
        raise CodedError("no_line", spots=int(observations.spot_counts.sum()), shortest=f"{min_expansion:g}")
    # the widest stroke is first, not the one that covers most floor: moving back and forth covers much floor too
    candidates.sort(key=expansion, reverse=True)
    line, unjoined = _join_strokes(observations, candidates, max_gap)
    left_out = np.setdiff1d(np.concatenate([line, *unjoined, *glints]), line)
    was_joined = len(unjoined) < len(candidates) - 1
    return observations.select(line), observations.select(left_out), was_joined


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
    points, stamps, bins = clusters.points, clusters.stamps, clusters.time_bins
    dropout = clusters.dropout_time
    covered = floor_gains(points, stamps, dropout)
    # a cluster is less likely to be the pointer if many are seen at once, and a stationary camera's pose is known better
    # than that of a camera on a robot
    trust = np.minimum(1.0, MAX_CROWD / np.bincount(bins)[bins])
    seen_by_stationary = np.bincount(bins, ~clusters.mobile) > 0
    trust[clusters.mobile & seen_by_stationary[bins]] *= TREMOR / LOCALIZATION_ERROR
    gains = covered * trust
    strokes: List[np.ndarray] = []
    end_glints: List[np.ndarray] = []
    free = np.arange(len(points))
    while gains[free].sum() >= CLUSTER_WIDTH:
        track, gain = find_best_track(points[free], stamps[free], dropout, gains[free], TREMOR)
        if gain < CLUSTER_WIDTH:
            break  # a stroke covers at least the width of one cluster
        pointer = clusters.select(free[track])
        pieces, glints = divide_track(pointer, covered[free[track]], dropout, max_gap + TREMOR)
        if pieces and not strokes:
            end_glints = [find_observations_near(observations, pointer.select(glint)) for glint in glints]
        strokes += [find_observations_near(observations, pointer.select(piece)) for piece in pieces]
        # the pointer makes one cluster per time bin, and no floor is covered twice
        is_taken = np.isin(bins[free], pointer.time_bins)
        distances = cKDTree(pointer.points).query(points[free])[0]
        free = free[~is_taken & (distances > CLUSTER_WIDTH)]
    return strokes, end_glints


def divide_track(
    track: Observations, covered: np.ndarray, dropout: float, max_gap: float
) -> Tuple[List[np.ndarray], List[np.ndarray]]:
    """Divides a track of P clusters into strokes where nothing was seen over more than `max_gap` [m].

    A step is seen if it is no longer than a cluster's width and the floor `covered` (P,) [m] by its clusters. Across a
    pause longer than a dropout [s], that floor does not count. A few clusters between an unseen step and a pause are a
    stray or a glint, and are dropped. Between unseen steps they are what was seen of a quick hand, and are kept.

    Returns:
        The clusters of each stroke, and those of each glint before the first and after the last of them, as indices.
    """
    steps = np.linalg.norm(np.diff(track.points, axis=0), axis=1)
    is_pause = np.diff(track.stamps) > dropout
    floor = np.where(is_pause, 0.0, covered[:-1] + covered[1:])
    unseen = np.flatnonzero(steps > CLUSTER_WIDTH + floor) + 1
    pieces = np.split(np.arange(len(covered)), unseen)
    runs = _drop_short_pieces_beside_pauses(pieces, is_pause)
    strokes = _join_across_gaps(runs, track.points, max_gap)
    within = range(strokes[0][0], strokes[-1][-1] + 1) if strokes else range(0)
    # a single cluster is a stray
    glints = [piece for piece in pieces if len(piece) > 1 and piece[0] not in within]
    return strokes, glints


def _drop_short_pieces_beside_pauses(pieces: Sequence[np.ndarray], is_pause: np.ndarray) -> List[np.ndarray]:
    """Joins the pieces between two pauses, without strays and glints at their ends: pieces of few clusters."""
    runs: List[List[np.ndarray]] = [[]]
    for piece in pieces:
        if piece[0] > 0 and is_pause[piece[0] - 1]:
            runs.append([])
        runs[-1].append(piece)
    for run in runs[1:]:
        while run and len(run[0]) < MIN_SEEN:
            run.pop(0)
    for run in runs[:-1]:
        while run and len(run[-1]) < MIN_SEEN:
            run.pop()
    return [np.concatenate(run) for run in runs if run]


def _join_across_gaps(pieces: Sequence[np.ndarray], points: np.ndarray, max_gap: float) -> List[np.ndarray]:
    """Joins successive pieces into strokes, unless a gap between them is wider than `max_gap` [m]."""
    strokes: List[np.ndarray] = []
    for piece in pieces:
        gap = np.hypot(*(points[piece[0]] - points[strokes[-1][-1]])) if strokes else np.inf
        if gap <= max_gap:
            strokes[-1] = np.concatenate([strokes[-1], piece])
        else:
            strokes.append(piece)
    return strokes


def find_observations_near(observations: Observations, pointer: Observations) -> np.ndarray:
    """Returns the indices of the observations beside the pointer's clusters, at their times.

    As there is one pointer, a robot's spot that is off by no more than the localisation error is still the pointer.
    """
    began, ended = pointer.stamps[[0, -1]]
    nearby = slice(*np.searchsorted(observations.stamps, (began - TIME_BIN, ended + TIME_BIN)))
    times = observations.stamps[nearby]
    x = np.interp(times, pointer.stamps, pointer.points[:, 0])
    y = np.interp(times, pointer.stamps, pointer.points[:, 1])
    mobile = np.maximum(np.interp(times, pointer.stamps, pointer.mobile), observations.mobile[nearby])
    reach = CLUSTER_WIDTH + LOCALIZATION_ERROR * mobile
    distances = np.hypot(observations.points[nearby, 0] - x, observations.points[nearby, 1] - y)
    return nearby.start + np.flatnonzero(distances <= reach)


def _join_strokes(
    observations: Observations, strokes: List[np.ndarray], max_gap: float
) -> Tuple[np.ndarray, List[np.ndarray]]:
    """Joins to the first stroke those that continue from its ends; strokes are the indices of their observations.

    Returns:
        The line's observations as indices, in the order in which it runs, and the strokes left out.
    """
    line, *others = strokes
    while others:
        # the nearest pair of an end of the line and an end of another stroke
        line_ends = observations.points[line[[0, -1]]]
        other_ends = [observations.points[other[[0, -1]]] for other in others]
        distances = np.array([cdist(line_ends, ends) for ends in other_ends])
        number, line_end, other_end = np.unravel_index(int(np.argmin(distances)), distances.shape)
        if distances[number, line_end, other_end] > max_gap + TREMOR:
            break
        # the stroke must run away from the line's end, or up to its start
        other = others.pop(number)
        if line_end == other_end:
            other = other[::-1]
        line = np.concatenate([line, other] if line_end else [other, line])
    return line, others


def floor_gains(points: np.ndarray, stamps: np.ndarray, dropout: float) -> np.ndarray:
    """Returns the floor (P,) [m] that each cluster adds. Clusters on the same floor share it."""
    nodes, shares = _lattice_shares(points)
    # how many clusters are at each cluster, itself included, wherever it lies between the nodes
    clusters_at_node = np.bincount(nodes.ravel(), shares.ravel())
    crowding = (clusters_at_node[nodes] * shares).sum(axis=0) / (shares**2).sum(axis=0)
    # along a line, this is on average 1.5 times the number of clusters in a width. Together they then add its length
    new = CLUSTER_WIDTH / np.maximum(crowding / 1.5, 2.0)
    lit_times, moved = _light_at_nodes(points, stamps, dropout, nodes, shares)
    new = np.maximum(new, MIN_GAIN * (moved[nodes] * shares).sum(axis=0))
    longest_stay = np.maximum((lit_times * (1.0 - moved))[nodes].max(axis=0), TIME_BIN)
    dwell_factor = np.minimum(1.0, MAX_DWELL / longest_stay) ** 2
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
    corners = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])[:, None]
    shares = np.abs(1.0 - corners - part).prod(axis=2)
    column, row = np.moveaxis(cell - cell.min(axis=0) + corners, 2, 0)
    keys = column * (int(row.max()) + 1) + row
    nodes = np.unique(keys, return_inverse=True)[1].reshape(4, -1)
    return nodes, shares


def _light_at_nodes(
    points: np.ndarray, stamps: np.ndarray, dropout: float, nodes: np.ndarray, shares: np.ndarray
) -> Tuple[np.ndarray, np.ndarray]:
    """Returns for how long [s] each node was lit, and how far its light moved on: 0 for not at all, 1 for a width or more.

    The distance that it moved is the slope of a weighted regression of position on time, cov(position, time) / var(time),
    times the duration. `nodes` and `shares` are (4, P), as `_lattice_shares` returns them.
    """
    node, share = nodes.ravel(), shares.ravel()
    time = np.tile(stamps - stamps.mean(), len(nodes))
    x, y = np.tile((points - points.mean(axis=0)).T, len(nodes))
    order = np.lexsort((time, node))
    is_first = np.append(True, np.diff(node[order]) != 0)
    # light not seen for longer than a dropout was not there
    pauses = np.append(0.0, np.minimum(np.diff(time[order]), dropout))
    lit_times = np.bincount(node[order], np.where(is_first, TIME_BIN, pauses))
    total = np.maximum(np.bincount(node, share), 1e-9)
    deviation = time - (np.bincount(node, share * time) / total)[node]
    variance = np.bincount(node, share * deviation * deviation)
    covariance_x = np.bincount(node, share * deviation * x)
    covariance_y = np.bincount(node, share * deviation * y)
    # a uniform movement lasts for sqrt(12) standard deviations of its times
    duration_over_variance = np.sqrt(12.0 / total / np.maximum(variance, 1e-12))
    moved = duration_over_variance * np.hypot(covariance_x, covariance_y)
    return lit_times, np.minimum(1.0, (moved / CLUSTER_WIDTH) ** 2)


def _swept(points: np.ndarray, times: np.ndarray, dropout: float) -> np.ndarray:
    """Returns the floor (P,) [m] between a cluster and its neighbours in time if the three are passed at one speed.

    A quick hand is seen so seldom that its clusters alone cover less than its line. Strays do not form such rows.
    """
    swept = np.zeros(len(points))
    for back, forth in ((1, 1), (1, 2), (2, 1), (2, 2)):
        before = slice(0, -back - forth)
        middle = slice(back, -forth)
        after = slice(back + forth, None)
        duration = times[after] - times[before]
        share = (times[middle] - times[before]) / np.maximum(duration, 1e-9)
        chord = points[after] - points[before]
        offset = points[before] + share[:, None] * chord - points[middle]
        distance = np.hypot(chord[:, 0], chord[:, 1])
        deviation = np.hypot(offset[:, 0], offset[:, 1])
        straight = np.exp(-((deviation / np.maximum(0.15 * distance, TREMOR)) ** 2))
        # the middle cluster of a row is seen halfway in time. If only two are seen, one of them twice, it is not
        halfway = 4.0 * share * (1.0 - share)
        row = np.maximum(0.5 * distance - TREMOR, 0.0) * straight * halfway
        is_too_fast = distance > UNSEEN_SPEED * duration
        row[(duration > dropout) | is_too_fast] = 0.0
        # the row's ends gain floor too, because the stroke may begin or end there
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
    beyond_tremor = np.maximum(distance - TREMOR, 0.0)
    cost = beyond_tremor**2 / (np.clip(time, 1e-9, dropout) * UNSEEN_SPEED)
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
