"""Density must not outweigh geometry: a spot held still, and bright things that a camera takes for the spot.

A piece of paper on the floor is reported at one place for as long as it is seen, a thousand times while a stroke is
drawn with two hundred spots. There is one pointer only: a place that is reported while the pointer is seen to move
about elsewhere, nearer in time than it could travel, is not the pointer. What has no stamps, and a person who holds
the spot still at a corner, is met by a bound on what any small piece of the floor weighs.
"""
from __future__ import annotations

from typing import List, Tuple

import numpy as np

from vb_fusion.clustering import cell_keys, dbscan
from vb_fusion.observations import FASTEST, Observations, nearest_in

CELL = 0.05  # [m] pieces of the floor whose weight is bounded
HEAVIEST = 3.0  # a piece weighs at most as much as so many usual ones: a corner, a crossing, a slow stretch
LEAST_BOUND = 5.0  # weights up to this are never bounded
PLACE = 0.15  # [m] radius of a place; a camera's noise and a robot's localisation stay within
CANDIDATES = 6  # densest places that are looked at
MOST_PLACES = 6  # bright things on one floor
EXAMINED = 2500  # spots, evenly chosen in time
MIN_RIVALS = 10  # spots elsewhere at the same time
COMPANY = 0.15  # [m] between the sights of a pointer that moves; rivals without company are strays themselves
MOVED = 0.3  # [m] the rivals extend over at least as much
MOVED_RATIO = 2.5  # and over so many times the extent of the place
WIDEST = 0.25  # [m] radius in which spots are left out
JITTER = 0.08  # [m] between two sights of a spot that rests: noise, tremor, biases of the cameras
PASSING = 1.5  # [s] a stroke that passes the place is seen before or after it within this time


def evened(seen: Observations) -> Observations:
    """The same spots, with weights such that no small piece of the floor outweighs HEAVIEST usual ones."""
    if len(seen.points) == 0:
        return seen
    _, keys = cell_keys(seen.points, CELL)
    _, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
    totals = np.bincount(inverse, seen.weights)
    drawn = totals[counts >= 2]
    if len(drawn) == 0:
        return seen
    bound = max(HEAVIEST * float(np.median(drawn)), LEAST_BOUND)
    factor = np.minimum(1.0, bound / totals)
    return Observations(seen.points, seen.weights * factor[inverse], seen.stamps, seen.cameras)


def without_fixed_places(seen: Observations) -> Observations:
    """Leaves out the places that cannot be the pointer, because it moves elsewhere at the same time; needs stamps.

    Where two places are at odds it is the one that is at odds with more of the floor that goes, first of all: the
    pointer held still is at odds with one bright thing, the bright thing with the whole stroke.
    """
    if seen.stamps is None or len(seen.points) < 2 * MIN_RIVALS:
        return seen
    order = np.argsort(seen.stamps, kind="stable")
    if len(order) > EXAMINED:
        order = order[np.linspace(0, len(order) - 1, EXAMINED).astype(int)]
    sample = seen.select(order)
    keep = np.ones(len(seen.points), dtype=bool)
    candidates = _densest(sample.points)
    for _ in range(MOST_PLACES):
        judged = [_judge(sample, place) for place in candidates]
        # a place that has no rivals now has none when there are fewer spots
        judged = [verdict for verdict in judged if verdict[0] > 0.0]
        if not judged:
            break
        _, centre, radius = max(judged, key=lambda verdict: verdict[0])
        keep &= ~_fixed(seen, centre, radius)
        sample = sample.select(~_fixed(sample, centre, radius))
        candidates = [place for _, place, _ in judged if np.linalg.norm(place - centre) > radius]
        if len(sample.points) < 2 * MIN_RIVALS:
            break
    return seen.select(keep) if keep.sum() >= MIN_RIVALS else seen


