"""Changes to a border's vertices, as a person makes them with a mouse. Each returns a new, checked border."""

from __future__ import annotations

from typing import Sequence

import numpy as np
import shapely

from vb_core.errors import CodedError
from vb_map_integration.border import VirtualBorder


def move_vertex(border: VirtualBorder, index: int, point: Sequence[float]) -> VirtualBorder:
    """Moves one vertex of a border to (x, y) [m]; raises what `VirtualBorder` raises."""
    points = np.array(border.points)
    points[index] = point
    return border.replace(points=points)


def move_seed(border: VirtualBorder, point: Sequence[float]) -> VirtualBorder:
    """Moves the seed of a border to (x, y) [m]; raises what `VirtualBorder` raises."""
    return border.replace(seed=np.array(point, dtype=float))


def insert_vertex(border: VirtualBorder, index: int) -> VirtualBorder:
    """Adds a vertex half way from a vertex to the next; for a curve's last one, before it."""
    points = border.points
    if not border.closed and index == len(points) - 1:
        index -= 1
    middle = (points[index] + points[(index + 1) % len(points)]) / 2.0
    return border.replace(points=np.insert(points, index + 1, middle, axis=0))


def remove_vertex(border: VirtualBorder, index: int) -> VirtualBorder:
    """Removes a vertex.

    Raises:
        CodedError: "too_few_points" if it would not be a border any more.
    """
    least = 3 if border.closed else 2
    if len(border.points) <= least:
        raise CodedError("too_few_points", least=least, count=len(border.points) - 1)
    return border.replace(points=np.delete(border.points, index, axis=0))


def simplify(border: VirtualBorder, tolerance: float) -> VirtualBorder:
    """Leaves as few vertices as keep the border within a distance [m] of the original (Douglas and Peucker)."""
    points = border.points
    chain = np.concatenate([points, points[:1]]) if border.closed else points
    thinned = shapely.get_coordinates(shapely.linestrings(chain).simplify(tolerance))
    if border.closed:
        thinned = thinned[:-1]
    return border.replace(points=thinned) if len(thinned) >= (3 if border.closed else 2) else border


def new_border(center: Sequence[float], size: float, closed: bool) -> VirtualBorder:
    """Makes a square of an edge length [m], or a line of that length, to be dragged to where it is wanted."""
    points, seed = [(0.0, -0.5), (0.0, 0.5)], (0.5, 0.0)
    if closed:
        points, seed = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)], (0.0, 0.0)
    middle = np.asarray(center, dtype=float)
    return VirtualBorder(middle + size * np.array(points), middle + size * np.array(seed), closed=closed)
