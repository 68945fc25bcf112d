"""The hand with the laser pointer: its tremor, and the stroke that it draws.

A simulated person moves as one real person did (config/strokes.json, made by bench/extraction/quickdraw_strokes.py of
revision dd21bbd0): each side is drawn with that person's deviation from the straight line and speed along it, so that
stops at corners, peak speeds, uneven sides, overshot corners and gaps are those of real people. It is assumed that they
scale with the side's length.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Callable, List, Optional, Tuple

import numpy as np

from vb_core.geometry import bounding_diagonal, to_map
from vb_sim.models import MODELS, ParticipantModel

IsFloor = Callable[[np.ndarray], np.ndarray]
RESOURCE = MODELS.with_name("strokes.json")
SINES = 24  # in the sum that makes a tremor
BIN = 0.02  # [m] of arc length for which one pace is given: a pause falls within a bin
MAX_OVERSHOOT = 0.45  # [share of the side] limit of overshoots and gaps, so that no side vanishes


class Tremor:
    """Band-limited motion of the spot around its intended position.

    A sum of sines with random phases: smooth, of known strength, and the same for the same seed at any sampling rate.

    Args:
        rms: [m] root mean square of the offset's length.
        band: lowest and highest frequency [1/s].
    """

    def __init__(self, rms: float, band: Tuple[float, float], rng: np.random.Generator) -> None:
        self._frequencies = 2.0 * math.pi * rng.uniform(band[0], max(band[1], band[0]), (SINES, 2))
        self._phases = rng.uniform(0.0, 2.0 * math.pi, (SINES, 2))
        self._amplitude = rms / math.sqrt(SINES)

    def at(self, time: float) -> np.ndarray:
        """Returns the offset (2,) [m] at a time [s]."""
        return self._amplitude * np.sin(self._frequencies * time + self._phases).sum(axis=0)


@dataclass(frozen=True)
class Side:
    """How a person drew one straight side; samples at equal times.

    Attributes:
        along: (N,) share of the side that is completed, from 0 to 1.
        lateral: (N,) deviation from the straight line [share of the side's length].
        tempo: time that the side took, divided by the time for its length at that person's mean speed.
    """

    along: np.ndarray
    lateral: np.ndarray
    tempo: float


@dataclass(frozen=True)
class Style:
    """How one real person draws.

    Attributes:
        overshoot: how far the hand passes each corner [share of the side]; negative where it cuts the corner.
        gap: how far the end of a closed figure is beyond its start [share of the diagonal]; negative: short of it.
    """

    sides: Tuple[Side, ...]
    overshoot: Tuple[float, ...]
    gap: float


@lru_cache(maxsize=1)
def load_styles() -> Tuple[Style, ...]:
    """Reads the styles of all people in strokes.json; one who drew no closed figure gets another's gap."""
    people = json.loads(RESOURCE.read_text(encoding="utf-8"))["people"]
    gaps = [person["gap"] for person in people if person["gap"] is not None]
    return tuple(
        Style(
            tuple(Side(np.array(side["along"]), np.array(side["lateral"]), side["tempo"]) for side in person["sides"]),
            tuple(person["overshoot"]),
            person["gap"] if person["gap"] is not None else gaps[index % len(gaps)],
        )
        for index, person in enumerate(people)
    )


class Stroke:
    """The line that the hand draws in place of the chain that the person has in mind.

    Args:
        border: (N, 2) [m] the chain that the person has in mind.
        closed: whether the chain returns to its start.
        model: its `stroke_scale` multiplies the style's deviations: 0 draws straight and evenly.
        style: whose movement it is.
        is_floor: tells whether points (N, 2) [m] are on the floor; the ends of an open border are drawn only there.
    """

    def __init__(
        self,
        border: np.ndarray,
        closed: bool,
        model: ParticipantModel,
        rng: np.random.Generator,
        is_floor: Optional[IsFloor] = None,
        style: Optional[Style] = None,
    ) -> None:
        style = style or load_styles()[0]
        scale = model.stroke_scale
        border = np.asarray(border, dtype=float)
        # every corner is missed a little, and so are the ends of an open border
        aimed = border + model.aim_sigma / math.sqrt(2.0) * rng.standard_normal(border.shape)
        if closed:
            reach = scale * style.gap * bounding_diagonal(border)
            chain = np.vstack([aimed, aimed[:1]])
            chain = _beyond(chain, reach + abs(rng.normal(0.0, model.overlap)))
        else:
            chain = _ends_on_floor(aimed, is_floor) if is_floor is not None else aimed
        self.points, times = self._draw(chain, style, scale)
        steps = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        self._arc = np.concatenate([[0.0], np.cumsum(steps)])
        bins = np.linspace(0.0, self._arc[-1], max(int(self._arc[-1] / BIN), 1) + 1)
        self._bin = bins[1]
        self._pace = self._bin / np.maximum(np.diff(np.interp(bins, self._arc, times)), 1e-6)
        first = float(np.linalg.norm(chain[1] - chain[0]))
        self.start = min(abs(rng.normal(0.0, model.late_start)), 0.2 * first, 0.5 * float(self._arc[-1]))
        self.length = float(self._arc[-1])

    @staticmethod
    def _draw(chain: np.ndarray, style: Style, scale: float) -> Tuple[np.ndarray, np.ndarray]:
        """Returns the points (M, 2) [m] drawn, and the times (M,) [s] of the hand there at a mean speed of 1 m/s."""
        points: List[np.ndarray] = [chain[:1]]
        times: List[np.ndarray] = [np.zeros(1)]
        begin = chain[0]
        for index, corner in enumerate(chain[1:]):
            side, straight = style.sides[index % len(style.sides)], corner - begin
            if np.linalg.norm(straight) < 1e-9:
                continue
            if index < len(chain) - 2 and style.overshoot:
                # the side ends beyond the corner or short of it, and the next one starts there
                share = scale * style.overshoot[index % len(style.overshoot)]
                corner = corner + straight * np.clip(share, -MAX_OVERSHOOT, MAX_OVERSHOOT)
                straight = corner - begin
            length = float(np.linalg.norm(straight))
            across = np.array([-straight[1], straight[0]])
            # resampled to about 1 cm, or more densely
            fine = np.linspace(0.0, 1.0, max(int(length / 0.01), len(side.along)) + 1)
            known = np.linspace(0.0, 1.0, len(side.along))
            along = (1.0 - min(scale, 1.0)) * fine + min(scale, 1.0) * np.interp(fine, known, side.along)
            drawn = begin + along[:, None] * straight + scale * np.interp(fine, known, side.lateral)[:, None] * across
            took = length * side.tempo ** min(scale, 1.0)
            points.append(drawn[1:])
            times.append(times[-1][-1] + took * fine[1:])
            begin = corner
        return np.vstack(points), np.concatenate(times)

    def at(self, arc: float) -> np.ndarray:
        """Returns the position (2,) [m] at an arc length [m] from the stroke's start."""
        return np.array([np.interp(arc, self._arc, self.points[:, i]) for i in range(2)])

    def pace(self, arc: float) -> float:
        """Returns the hand's speed there as a multiple of its mean: nearly 0 at corners, several times 1 between."""
        return float(self._pace[min(max(int(arc / self._bin), 0), len(self._pace) - 1)])


def perceive_border(
    border: np.ndarray, closed: bool, offset: Tuple[float, float], turn: float, margin: float
) -> np.ndarray:
    """Returns the chain that a person who sees marks on the floor, but no map, has in mind.

    Args:
        border: (N, 2) [m] as the map has it.
        offset, turn: [m], [rad] by which the marks are displaced, and rotated about the border's centre.
        margin: [m] by which the person keeps outside of a closed border's marks; negative: inside.
    """
    middle = border.mean(axis=0)
    moved = to_map(border - middle, (*middle, turn)) + np.asarray(offset)
    if not closed:
        return moved
    before, after = moved - np.roll(moved, 1, axis=0), np.roll(moved, -1, axis=0) - moved
    area = float(np.sum(moved[:, 0] * np.roll(moved[:, 1], -1) - np.roll(moved[:, 0], -1) * moved[:, 1]))
    outwards = np.array([[0.0, 1.0], [-1.0, 0.0]]) * math.copysign(1.0, area)  # rotates a side to its right or left
    normals = [(side / np.linalg.norm(side, axis=1, keepdims=True)) @ outwards.T for side in (before, after)]
    bisector = normals[0] + normals[1]
    return moved + margin * 2.0 * bisector / np.maximum((bisector**2).sum(axis=1, keepdims=True), 0.2)


def _beyond(chain: np.ndarray, reach: float) -> np.ndarray:
    """Moves a closed chain's end by `reach` [m] past its start along the first side, or short of it on the last."""
    side, kept = (chain[1] - chain[0], chain) if reach >= 0.0 else (chain[-1] - chain[-2], chain[:-1])
    length = float(np.linalg.norm(side))
    most = MAX_OVERSHOOT * length
    return np.vstack([kept, chain[-1] + side / length * np.clip(reach, -most, most)])


def _ends_on_floor(border: np.ndarray, is_floor: IsFloor) -> np.ndarray:
    """Returns the chain with each end that is off the floor moved along it to a centimetre inside the floor."""
    result = border.copy()
    for end, neighbor in ((0, 1), (-1, -2)):
        side = border[neighbor] - border[end]
        length = float(np.linalg.norm(side))
        arcs = np.arange(0.0, 0.5 * length, 0.005)
        floor = np.asarray(is_floor(border[end] + arcs[:, None] / length * side), dtype=bool)
        if not floor[0] and floor.any():
            result[end] = border[end] + min(arcs[int(np.argmax(floor))] + 0.01, 0.5 * length) / length * side
    return result