def _densest(points: np.ndarray) -> List[np.ndarray]:
    """Up to CANDIDATES dense places (2,) [m], none in the surroundings of another."""
    _, keys = cell_keys(points, 2.0 * CELL)
    _, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
    means = np.column_stack([np.bincount(inverse, points[:, axis]) / counts for axis in range(2)])
    chosen: List[np.ndarray] = []
    counts = counts.copy()
    while len(chosen) < CANDIDATES:
        best = int(np.argmax(counts))
        if counts[best] < MIN_RIVALS:
            break
        around = points[np.linalg.norm(points - means[best], axis=1) <= PLACE]
        chosen.append(np.median(around, axis=0) if len(around) else means[best])
        counts[np.linalg.norm(means - means[best], axis=1) <= PLACE] = 0
    return chosen


def _judge(sample: Observations, place: np.ndarray) -> Tuple[float, np.ndarray, float]:
    """How far [m] the pointer moved elsewhere while this place was reported, 0 if it may be the pointer itself.

    Args:
        sample: in the order of stamps.

    Returns:
        The extent of the rivals, and the place's centre (2,) and radius [m].
    """
    away = np.linalg.norm(sample.points - place, axis=1)
    inside = away <= PLACE
    nothing = 0.0, place, PLACE
    if inside.sum() < MIN_RIVALS:
        return nothing
    rivals = sample.points[~inside][_beyond_reach(sample.select(~inside), sample.select(inside))]
    # strays have no company, and another bright thing extends over nothing
    lines = [line for line in dbscan(rivals, COMPANY, 3) if len(line) >= MIN_RIVALS]
    moved = max((_extent(rivals[line]) for line in lines), default=0.0)
    own = _extent(sample.points[inside])
    if moved < max(MOVED, MOVED_RATIO * own) or (own > PLACE and _passes(sample.select(inside))):
        return nothing
    return moved, place, float(np.clip(5.0 * np.median(away[inside]), 0.1, WIDEST))


def _fixed(seen: Observations, centre: np.ndarray, radius: float) -> np.ndarray:
    """(N,) bool: spots of the place that are not on the way of a pointer that passes through it."""
    at_place = np.linalg.norm(seen.points - centre, axis=1) <= radius
    if at_place.any() and not at_place.all():
        at_place[at_place] = _beyond_reach(seen.select(at_place), seen.select(~at_place), PASSING)
    return at_place


def _beyond_reach(spots: Observations, others: Observations, longest: float = np.inf) -> np.ndarray:
    """(N,) bool: the pointer cannot have been at a spot and at that of the others which is nearest in time.

    Args:
        longest: [s] what is farther apart in time is beyond reach, too.
    """
    order = np.argsort(others.stamps, kind="stable")
    nearest = order[nearest_in(others.stamps[order], spots.stamps)]
    lapse = np.abs(others.stamps[nearest] - spots.stamps)
    way = np.linalg.norm(others.points[nearest] - spots.points, axis=1)
    return (lapse > longest) | (way > FASTEST * lapse + JITTER)


def _extent(points: np.ndarray) -> float:
    """[m] diagonal of the box that holds four of five points along either axis."""
    low, high = np.percentile(points, [10, 90], axis=0)
    return float(np.linalg.norm(high - low))


def _passes(inside: Observations) -> bool:
    """Does the spot move through the place, in the eyes of the camera that saw it most?

    With a camera whose clock is late a stroke is seen at two places at the same time, all along.
    """
    points, stamps = inside.points, inside.stamps
    if inside.cameras is not None:
        own = inside.cameras == np.argmax(np.bincount(inside.cameras))
        points, stamps = points[own], stamps[own]
    if len(points) < 5 or np.ptp(stamps) == 0.0:
        return False
    centred = points - points.mean(axis=0)
    along = centred @ np.linalg.eigh(centred.T @ centred)[1][:, -1]
    return bool(abs(np.corrcoef(along, stamps)[0, 1]) > 0.7)
