"""Computes the paper's measures (Sect. 5.5), and whether a path crosses or enters a border.

Use it to compare a border in a map with the intended one, whatever drew it.

>>> import numpy as np
>>> wanted, drawn = np.zeros((10, 10), bool), np.zeros((10, 10), bool)
>>> wanted[2:8, 2:8] = drawn[2:8, 2:5] = True
>>> jaccard(wanted, drawn)
0.5
"""

from __future__ import annotations

from typing import Dict, NamedTuple, Optional

import numpy as np
from scipy.spatial import cKDTree

from vb_core.errors import CodedError
from vb_core.geometry import resample_chain
from vb_core.grid_map import GridMap, sample

# move_base plans through no cell at or above this value (costmap_2d: inscribed obstacle)
RESTRICTED = 99
ERRORS = ("error_mean_cm", "error_p95_cm", "error_max_cm")


def jaccard(truth: np.ndarray, drawn: np.ndarray) -> float:
    """Computes the Jaccard similarity index |truth and drawn| / |truth or drawn|, 0 to 1 (paper, Sect. 5.5).

    Args:
        truth: bool array, the cells of the ground truth.
        drawn: bool array of the same shape, the cells that the user restricted.

    Returns:
        1.0 if both are empty: they agree.

    Raises:
        CodedError: "bad_shape" if the shapes differ.
    """
    truth = np.asarray(truth, bool)
    drawn = np.asarray(drawn, bool)
    if truth.shape != drawn.shape:
        raise CodedError("bad_shape", f"the ground truth has {truth.shape} cells, the user's map {drawn.shape}")
    union = int(np.count_nonzero(truth | drawn))
    return int(np.count_nonzero(truth & drawn)) / union if union else 1.0


def restricted_cells(prior: GridMap, posterior: GridMap) -> np.ndarray:
    """Returns which of the physical map's free cells are restricted in the map with borders: (H, W) bool.

    Raises:
        CodedError: "bad_map" if the two maps do not have the same geometry.
    """
    if not prior.same_geometry(posterior):
        raise CodedError("bad_map", "physical and posterior map differ in size, resolution or origin")
    return free_cells(prior) & (posterior.data >= RESTRICTED)


def free_cells(grid: GridMap) -> np.ndarray:
    """Returns which cells of a map move_base plans through: (H, W) bool."""
    return (grid.data >= 0) & (grid.data < RESTRICTED)


class BoundaryError(NamedTuple):
    """Distances [m] between the requested boundary and the one that the robot respects, both directions pooled."""

    mean: float
    p95: float
    largest: float


def boundary_error(prior: GridMap, truth: np.ndarray, restricted: np.ndarray) -> Optional[BoundaryError]:
    """Measures how far the restricted area's boundary is from the requested one.

    A boundary consists of the edges between a free cell inside and a free one outside, since nothing was drawn
    where the area ends at a wall. From each edge's middle the distance to the nearest edge of the other
    boundary is taken, in both directions, so that a missing part counts like a superfluous one. The grid rounds
    each distance to about half a cell.

    Args:
        prior: the physical map.
        truth, restricted: (H, W) bool.

    Returns:
        None if one of the two areas has no boundary on free floor.
    """
    free = free_cells(prior)
    requested = _edges(np.asarray(truth, bool), free) * prior.resolution
    drawn = _edges(np.asarray(restricted, bool), free) * prior.resolution
    if not len(requested) or not len(drawn):
        return None
    to_drawn, _ = cKDTree(drawn).query(requested)
    to_requested, _ = cKDTree(requested).query(drawn)
    distances = np.concatenate([to_drawn, to_requested])
    p95 = float(np.percentile(distances, 95))
    return BoundaryError(float(distances.mean()), p95, float(distances.max()))


def accuracy(prior: GridMap, truth: np.ndarray, restricted: np.ndarray) -> Dict[str, object]:
    """Computes a run's accuracy columns: Jaccard index, and boundary error [cm], empty where there is none.

    Values are rounded: their last bits differ between processors and libraries, and mean nothing.
    """
    error = boundary_error(prior, truth, restricted)
    values_cm = ("", "", "") if error is None else (round(100.0 * value, 2) for value in error)
    return {"jaccard": round(jaccard(truth, restricted), 4), **dict(zip(ERRORS, values_cm))}


def _edges(area: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Returns the middles (N, 2) [cells] of the edges between free cells of which one is inside."""
    across = (area[:, 1:] != area[:, :-1]) & free[:, 1:] & free[:, :-1]
    along = (area[1:] != area[:-1]) & free[1:] & free[:-1]
    return np.vstack([np.argwhere(across) + (0.0, 0.5), np.argwhere(along) + (0.5, 0.0)])


def path_meets_region(path: np.ndarray, grid: GridMap, region: np.ndarray) -> bool:
    """Returns whether a path (N, 2) [m] meets a region, (H, W) bool in the grid's geometry."""
    return bool(_is_within(path, grid, region).any())


def path_enters_region(path: np.ndarray, grid: GridMap, region: np.ndarray) -> bool:
    """Returns whether a path (N, 2) [m] comes into a region from outside. One that begins within may leave it."""
    within = _is_within(path, grid, region)
    return bool((within[1:] & ~within[:-1]).any())


def _is_within(path: np.ndarray, grid: GridMap, region: np.ndarray) -> np.ndarray:
    """Returns which points sampled along a path are in a region, (M,) bool. Those off the map are not."""
    path = np.asarray(path, dtype=float).reshape(-1, 2)
    if len(path) == 0:
        return np.zeros(0, dtype=bool)
    # half a cell: only a sliver at a cell's corner can be stepped over
    samples = resample_chain(path, grid.resolution / 2.0)
    return sample(grid, np.asarray(region, bool), samples, outside=0.0) > 0


def enclosed_cells(floor: np.ndarray, restricted: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Returns the cells inside a border: the restricted ones or, if most floor is to be restricted, the free ones.

    Args:
        floor, restricted, truth: (H, W) bool; the floor without borders, its restricted cells, those to restrict.
    """
    return restricted if 2 * truth.sum() <= floor.sum() else floor & ~restricted
