"""Strokes of a hand that moves by published models, as a scene with the true line and the pointer's path.

Sides are minimum-jerk movements (Flash and Hogan, J. Neurosci. 5, 1985); the speed on curves is proportional to
curvature^(-1/3) (Lacquaniti, Terzuolo and Viviani, Acta Psychol. 54, 1983). Corners are missed by 0.75 % of the figure
and 5 mm, sides bend by 1 % of their length (assumed).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vb_core import geometry

SLOW = 0.1  # [m/s] below which a hand moves at constant speed
STEP = 0.005  # [s] between samples of the hand's movement
BEND = 0.01  # [share of a side's length]
BOX = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.2], [0.0, 1.2]])


@dataclass
class DrawnScene:
    """A drawn line, the pointer's path (N, 2) [m] in steps of STEP, and whether cameras see the spot at each step."""

    truth: np.ndarray
    closed: bool
    path: np.ndarray
    shown: np.ndarray
    setback: float = 0.0  # [s] by which all clocks are set back in the middle


def move_straight(start, end, speed: float, rng: np.random.Generator) -> np.ndarray:
    """Returns a movement between two points with minimum jerk, or at constant speed if the hand is slow."""
    offset = np.subtract(end, start)
    length = float(np.hypot(*offset))
    u = np.linspace(0.0, 1.0, max(2, int(length / speed / STEP)))
    minimum_jerk = u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
    progress = minimum_jerk if speed > SLOW else u
    bend = rng.normal(0.0, BEND) * np.sin(np.pi * progress)
    across = np.array([-offset[1], offset[0]])
    return start + progress[:, None] * offset + bend[:, None] * across


def move_along_curve(line: np.ndarray, speed: float) -> np.ndarray:
    """Returns a movement along a smooth dense line by the power law, which starts and ends at rest."""
    d = np.gradient(line, axis=0)
    dx, dy = d.T
    ddx, ddy = np.gradient(d, axis=0).T
    ds = np.hypot(dx, dy)
    curvature = np.abs(dx * ddy - dy * ddx) / ds**3
    progress = np.cumsum(ds * np.maximum(curvature, 0.2) ** (1.0 / 3.0))
    u = np.linspace(0.0, 1.0, int(ds.sum() / speed / STEP))
    eased = np.clip((u - 0.1 * np.sin(2.0 * np.pi * u) / (2.0 * np.pi) * 8.0), 0.0, 1.0)
    shares = (progress - progress[0]) / np.ptp(progress)
    return np.column_stack([np.interp(eased, shares, axis) for axis in line.T])


