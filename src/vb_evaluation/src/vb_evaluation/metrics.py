"""The paper's measures (Sect. 5.5) and the proof that a border acts."""
from __future__ import annotations

import numpy as np

from vb_core.errors import CodedError
from vb_core.geometry import resample_chain
from vb_core.grid_map import GridMap

# move_base plans through no cell at or above this value (costmap_2d: inscribed obstacle)
RESTRICTED = 99


def jaccard(gt: np.ndarray, ud: np.ndarray) -> float:
    """Jaccard similarity index |GT and UD| / |GT or UD|, 0 to 1 (paper, Sect. 5.5).

    Args:
        gt: bool array, the cells of the ground truth.
        ud: bool array of the same shape, the cells that the user restricted.

    Returns:
        1.0 if both are empty: they agree.

    Raises:
        CodedError: "bad_shape" if the shapes differ.
    """
    gt, ud = np.asarray(gt, bool), np.asarray(ud, bool)
    if gt.shape != ud.shape:
        raise CodedError("bad_shape", f"the ground truth has {gt.shape} cells, the user's map {ud.shape}")
    union = int(np.count_nonzero(gt | ud))
    return int(np.count_nonzero(gt & ud)) / union if union else 1.0


def restricted_cells(prior: GridMap, posterior: GridMap) -> np.ndarray:
    """(H, W) bool: free cells of the physical map that the posterior restricts.

    Raises:
        CodedError: "bad_map" if the two maps do not have the same geometry.
    """
    if not prior.same_geometry(posterior):
        raise CodedError("bad_map", "physical and posterior map differ in size, resolution or origin")
    return (prior.data >= 0) & (prior.data < RESTRICTED) & (posterior.data >= RESTRICTED)


def crosses(path: np.ndarray, grid: GridMap, region: np.ndarray) -> bool:
    """Whether a path (N, 2) [m] meets a region, (H, W) bool in the grid's geometry."""
    path = np.asarray(path, dtype=float).reshape(-1, 2)
    if len(path) == 0:
        return False
    # half a cell: no cell wider than a sliver at its corner is stepped over
    cells = grid.world_to_cell(resample_chain(path, grid.resolution / 2.0))
    cells = cells[grid.contains_cells(cells)]
    return bool(np.asarray(region, bool)[cells[:, 0], cells[:, 1]].any())
