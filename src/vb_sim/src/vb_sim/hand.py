"""The hand with the laser pointer: its tremor, and the stroke that it means to draw."""
from __future__ import annotations

import math
from typing import Callable, Optional, Tuple

import numpy as np

from vb_sim.models_participant import ParticipantModel

CORNER_ANGLE = math.radians(25.0)
CORNER_REACH = 0.12  # [m] before and after a corner within which the hand is slower


class Tremor:
    """Band-limited motion of the spot about the place it is meant to be at.

    A sum of sines with random phases: smooth, of known strength, and the same for the same seed at any rate.

    Args:
        rms: [m] root mean square of the offset's length.
        band: lowest and highest frequency [1/s].
    """

    def __init__(self, rms: float, band: Tuple[float, float], rng: np.random.Generator, components: int = 24) -> None:
        self._frequencies = 2.0 * math.pi * rng.uniform(band[0], max(band[1], band[0]), (components, 2))
        self._phases = rng.uniform(0.0, 2.0 * math.pi, (components, 2))
        self._amplitude = rms / math.sqrt(components)

    def at(self, time: float) -> np.ndarray:
        """(2,) [m] offset at a time [s]."""
        return self._amplitude * np.sin(self._frequencies * time + self._phases).sum(axis=0)


class Stroke:
    """What the hand draws: a chain with the corners missed, overshot and cut as people do.

    Args:
        border: (N, 2) [m] the chain that the person has in mind.
        closed: whether it comes back to its start.
        is_floor: says for places (N, 2) [m] whether they are floor; ends are drawn only as far as the floor goes.
    """

    def __init__(
        self,
        border: np.ndarray,
        closed: bool,
        model: ParticipantModel,
        rng: np.random.Generator,
        is_floor: Optional[Callable[[np.ndarray], np.ndarray]] = None,
    ) -> None:
        border = np.asarray(border, dtype=float)
        if not closed and is_floor is not None:
            border = _ends_on_floor(border, is_floor)
        aimed = border + model.aim_sigma / math.sqrt(2.0) * rng.standard_normal(border.shape)
        if not closed:
            # ends at a wall are aimed at along the wall, not into it
            aimed[0], aimed[-1] = border[0], border[-1]
        chain = np.vstack([aimed, aimed[:1]]) if closed else aimed
        if closed:
            side = chain[1] - chain[0]
            length = float(np.linalg.norm(side))
            beyond = min(abs(rng.normal(model.overlap, model.overlap / 2.0)), 0.5 * length)
            chain = np.vstack([chain, chain[0] + side / length * beyond])
        late = min(abs(rng.normal(0.0, model.late_start)), 0.2 * float(np.linalg.norm(chain[1] - chain[0])))
        self.points, corners = _with_overshoot(chain, model.overshoot, rng)
        steps = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        self._arc = np.concatenate([[0.0], np.cumsum(steps)])
        self._corners = self._arc[corners]
        self._slowdown = model.corner_slowdown
        self.start = late
        self.length = float(self._arc[-1])

    def at(self, arc: float) -> np.ndarray:
        """(2,) [m] the place at an arc length [m] from the stroke's start."""
        return np.array([np.interp(arc, self._arc, self.points[:, i]) for i in range(2)])

    def pace(self, arc: float) -> float:
        """Share of the full speed at which the hand moves there: slower at corners and ends."""
        near = np.abs(self._corners - arc).min() if len(self._corners) else np.inf
        near = min(near, abs(arc - self.length), abs(arc - self.start))
        return float(self._slowdown + (1.0 - self._slowdown) * min(near / CORNER_REACH, 1.0))


def _ends_on_floor(border: np.ndarray, is_floor: Callable[[np.ndarray], np.ndarray], margin: float = 0.01) -> np.ndarray:
    """The chain with its first and last point moved along it to where the floor begins [m]."""
    result = border.copy()
    for end, neighbour in ((0, 1), (-1, -2)):
        side = border[neighbour] - border[end]
        length = float(np.linalg.norm(side))
        arcs = np.arange(0.0, 0.5 * length, 0.005)
        floor = np.asarray(is_floor(border[end] + arcs[:, None] / length * side), dtype=bool)
        if not floor[0] and floor.any():
            result[end] = border[end] + min(arcs[int(np.argmax(floor))] + margin, 0.5 * length) / length * side
    return result


def _with_overshoot(chain: np.ndarray, scale: float, rng: np.random.Generator) -> Tuple[np.ndarray, np.ndarray]:
    """The chain with overshoots and the indices of its corners."""
    points, corners = [chain[0]], []
    for before, corner, after in zip(chain[:-2], chain[1:-1], chain[2:]):
        incoming, outgoing = corner - before, after - corner
        a, b = float(np.linalg.norm(incoming)), float(np.linalg.norm(outgoing))
        turn = math.acos(float(np.clip(incoming @ outgoing / max(a * b, 1e-12), -1.0, 1.0)))
        too_far = min(abs(rng.normal(0.0, scale)), 0.3 * a)
        if turn < CORNER_ANGLE or too_far < 1e-4:
            corners += [len(points)] if turn >= CORNER_ANGLE else []
            points.append(corner)
            continue
        corners.append(len(points))
        points.append(corner + incoming / a * too_far)
        # not back to the corner: straight on to the next side
        points.append(corner + outgoing / b * min(3.0 * too_far, 0.4 * b))
    points.append(chain[-1])
    return np.array(points), np.array(corners, dtype=int)
