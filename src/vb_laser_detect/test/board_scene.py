"""A ceiling camera, and renderings of a ChArUco board on the floor below it; a wide camera before which it is held."""

from __future__ import annotations

import itertools
import math

import cv2
import numpy as np

from vb_core import geometry
from vb_core.camera_model import CameraModel, project_to_floor, project_to_pixels
from vb_laser_detect.calibration.lens import BoardParams, BoardView, draw_board

CAMERA = CameraModel(1920, 1080, [[1100.0, 0, 950], [0, 1105.0, 545], [0, 0, 1]], [-0.2, 0.05, 0.001, -0.001, 0])
POSE = geometry.make_transform(geometry.rotation_from_rpy(math.pi + 0.06, 0.05, 0.7), (4.0, 2.5, 2.95))
WIDE_CAMERA = CameraModel(1280, 720, [[820.0, 0, 655], [0, 824.0, 350], [0, 0, 1]], [-0.25, 0.08, 0.001, 0, 0])
_PPM = 2000.0  # [px/m] of the printed board
_MARGIN = 0.02  # [m] of white paper round the pattern
_FLOOR = 110.0  # grey level


def axes_of(yaw: float):
    """Returns (2, 2), the directions in the map of a board's upper and left edge, for a board turned by yaw [rad]."""
    return np.array([[math.cos(yaw), math.sin(yaw)], [math.sin(yaw), -math.cos(yaw)]])


def corners_on_map(corners, p1, yaw: float):
    """Returns (N, 2) [m], a board's corners in the map, with its upper left one at P1, turned by yaw [rad]."""
    return np.asarray(p1) + corners @ axes_of(yaw)


def render_board(board: BoardParams, p1, yaw: float, rng):
    """Renders (H, W) uint8, a grey floor with the board on it, with lens blur and sensor noise."""
    border = int(_MARGIN * _PPM)
    paper = cv2.copyMakeBorder(draw_board(board, _PPM), *4 * [border], cv2.BORDER_CONSTANT, value=245)
    lit = (20.0 + 0.7 * paper).astype(np.float32)
    picture = np.full((CAMERA.height, CAMERA.width), _FLOOR, np.float32)
    around = np.array([(x, y) for x in (-0.05, board.size[0] + 0.05) for y in (-0.05, board.size[1] + 0.05)])
    outline = project_to_pixels(CAMERA, POSE, np.column_stack([corners_on_map(around, p1, yaw), np.zeros(4)]))
    left, top = np.maximum(0, np.floor(outline.min(axis=0))).astype(int)
    right, bottom = np.minimum((CAMERA.width, CAMERA.height), np.ceil(outline.max(axis=0))).astype(int)
    rows, columns = np.mgrid[top:bottom, left:right].astype(float)
    renderings = []
    for du, dv in itertools.product((-0.25, 0.25), repeat=2):  # [px] each pixel is the mean of four rays
        floor = project_to_floor(CAMERA, POSE, np.column_stack([(columns + du).ravel(), (rows + dv).ravel()]))[:, :2]
        # the first texel's centre lies half a texel inside the paper
        texels = ((floor - p1) @ axes_of(yaw).T * _PPM + border - 0.5).reshape(*rows.shape, 2).astype(np.float32)
        renderings.append(cv2.remap(lit, texels, None, cv2.INTER_LINEAR, None, cv2.BORDER_CONSTANT, _FLOOR))
    picture[top:bottom, left:right] = np.mean(renderings, axis=0)
    picture = cv2.GaussianBlur(picture, (0, 0), 0.7)
    return np.clip(picture + rng.normal(0, 3.0, picture.shape), 0, 255).astype(np.uint8)


def view_held_board(camera: CameraModel, rng, tilt: float = 0.6) -> BoardView:
    """Returns the view of a board that a person holds in front of the camera, turned at random by up to `tilt` [rad]."""
    corners = BoardParams.for_paper("A3").opencv().getChessboardCorners()
    distance = rng.uniform(0.4, 0.9) * camera.focal_px / 820.0
    pixel = np.array([[rng.uniform(0, camera.width), rng.uniform(0, camera.height)]])
    middle = camera.pixels_to_rays(pixel)[0] * distance
    turn = geometry.rotation_from_rpy(*rng.uniform(-tilt, tilt, 2), rng.uniform(-math.pi, math.pi))
    points = (corners - corners.mean(axis=0)) @ turn.T + middle
    pixels = camera.project(points) + rng.normal(0.0, 0.15, (len(points), 2))
    inside = camera.contains(pixels)
    return BoardView(pixels[inside], corners[inside, :2].astype(float), np.flatnonzero(inside))