def miss(targets: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Returns the points that a hand aiming at points (N, 2) hits."""
    return targets + rng.normal(0.0, 1.0, targets.shape) * (0.005 + 0.0075 * np.hypot(*np.ptp(targets, axis=0)))


def trace_polygon(corners: np.ndarray, closed: bool, rng: np.random.Generator, speed=(0.2, 0.5)) -> DrawnScene:
    """Traces one side after another, with a short rest at each corner."""
    corners_hit = miss(np.vstack([corners, corners[:1]]) if closed else corners, rng)
    pace, parts = rng.uniform(*speed), []
    for start, end in zip(corners_hit, corners_hit[1:]):
        parts += [move_straight(start, end, pace, rng), np.repeat([end], int(rng.uniform(0.0, 0.4) / STEP), axis=0)]
    path = np.vstack(parts)
    return DrawnScene(path, closed, path, np.ones(len(path), bool))


def trace_ring(size: float, rng: np.random.Generator, sweep: float = 2.0 * np.pi, flat=(0.85, 1.0)) -> DrawnScene:
    """Traces an ellipse or a part of it; the end of a whole ellipse misses its start."""
    angle = rng.uniform(0.0, 2.0 * np.pi) + np.linspace(0.0, sweep, 800)
    flatness = rng.uniform(*flat)
    line = 0.5 * size * np.column_stack([np.cos(angle), flatness * np.sin(angle)])
    miss = rng.normal(0.0, 0.005 + 0.015 * size, 2)
    line += np.linspace(0.0, 1.0, 800)[:, None] * miss
    path = move_along_curve(line, rng.uniform(0.2, 0.5) * min(1.0, (size / 0.6) ** 0.5))
    return DrawnScene(path, sweep > 6.0, path, np.ones(len(path), bool))


def trace_with_hidden_piece(width: float, rng: np.random.Generator) -> DrawnScene:
    """Traces a box with a piece that no camera sees."""
    scene = trace_polygon(np.roll(BOX, rng.integers(4), axis=0), True, rng)
    arc = geometry.arc_lengths(scene.path)
    scene.shown = np.abs(arc - rng.uniform(0.6, arc[-1] - 0.6)) > 0.5 * width
    return scene


def trace_with_lifted_pointer(rng: np.random.Generator) -> DrawnScene:
    """Traces a box and switches the pointer off once; the line goes on some centimetres before or after that point."""
    scene = trace_polygon(BOX, True, rng)
    off = int(rng.uniform(0.2, 0.8) * len(scene.path))
    pause = int(rng.uniform(0.5, 3.0) / STEP)
    on = max(0, off + int(rng.uniform(-0.4, 0.4) / STEP))
    waiting = np.repeat(scene.path[off : off + 1], pause, axis=0)
    scene.path = np.vstack([scene.path[:off], waiting, scene.path[on:]])
    scene.shown = np.ones(len(scene.path), bool)
    scene.shown[off : off + pause] = False
    return scene


def trace_sides_apart(rng: np.random.Generator) -> DrawnScene:
    """Traces the sides of a box in the order 1-3-2-4, with the pointer off between them."""
    speed = rng.uniform(0.2, 0.5)
    parts, shown, drawn = [], [], {}
    for number in (0, 2, 1, 3):
        ends = miss(BOX[[number, (number + 1) % 4]], rng)
        if parts:
            parts.append(move_straight(parts[-1][-1], ends[0], 1.2, rng))
            shown.append(np.zeros(len(parts[-1]), bool))
        drawn[number] = move_straight(ends[0], ends[1], speed, rng)
        parts.append(drawn[number])
        shown.append(np.ones(len(drawn[number]), bool))
    truth = np.vstack([drawn[number] for number in range(4)])
    return DrawnScene(truth, True, np.vstack(parts), np.concatenate(shown))


def trace_random_figure(rng: np.random.Generator) -> DrawnScene:
    """Traces a figure or line as people do; the ends of a line are at least half of the figure apart."""
    figures = [BOX, BOX[:3] * [0.6, 1.2], 0.7 * BOX @ [[0.8, 0.6], [-0.6, 0.8]]]
    kind = rng.integers(6)
    if kind < 3:
        return trace_polygon(figures[kind], True, rng)
    if kind == 3:
        return trace_polygon(BOX[:3], False, rng)
    radius = rng.uniform(0.6, 2.0)
    if kind == 4:
        return trace_ring(radius, rng, 2.0 * np.pi, (0.5, 1.0))
    return trace_ring(radius, rng, rng.uniform(1.5, 3.5))


def trace_slowly(rng: np.random.Generator) -> DrawnScene:
    """Traces a line or a small box at 5 cm/s."""
    is_box = rng.random() < 0.5
    corners = 0.6 * BOX if is_box else np.array([[0.0, 0.0], [0.9, 0.0]])
    return trace_polygon(corners, is_box, rng, (0.05, 0.05))


def hold_twice(rng: np.random.Generator) -> DrawnScene:
    """Holds the pointer at a wrong point, then for a shorter time at the right one; it is on or off in between."""
    seconds = ((6.0, 1.5), (10.0, 2.0), (20.0, 3.0))[rng.integers(3)]
    wrong_point = rng.uniform(-1.0, 1.0, 2)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    right_point = wrong_point + rng.uniform(0.4, 1.6) * np.array([np.cos(angle), np.sin(angle)])
    before, after = (int(time / STEP) for time in seconds)
    way = move_straight(wrong_point, right_point, rng.uniform(0.3, 1.0), rng)
    parts = [np.repeat([wrong_point], before, axis=0), way, np.repeat([right_point], after, axis=0)]
    shown = [np.ones(len(part), bool) for part in parts]
    shown[1][:] = rng.random() < 0.5
    return DrawnScene(right_point[None], False, np.vstack(parts), np.concatenate(shown))
