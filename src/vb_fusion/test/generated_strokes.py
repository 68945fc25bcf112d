"""A generator of drawn strokes with the defects of real ones; used by the tests and by bench/extraction/accuracy.py.

Every value in `Setting` is an assumption; none is tuned to the results.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Dict, Optional, Tuple

import numpy as np
from scipy.signal import lfilter
from scipy.spatial import cKDTree
from shapely.validation import make_valid
from shapely.geometry import Polygon

from vb_core import geometry

SHAPES: Dict[str, Tuple[np.ndarray, bool]] = {
    "rectangle": (np.array([[0, 0], [2.0, 0], [2.0, 1.25], [0, 1.25]], float), True),
    "L": (np.array([[0, 0], [2.0, 0], [2.0, 0.7], [0.8, 0.7], [0.8, 1.8], [0, 1.8]], float), True),
    "U": (np.array([[0, 0], [2, 0], [2, 1.5], [1.3, 1.5], [1.3, 0.6], [0.7, 0.6], [0.7, 1.5], [0, 1.5]], float), True),
    "narrow_U": (
        np.array([[0, 0], [1.6, 0], [1.6, 1.5], [0.9, 1.5], [0.9, 0.5], [0.7, 0.5], [0.7, 1.5], [0, 1.5]], float),
        True,
    ),
    "doorway": (np.array([[0, 0], [0.7, 0]], float), False),
    "corner": (np.array([[0, 2.0], [0.9, 1.9], [1.7, 1.2], [1.9, 0.0]], float), False),
    "circle": (np.array([[np.cos(a), np.sin(a)] for a in np.linspace(0, 2 * np.pi, 60, endpoint=False)]), True),
}


@dataclass(frozen=True)
class Setting:
    """How a stroke is drawn and seen."""

    cameras: int = 2
    rate: float = 25.0  # [1/s] frames of each camera
    speed: float = 0.4  # [m/s]
    bias: float = 0.02  # [m] of each camera, in a random direction
    noise: float = 0.01  # [m] standard deviation of each detection
    tremor: float = 0.02  # [m] standard deviation of the hand, correlated over `tremor_time`
    tremor_time: float = 0.25  # [s]
    dropped: float = 0.3  # share of the frames without a detection
    outliers: float = 0.03  # share of detections at random positions in the room
    clutter: int = 40  # detections of a bright object, at one place
    gap: float = 0.0  # [m] of the stroke that nobody saw
    end_gap: float = 0.0  # [m] between start and end of a closed stroke
    overlap: float = 0.0  # [m] by which a closed stroke's end runs past its start
    passes: int = 1  # how often the stroke is drawn over
    shuffled: bool = True

    replace = dataclasses.replace


@dataclass(frozen=True)
class Stroke:
    """A drawn stroke, truth (M, 2) [m], and its spots. `mobile` says which a camera on a robot saw."""

    truth: np.ndarray
    closed: bool
    points: np.ndarray
    stamps: np.ndarray
    cameras: np.ndarray
    mobile: Optional[np.ndarray] = None


def draw(shape: str, setting: Setting, rng: np.random.Generator) -> Stroke:
    """Draws one stroke with a random orientation and start."""
    vertices, closed = SHAPES[shape]
    angle = rng.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    truth = (vertices - vertices.mean(axis=0)) @ turn.T + rng.uniform(-0.5, 0.5, 2)
    ring = np.vstack([truth, truth[:1]]) if closed else truth
    dense = geometry.resample_chain(ring, 0.005)
    if closed:
        dense = np.roll(dense[:-1], -int(rng.integers(len(dense) - 1)), axis=0)
        extra = int(round((setting.overlap - setting.end_gap) / 0.005))
        dense = np.vstack([dense, dense[: extra + 1]]) if extra >= 0 else dense[:extra]
    way = np.vstack([dense if k % 2 == 0 or closed else dense[::-1] for k in range(setting.passes)])
    arc = geometry.arc_lengths(way)
    hidden = rng.uniform(0.2, 0.8) * arc[-1]
    duration = arc[-1] / setting.speed
    # whole steps, so that the number of random draws does not depend on the last bit of a length
    hand_t = -2.0 + 0.01 * np.arange(int(round((duration + 4.0) / 0.01)))
    hand = tremor(hand_t, setting, rng)
    spots = []  # the points, stamps and cameras of each camera's spots
    for camera in range(setting.cameras):
        t = np.arange(rng.uniform(0, 1 / setting.rate), duration, 1 / setting.rate)
        t = t[rng.random(len(t)) >= setting.dropped]
        s = t * setting.speed
        t, s = (values[np.abs(s - hidden) >= setting.gap / 2] for values in (t, s))
        p = np.column_stack([np.interp(s, arc, way[:, k]) + np.interp(t, hand_t, hand[:, k]) for k in range(2)])
        direction = rng.uniform(0, 2 * np.pi)
        p = p + setting.bias * np.array([np.cos(direction), np.sin(direction)]) + rng.normal(0, setting.noise, p.shape)
        spots.append((p, t, np.full(len(t), camera)))
    spots.append(scatter(setting.outliers, spots, duration, setting.cameras, rng))
    clutter = rng.uniform([-4, -2.5], [4, 2.5]) + rng.normal(0, 0.04, (setting.clutter, 2))
    spots.append((clutter, rng.uniform(0, duration, setting.clutter), np.zeros(setting.clutter, int)))
    p, t, c = map(np.concatenate, zip(*spots))
    order = rng.permutation(len(p)) if setting.shuffled else np.argsort(t)
    return Stroke(truth, closed, p[order], t[order], c[order])


def scatter(share: float, spots: list, duration: float, cameras: int, rng: np.random.Generator) -> tuple:
    """Returns points, stamps and cameras of strays in the room: this share of as many as there are spots."""
    count = int(round(share * sum(len(stamps) for _, stamps, _ in spots)))
    points = rng.uniform([-4, -2.5], [4, 2.5], (count, 2))
    return points, rng.uniform(0, duration, count), rng.integers(0, cameras, count)


def tremor(t: np.ndarray, setting: Setting, rng: np.random.Generator) -> np.ndarray:
    """Returns a stationary Gauss-Markov process (len(t), 2) [m]."""
    keep = np.exp(-0.01 / setting.tremor_time)
    steps = rng.normal(0, setting.tremor * np.sqrt(1 - keep**2), (len(t), 2))
    steps[0] = rng.normal(0, setting.tremor, 2)
    return lfilter([1.0], [1.0, -keep], steps, axis=0)


def hausdorff(a: np.ndarray, b: np.ndarray, closed: bool) -> float:
    """Returns the Hausdorff distance [m] of two chains, sampled every centimetre."""
    a, b = (geometry.resample_chain(chain, 0.01, closed) for chain in (a, b))
    return float(max(cKDTree(a).query(b)[0].max(), cKDTree(b).query(a)[0].max()))


def jaccard(a: np.ndarray, b: np.ndarray) -> float:
    """Returns the Jaccard index of two polygons' areas."""
    if min(len(a), len(b)) < 3:
        return 0.0
    # lines that people draw may cross themselves, and so may the extracted chains
    p, q = (make_valid(Polygon(line).buffer(0)) for line in (a, b))
    return float(p.intersection(q).area / p.union(q).area)
