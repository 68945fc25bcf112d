"""Computes which floor a stationary camera sees, from its pose, its lens and the obstacles in its view."""

from __future__ import annotations

import math

import numpy as np

from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_robot.clearance_map import BLOCKED_THRESHOLD
from vb_robot.floor_view import FloorView

IMAGE_MARGIN = 8.0  # [px] a spot nearer to the image's edge is cut off by it
MAX_DISTANCE = 6.0  # [m] from camera to spot: detectors reject smaller spots
OBSTACLE_HEIGHT = 0.5  # [m] of what the map shows, which does not tell heights; higher things hide more than is thought


def floor_seen(grid: GridMap, camera: CameraModel, T_map_camera: np.ndarray) -> np.ndarray:
    """Returns (H, W) bool: of which cells the camera sees the centre on the floor (z = 0).

    Args:
        grid: the map: where floor is, and what stands on it.
        camera: intrinsic parameters, with distortion.
        T_map_camera: (4, 4) pose of the optical frame in the map.

    Raises:
        CodedError: "bad_camera_pose" if the camera is not above the floor.
    """
    eye = np.asarray(T_map_camera, dtype=float)[:3, 3]
    if eye[2] <= 0.0:
        raise CodedError("bad_camera_pose", f"the camera must be above the map's floor, it is at z = {eye[2]:.2f} m")
    seen = np.zeros(grid.shape, dtype=bool)
    cells = np.argwhere(grid.data < BLOCKED_THRESHOLD)
    places = grid.cell_to_world(cells)
    margin = IMAGE_MARGIN / np.array([camera.width, camera.height])
    inside = FloorView(camera, T_map_camera, math.inf).sees(places, margin)
    inside &= np.linalg.norm(np.column_stack([places, np.zeros(len(places))]) - eye, axis=1) <= MAX_DISTANCE
    cells, places = cells[inside], places[inside]
    free = ~_hidden(grid, places, eye)
    seen[cells[free, 0], cells[free, 1]] = True
    return seen


def _hidden(grid: GridMap, places: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """Returns (N,) bool: from which floor places (N, 2) [m] the camera at `eye` (3,) [m] is hidden."""
    hidden = np.zeros(len(places), dtype=bool)
    away = eye[:2] - places
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    # the ray climbs from the floor to the camera: above OBSTACLE_HEIGHT nothing can block it
    units, reach = away / distance[:, None], distance * min(1.0, OBSTACLE_HEIGHT / eye[2])
    step = 0.5 * grid.resolution
    for along in np.arange(step, float(reach.max(initial=0.0)), step):
        open_rays = np.flatnonzero(~hidden & (along < reach))
        cells = grid.world_to_cell(places[open_rays] + along * units[open_rays])
        inside = grid.contains_cells(cells)
        open_rays, cells = open_rays[inside], cells[inside]
        hidden[open_rays] = grid.data[cells[:, 0], cells[:, 1]] >= BLOCKED_THRESHOLD
    return hidden
