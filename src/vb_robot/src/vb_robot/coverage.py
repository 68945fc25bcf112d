"""Computes which floor a stationary camera sees, from its pose, its lens and what blocks its view."""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Mapping

import cv2
import numpy as np

from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError, ParameterError
from vb_core.grid_map import GridMap
from vb_core.parameters import Parameters, param
from vb_robot.clearance_map import OCCUPIED
from vb_robot.dispatching.view import FloorView


@dataclass(frozen=True)
class CoverageParams(Parameters):
    """What counts as seen."""

    image_margin: float = param(8.0, "px", low=0.0, high=500.0, doc="a spot nearer to the image's edge does not count")
    max_distance: float = param(6.0, "m", above=0.0, high=100.0, doc="from camera to spot; farther, it is too small")
    obstacle_height: float = param(0.5, "m", low=0.0, high=10.0, doc="of what the map shows, if nothing else is known")
    heights: list = param([], "m", doc="[x_min, y_min, x_max, y_max, height]: what is known better")

    def __post_init__(self) -> None:
        super().__post_init__()
        for entry in self.heights:
            numbers = isinstance(entry, (list, tuple)) and all(isinstance(value, (int, float)) for value in entry)
            if not numbers or len(entry) != 5 or entry[0] > entry[2] or entry[1] > entry[3] or entry[4] < 0:
                raise ParameterError("heights", f"expected [x_min, y_min, x_max, y_max, height], got {entry!r}")


def obstacle_heights(grid: GridMap, params: CoverageParams) -> np.ndarray:
    """(H, W) float32 [m] how high things are: 0 where the map is free or unknown."""
    occupied = grid.data >= OCCUPIED
    heights = np.where(occupied, np.float32(params.obstacle_height), np.float32(0.0))
    for x_min, y_min, x_max, y_max, height in params.heights:
        corners = np.array([[x_min, y_min], [x_max, y_min], [x_max, y_max], [x_min, y_max]])
        mask = np.zeros(grid.shape, np.uint8)
        # the mask takes every cell that the outline touches
        cv2.fillPoly(mask, [np.rint(grid.world_to_grid(corners)).astype(np.int32)], 1)
        heights[occupied & (mask > 0)] = height
    return heights


def floor_seen(
    grid: GridMap, heights: np.ndarray, camera: CameraModel, T_map_camera: np.ndarray, params: CoverageParams
) -> np.ndarray:
    """(H, W) bool: the cells whose centre on the floor (z = 0) the camera sees.

    Args:
        grid: where the floor is.
        heights: (H, W) [m] of what is in each cell of the grid; higher things hide what is behind them.
        camera: intrinsic parameters, with distortion.
        T_map_camera: (4, 4) pose of the optical frame in the map.

    Raises:
        CodedError: "bad_camera_pose" if the camera is not above the floor.
    """
    eye = np.asarray(T_map_camera, dtype=float)[:3, 3]
    if eye[2] <= 0.0:
        raise CodedError("bad_camera_pose", f"the camera must be above the map's floor, it is at z = {eye[2]:.2f} m")
    seen = np.zeros(grid.shape, dtype=bool)
    cells = np.argwhere(heights <= 0.0)
    places = grid.cell_to_world(cells)
    margin = params.image_margin / np.array([camera.width, camera.height])
    inside = FloorView(camera, T_map_camera, math.inf).sees(places, margin)
    inside &= np.linalg.norm(np.column_stack([places, np.zeros(len(places))]) - eye, axis=1) <= params.max_distance
    cells, places = cells[inside], places[inside]
    free = ~_hidden(grid, heights, places, eye)
    seen[cells[free, 0], cells[free, 1]] = True
    return seen


def combined(grid: GridMap, seen: Mapping[str, np.ndarray]) -> np.ndarray:
    """(H, W) int8: how many cameras see each cell, at most 100; -1 where the map has no free floor."""
    count = np.zeros(grid.shape, dtype=np.int16)
    for mask in seen.values():
        count += mask
    values = np.minimum(count, 100).astype(np.int8)
    values[(grid.data < 0) | (grid.data >= OCCUPIED)] = -1
    return values


def outlines(grid: GridMap, seen: np.ndarray, least_m2: float = 0.05) -> List[np.ndarray]:
    """Closed outlines (N, 2) [m] of a mask (H, W), without specks."""
    found, _ = cv2.findContours(seen.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    least = least_m2 / grid.resolution ** 2
    return [grid.grid_to_world(contour[:, 0, :]) for contour in found if cv2.contourArea(contour) >= least]


def _hidden(grid: GridMap, heights: np.ndarray, places: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """(N,) bool: from which floor places (N, 2) [m] the camera at `eye` (3,) [m] is hidden."""
    hidden = np.zeros(len(places), dtype=bool)
    highest = float(heights.max()) if heights.size else 0.0
    if highest <= 0.0 or not len(places):
        return hidden
    away = eye[:2] - places
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    units, slope = away / distance[:, None], eye[2] / distance
    # the ray climbs from the floor to the camera: above the highest thing nothing can block it
    reach = np.minimum(distance, highest / slope)
    step = 0.5 * grid.resolution
    for along in np.arange(step, float(reach.max()) + step, step):
        open_rays = np.flatnonzero(~hidden & (along <= reach))
        if not len(open_rays):
            continue
        cells = grid.world_to_cell(places[open_rays] + along * units[open_rays])
        inside = grid.contains_cells(cells)
        open_rays, cells = open_rays[inside], cells[inside]
        hidden[open_rays] = heights[cells[:, 0], cells[:, 1]] > along * slope[open_rays]
    return hidden
