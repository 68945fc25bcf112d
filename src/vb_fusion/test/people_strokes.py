"""Strokes of real people, seen by simulated cameras; used by the tests and by bench/extraction/accuracy.py.

`data/quickdraw_strokes.json` holds single strokes of the raw Quick, Draw! data (Google, Inc., CC BY 4.0): one player
each, by mouse or finger. They show how people move, not how a laser pointer trembles. They are scaled to a border's
size and a speed, and seen by two cameras. The values in `Seen` are those that the measure of quality names.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import List, Optional, Tuple

import numpy as np
from generated_strokes import Setting, Stroke, scatter, tremor

from vb_core import geometry

DATA = Path(__file__).resolve().parent / "data" / "quickdraw_strokes.json"
TORN = 0.25  # a stroke with a step longer than this share of its diagonal was not recorded completely


@dataclass(frozen=True)
class Drawing:
    """One stroke as drawn: points (N, 2) [px, y upwards], times (N,) [s]; `closed`: whether it was meant to be."""

    id: str
    shape: str
    closed: bool
    points: np.ndarray
    times: np.ndarray


@dataclass(frozen=True)
class Localization:
    """The error of a robot's pose: standard deviations and correlation time.

    In the simulated lab AMCL's position was off by 2.5 cm in the median, 5 cm at 95 %
    (`git show 27ba7133:docs/results/robots/navigation.md`).
    """

    position: float = 0.02  # [m] per axis
    yaw: float = 0.025  # [rad]
    lasts: float = 15.0  # [s]


@dataclass(frozen=True)
class Seen:
    """How a drawing is scaled and seen.

    If `robot` is given, a robot's camera sees everything, from 1 to 3 m beside the middle of the drawing, and the
    ceiling cameras do not see the two fifths of the drawing on the robot's side.
    """

    diagonal: Tuple[float, float] = (1.5, 3.0)  # [m]
    speed: Tuple[float, float] = (0.2, 0.5)  # [m/s] mean
    cameras: int = 2
    rate: float = 25.0  # [1/s]
    dropped: float = 0.3
    bias: float = 0.02  # [m]
    noise: float = 0.01  # [m]
    tremor: float = 0.015  # [m]
    outliers: float = 0.03
    robot: Optional[Localization] = None


def drawings(path: Path = DATA) -> List[Drawing]:
    """Reads all strokes of a file that were recorded completely."""
    found = []
    for entry in json.loads(Path(path).read_text()):
        if entry.get("max_inner_step_rel_diag", 0.0) > TORN:
            continue
        rows = np.array(entry["points"], dtype=float)
        points = rows[:, 1:3] * [1.0, -1.0]
        found.append(Drawing(entry["id"], entry["shape"], bool(entry["closed"]), points, rows[:, 0] - rows[0, 0]))
    return found


def half(drawing: Drawing) -> str:
    """Returns "develop" for strokes that the code was developed with, else "judge", by a hash of the id."""
    return "develop" if hashlib.sha256(drawing.id.encode()).digest()[0] % 2 == 0 else "judge"


def see(drawing: Drawing, seen: Seen, rng: np.random.Generator) -> Stroke:
    """Returns the spots of a drawing in the order of their stamps; the truth is the line as it was drawn [m]."""
    scale = rng.uniform(*seen.diagonal) / np.linalg.norm(np.ptp(drawing.points, axis=0))
    angle = rng.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    middle = (drawing.points.max(axis=0) + drawing.points.min(axis=0)) / 2
    truth = scale * (drawing.points - middle) @ turn.T
    duration = geometry.chain_length(truth) / rng.uniform(*seen.speed)
    times = drawing.times / drawing.times[-1] * duration
    hand_t = -2.0 + 0.01 * np.arange(int(round((duration + 4.0) / 0.01)))
    hand = tremor(hand_t, Setting(tremor=seen.tremor), rng)
    spots = []  # the points, stamps and cameras of each camera's spots
    if seen.robot is not None:
        side = turn @ [0.0, 1.0]
        edge, stand = np.quantile(truth @ side, 0.6), rng.uniform(1.0, 3.0) * side
    for camera in range(seen.cameras + (seen.robot is not None)):
        phase = rng.uniform(0, 1 / seen.rate)
        t = phase + np.arange(int((duration - phase) * seen.rate + 1.0)) / seen.rate
        t = t[rng.random(len(t)) >= seen.dropped]
        p = np.column_stack([np.interp(t, times, truth[:, k]) + np.interp(t, hand_t, hand[:, k]) for k in range(2)])
        direction = rng.uniform(0, 2 * np.pi)
        offset = seen.bias * np.array([np.cos(direction), np.sin(direction)])
        if seen.robot is not None and camera < seen.cameras:
            t, p = t[p @ side < edge], p[p @ side < edge]
        elif seen.robot is not None:
            offset = _robot_offset(p - stand, t, seen.robot, rng)
        p = p + offset + rng.normal(0, seen.noise, p.shape)
        spots.append((p, t, np.full(len(t), camera)))
    spots.append(scatter(seen.outliers, spots, duration, seen.cameras, rng))
    p, t, c = map(np.concatenate, zip(*spots))
    order = np.argsort(t, kind="stable")
    mobile = c[order] == seen.cameras if seen.robot is not None else None
    return Stroke(truth, drawing.closed, p[order], t[order], c[order], mobile)


def _robot_offset(
    places: np.ndarray, stamps: np.ndarray, localization: Localization, rng: np.random.Generator
) -> np.ndarray:
    """Returns (N, 2) [m], a robot's error for spots at places (N, 2) [m] relative to it, stamps (N,) [s] ascending."""
    sigma = np.array([localization.position, localization.position, localization.yaw])
    error = np.empty((len(stamps), 3))
    state = sigma * rng.standard_normal(3)
    for row, pause in enumerate(np.diff(stamps, prepend=stamps[:1])):
        keep = np.exp(-pause / localization.lasts)
        state = keep * state + np.sqrt(1.0 - keep**2) * sigma * rng.standard_normal(3)
        error[row] = state
    return error[:, :2] + error[:, 2:] * np.column_stack([-places[:, 1], places[:, 0]])
