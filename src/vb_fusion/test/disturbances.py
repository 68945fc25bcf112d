"""Disturbances while somebody draws, which do not belong to the border: a spot held still, a bright object."""

from __future__ import annotations

import dataclasses

import numpy as np
from generated_strokes import Setting, Stroke, draw

from vb_core import geometry

USUAL = Setting(clutter=0)


def timed(shape: str, seed: int, setting: Setting = USUAL) -> Stroke:
    """Draws a stroke whose spots are in the order of their stamps."""
    return draw(shape, setting.replace(shuffled=False), np.random.default_rng(seed))


def _with(stroke: Stroke, points, stamps, cameras) -> Stroke:
    columns = (stroke.points, points), (stroke.stamps, stamps), (stroke.cameras, cameras)
    p, t, c = map(np.concatenate, columns)
    order = np.argsort(t, kind="stable")
    return Stroke(stroke.truth, stroke.closed, p[order], t[order], c[order])


def held(stroke: Stroke, share: float, count: int, cameras: int, seed: int, seconds: float = 10.0) -> Stroke:
    """Returns the stroke with the spot held still for a while, after `share` of the drawing time.

    Args:
        count: spots seen meanwhile, by all cameras together.
    """
    rng = np.random.default_rng([seed, 7])
    begin = share * stroke.stamps.max()
    near = np.argsort(np.abs(stroke.stamps - begin))[:5]
    place = np.median(stroke.points[near], axis=0)
    resumed = np.where(stroke.stamps > begin, stroke.stamps + seconds, stroke.stamps)
    moved = dataclasses.replace(stroke, stamps=resumed)
    stamps = begin + np.linspace(0.0, seconds, count)
    return _with(moved, place + rng.normal(0, 0.012, (count, 2)), stamps, np.arange(count) % cameras)


def beside(stroke: Stroke, distance: float, share: float) -> np.ndarray:
    """Returns a point (2,) at this distance [m] from the stroke, abreast of `share` of its length.

    It lies on the side with more room, or on the left if both have the same, with a tolerance for rounding.
    """
    dense = geometry.resample_chain(stroke.truth, 0.01, stroke.closed)
    k = int(np.clip(share * (len(dense) - 1), 5, len(dense) - 6))
    along = dense[k + 5] - dense[k - 5]
    normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    sides = [dense[k] + distance * normal, dense[k] - distance * normal]
    left, right = (np.linalg.norm(dense - place, axis=1).min() for place in sides)
    return sides[0] if left > right - 1e-6 else sides[1]


def with_fixed_place(
    stroke: Stroke, place, count: int, when: str, camera: int, seed: int, spread=(0.04, 0.02)
) -> Stroke:
    """Returns the stroke with false spots at one place, as a piece of paper causes them.

    Args:
        when: "at the same stamps" as the other camera's true spots, "interleaved" with the true spots of its own
            camera, "before" the drawing, "after" it, or "throughout", from 10 s before to 10 s after.
        spread: [m] standard deviation along and across the camera's line of sight.
    """
    rng = np.random.default_rng([seed, 11])
    end = stroke.stamps.max()
    if when == "at the same stamps":
        stamps = np.sort(rng.choice(stroke.stamps, count, replace=count > len(stroke.stamps)))
    elif when == "interleaved":
        stamps = np.sort(rng.uniform(0.0, end, count))
    else:
        first, last = {"before": (-10.0, 0.0), "after": (end, end + 10.0), "throughout": (-10.0, end + 10.0)}[when]
        stamps = np.linspace(first, last, count)
    angle = rng.uniform(0, np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    points = place + (rng.normal(0, 1, (count, 2)) * spread) @ turn.T
    return _with(stroke, points, stamps, np.full(count, camera))
