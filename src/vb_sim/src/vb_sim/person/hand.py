"""Simulates the hand with the laser pointer: its tremor, and the stroke that it draws.

A simulated person draws like one real person of config/strokes.json, which bench/extraction/quickdraw_strokes.py of
revision dd21bbd0 wrote. Along each side, the speed and the deviation from the straight line are that person's. So stops
at corners, peak speeds, uneven sides, overshot corners and gaps are those of real people. They are assumed to be
proportional to the side's length.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Callable, List, Mapping, Tuple

import numpy as np
from shapely.geometry import LinearRing

from vb_core.geometry import arc_lengths, base_to_map, bounding_diagonal
from vb_sim.model_params import MODELS_FILE, ParticipantModel
from vb_sim.world import Point2

IsFloor = Callable[[np.ndarray], np.ndarray]
STROKES_FILE = MODELS_FILE.with_name("strokes.json")
SINES = 24  # number of sines in a tremor
BIN = 0.02  # [m] of arc length that is drawn at one speed; a pause is within one bin
MAX_OVERSHOOT = 0.45  # [share of the side] maximum of overshoots and gaps, so that no side vanishes


class Tremor:
    """Band-limited motion of the spot around its intended position.

    A sum of sines with random phases is smooth, has a known strength, and does not depend on the sampling rate.

    Args:
        rms: [m] root mean square of the offset's length.
        band: lowest and highest frequency [1/s].
    """

    def __init__(self, rms: float, band: Tuple[float, float], rng: np.random.Generator) -> None:
        self._frequencies = 2.0 * math.pi * rng.uniform(band[0], max(band[1], band[0]), (SINES, 2))
        self._phases = rng.uniform(0.0, 2.0 * math.pi, (SINES, 2))
        self._amplitude = rms / math.sqrt(SINES)

    def at(self, time: float) -> np.ndarray:
        """Returns the offset (2,) [m] at time `time` [s]."""
        return self._amplitude * np.sin(self._frequencies * time + self._phases).sum(axis=0)


@dataclass(frozen=True)
class Side:
    """A person's movement along one straight side, sampled at equal intervals of time."""

    along: np.ndarray  # (N,) share of the side that is completed, from 0 to 1
    lateral: np.ndarray  # (N,) deviation from the straight line [share of the side's length]
    tempo: float  # duration of the side, divided by the duration at that person's mean speed


@dataclass(frozen=True)
class DrawingStyle:
    """One real person's way of drawing."""

    sides: Tuple[Side, ...]
    overshoot: Tuple[float, ...]  # how far the hand goes beyond each corner [share of the side]; negative if it cuts it
    gap: float  # how far a closed figure ends beyond its start [share of the diagonal]; negative if it ends before


@lru_cache(maxsize=1)
def load_styles() -> Tuple[DrawingStyle, ...]:
    """Reads the styles of all people in strokes.json. People who drew no closed figure get another person's gap."""
    people = json.loads(STROKES_FILE.read_text(encoding="utf-8"))["people"]
    gaps = [person["gap"] for person in people if person["gap"] is not None]
    styles = []
    for index, person in enumerate(people):
        sides = tuple(_read_side(side) for side in person["sides"])
        gap = gaps[index % len(gaps)] if person["gap"] is None else person["gap"]
        styles.append(DrawingStyle(sides, tuple(person["overshoot"]), gap))
    return tuple(styles)


def _read_side(values: Mapping[str, Any]) -> Side:
    return Side(np.array(values["along"]), np.array(values["lateral"]), values["tempo"])


