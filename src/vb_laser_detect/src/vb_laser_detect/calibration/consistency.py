"""Measures how well overlapping cameras agree: a spot that two of them see must be at one place on the floor."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Dict, Iterable, List, Tuple

import numpy as np

from vb_core.errors import CodedError

Sighting = Tuple[str, float, float, float]  # camera, stamp [s], x [m], y [m]


@dataclass(frozen=True)
class CameraConsistency:
    """Positions at which two cameras see the same spot.

    Attributes:
        first, second: the cameras' names.
        count: pairs of sightings.
        offset: (2,) [m] mean of the second's place minus the first's.
        median, p95: [m] of the distance.
    """

    first: str
    second: str
    count: int
    offset: Tuple[float, float]
    median: float
    p95: float


# a camera's usual interval between sightings, and one image that is lost; but no longer than a straight part of a slow
# drawing lasts
_GAP_PERIODS = 2.5
_MAX_GAP = 0.5  # [s]


def compare_cameras(sightings: Iterable[Sighting], min_common: int = 20) -> List[CameraConsistency]:
    """Compares each pair of cameras that saw the spot at the same time.

    Cameras do not take their images at the same time, and a spot moves: the second one's place is interpolated to the
    first one's time, between two of its sightings that follow each other at its usual pace. A camera that saw two spots
    at once is left out at that time.

    Raises:
        CodedError: "too_few_cameras" if fewer than two cameras saw a spot; "no_overlap" if no two of them saw it together
            at least `min_common` times.
    """
    tracks = _tracks(sightings)
    if len(tracks) < 2:
        raise CodedError("too_few_cameras", cameras=", ".join(tracks) or "-")
    found = []
    for first, second in itertools.combinations(sorted(tracks), 2):
        a, b = tracks[first], tracks[second]
        after = np.searchsorted(b[:, 0], a[:, 0], side="right")
        inside = (after > 0) & (after < len(b))
        a, after = a[inside], after[inside]
        before = after - 1
        near = b[after, 0] - b[before, 0] <= min(_GAP_PERIODS * float(np.median(np.diff(b[:, 0]))), _MAX_GAP)
        a, before, after = a[near], before[near], after[near]
        if len(a) < min_common:
            continue
        share = ((a[:, 0] - b[before, 0]) / (b[after, 0] - b[before, 0]))[:, None]
        off = b[before, 1:] + share * (b[after, 1:] - b[before, 1:]) - a[:, 1:]
        distance = np.linalg.norm(off, axis=1)
        x, y = (float(value) for value in off.mean(axis=0))
        median, p95 = (float(value) for value in np.percentile(distance, (50, 95)))
        found.append(CameraConsistency(first, second, len(off), (x, y), median, p95))
    if not found:
        raise CodedError("no_overlap", cameras=", ".join(sorted(tracks)), count=min_common)
    return found


def _tracks(sightings: Iterable[Sighting]) -> Dict[str, np.ndarray]:
    """Collects each camera's spots, (N, 3) [s, m, m] sorted by time; times with more than one spot are left out."""
    collected: Dict[str, Dict[float, List[Tuple[float, float]]]] = {}
    for camera, stamp, x, y in sightings:
        if math.isfinite(stamp) and math.isfinite(x) and math.isfinite(y):
            collected.setdefault(camera, {}).setdefault(stamp, []).append((x, y))
    tracks = {}
    for camera, times in collected.items():
        rows = [(stamp, *places[0]) for stamp, places in sorted(times.items()) if len(places) == 1]
        if rows:
            tracks[camera] = np.array(rows)
    return tracks