class Stroke:
    """The line that the hand draws instead of the intended chain.

    Args:
        border: (N, 2) [m] the intended chain.
        closed: whether the chain returns to its start.
        style: the movement's style. The model's `stroke_scale` multiplies its deviations; 0 draws straight and evenly.
        is_floor: returns whether points (N, 2) [m] are on the floor; the ends of an open border are drawn only there.
    """

    def __init__(
        self,
        border: np.ndarray,
        closed: bool,
        model: ParticipantModel,
        rng: np.random.Generator,
        is_floor: IsFloor,
        style: DrawingStyle,
    ) -> None:
        scale = model.stroke_scale
        border = np.asarray(border, dtype=float)
        # the hand aims at corners and at the ends of an open border with small errors
        aimed = border + model.aim_sigma / math.sqrt(2.0) * rng.standard_normal(border.shape)
        if closed:
            excess = scale * style.gap * bounding_diagonal(border)
            overlap = abs(rng.normal(0.0, model.overlap))
            chain = _move_end(np.vstack([aimed, aimed[:1]]), excess + overlap)
        else:
            chain = _move_ends_to_floor(aimed, is_floor)
        self.points, times = self._draw(chain, style, scale)
        self._arc = arc_lengths(self.points)
        self.length = float(self._arc[-1])
        bins = np.linspace(0.0, self.length, max(int(self.length / BIN), 1) + 1)
        self._bin = bins[1]
        durations = np.diff(np.interp(bins, self._arc, times))
        self._pace = self._bin / np.maximum(durations, 1e-6)
        first_side = float(np.linalg.norm(chain[1] - chain[0]))
        self.start = min(abs(rng.normal(0.0, model.late_start)), 0.2 * first_side, 0.5 * self.length)

    @staticmethod
    def _draw(chain: np.ndarray, style: DrawingStyle, scale: float) -> Tuple[np.ndarray, np.ndarray]:
        """Returns the points (M, 2) [m] of the line, and their times (M,) [s] at a mean speed of 1 m/s."""
        points: List[np.ndarray] = [chain[:1]]
        times: List[np.ndarray] = [np.zeros(1)]
        style_share = min(scale, 1.0)
        start = chain[0]
        for index, corner in enumerate(chain[1:]):
            side = style.sides[index % len(style.sides)]
            straight = corner - start
            if np.linalg.norm(straight) < 1e-9:
                continue
            if index < len(chain) - 2 and style.overshoot:
                # the side ends beyond or before the corner, and the next side starts where it ends
                share = scale * style.overshoot[index % len(style.overshoot)]
                corner = corner + straight * np.clip(share, -MAX_OVERSHOOT, MAX_OVERSHOOT)
                straight = corner - start
            length = float(np.linalg.norm(straight))
            across = np.array([-straight[1], straight[0]])
            # resampled to about 1 cm, or more densely
            shares = np.linspace(0.0, 1.0, max(int(length / 0.01), len(side.along)) + 1)
            knots = np.linspace(0.0, 1.0, len(side.along))
            along = (1.0 - style_share) * shares + style_share * np.interp(shares, knots, side.along)
            lateral = scale * np.interp(shares, knots, side.lateral)
            curve = start + along[:, None] * straight + lateral[:, None] * across
            duration = length * side.tempo**style_share
            points.append(curve[1:])
            times.append(times[-1][-1] + duration * shares[1:])
            start = corner
        return np.vstack(points), np.concatenate(times)

    def at(self, arc: float) -> np.ndarray:
        """Returns the position (2,) [m] at an arc length [m] from the stroke's start."""
        return np.array([np.interp(arc, self._arc, self.points[:, i]) for i in range(2)])

    def pace(self, arc: float) -> float:
        """Returns the hand's speed as a multiple of its mean, which is nearly 0 at corners and above 1 between them."""
        return float(self._pace[min(max(int(arc / self._bin), 0), len(self._pace) - 1)])


def perceive_border(border: np.ndarray, closed: bool, offset: Point2, turn: float, margin: float) -> np.ndarray:
    """Returns the chain that a person means to draw who sees no map, but marks on the floor.

    Args:
        border: (N, 2) [m] on the map.
        offset: (x, y) [m] by which the marks are displaced.
        turn: [rad] by which the marks are rotated about the border's centre.
        margin: [m] by which the chain is outside a closed border's marks; negative if it is inside.
    """
    center = border.mean(axis=0)
    moved = base_to_map(border - center, (*center, turn)) + np.asarray(offset)
    if not closed:
        return moved
    outwards = 1.0 if LinearRing(moved).is_ccw else -1.0
    sides = np.roll(moved, -1, axis=0) - moved  # from each corner to the next
    sides /= np.linalg.norm(sides, axis=1, keepdims=True)
    normals = outwards * np.column_stack([sides[:, 1], -sides[:, 0]])
    # a corner moves along the bisector of its sides' normals, by the margin divided by the cosine of half their angle
    bisectors = np.roll(normals, 1, axis=0) + normals
    squared_lengths = (bisectors**2).sum(axis=1, keepdims=True)
    return moved + margin * 2.0 * bisectors / np.maximum(squared_lengths, 0.2)


def _move_end(chain: np.ndarray, reach: float) -> np.ndarray:
    """Moves a closed chain's end by `reach` [m] beyond its start along the first side, or back along the last side."""
    if reach >= 0.0:
        kept = chain
        side = chain[1] - chain[0]
    else:
        kept = chain[:-1]
        side = chain[-1] - chain[-2]
    length = float(np.linalg.norm(side))
    limit = MAX_OVERSHOOT * length
    return np.vstack([kept, chain[-1] + side / length * np.clip(reach, -limit, limit)])


def _move_ends_to_floor(border: np.ndarray, is_floor: IsFloor) -> np.ndarray:
    """Returns the chain with ends that are off the floor moved along it to points a centimetre inside the floor."""
    result = border.copy()
    for end, neighbor in ((0, 1), (-1, -2)):
        side = border[neighbor] - border[end]
        length = float(np.linalg.norm(side))
        arcs = np.arange(0.0, 0.5 * length, 0.005)
        on_floor = np.asarray(is_floor(border[end] + arcs[:, None] / length * side), dtype=bool)
        if not on_floor[0] and on_floor.any():
            arc = min(arcs[np.argmax(on_floor)] + 0.01, 0.5 * length)
            result[end] = border[end] + arc / length * side
    return result
