"""A ChArUco board on a floor under a camera with lens distortion, rendered pixel by pixel; and the camera."""

from __future__ import annotations

import math

import cv2
import numpy as np

from vb_core import geometry
from vb_core.camera_model import CameraModel
from vb_laser_detect.calibration.board import BoardParams, draw_board
from vb_laser_detect.detection.projection import floor_points, pixels_of

CAMERA = CameraModel(
    1920, 1080, np.array([[1100.0, 0, 950], [0, 1105.0, 545], [0, 0, 1]]), np.array([-0.2, 0.05, 0.001, -0.001, 0])
)
POSE = geometry.transform(geometry.rotation_from_rpy(math.pi + 0.06, 0.05, 0.7), (4.0, 2.5, 2.95))
_PPM = 2000.0  # [px/m] of the print
_MARGIN = 0.02  # [m] of white paper round the pattern


def corners_on_map(corners, p1, p2):
    """(N, 2) [m] in the map of a board's corners, with its upper left one at P1 and its upper edge towards P2."""
    along = np.subtract(p2, p1) / np.linalg.norm(np.subtract(p2, p1))
    return np.asarray(p1) + corners[:, :1] * along + corners[:, 1:] * (along[1], -along[0])


def p2_of(board: BoardParams, p1, yaw: float):
    """Where P2 lies, if the board lies with P1 there and turned by yaw [rad]."""
    return p1[0] + board.size[0] * math.cos(yaw), p1[1] + board.size[0] * math.sin(yaw)


def render_board(
    board: BoardParams, p1, p2, rng, camera=CAMERA, pose=POSE, noise: float = 3.0, samples: int = 2, image=None
):
    """(H, W) uint8: a grey floor, or the image given, with the board; blurred by the lens, with sensor noise."""
    border = int(_MARGIN * _PPM)
    paper = cv2.copyMakeBorder(draw_board(board, _PPM), *4 * [border], cv2.BORDER_CONSTANT, value=245)
    width, height = board.size
    around = np.array([[-0.05, -0.05], [width + 0.05, -0.05], [width + 0.05, height + 0.05], [-0.05, height + 0.05]])
    outline = pixels_of(camera, pose, np.column_stack([corners_on_map(around, p1, p2), np.zeros(4)]))
    left, top = np.maximum(0, np.floor(outline.min(axis=0))).astype(int)
    right, bottom = np.minimum((camera.width, camera.height), np.ceil(outline.max(axis=0))).astype(int)
    rows, columns = np.mgrid[top:bottom, left:right].astype(float)
    along = np.subtract(p2, p1) / np.linalg.norm(np.subtract(p2, p1))
    down = np.array([along[1], -along[0]])
    if image is None:
        picture = np.full((camera.height, camera.width), 110.0, np.float32)
    else:
        picture = image.astype(np.float32)
    patch = np.zeros(rows.shape, np.float32)
    weight = np.zeros(rows.shape, np.float32)
    steps = (np.arange(samples) + 0.5) / samples - 0.5
    for dv in steps:
        for du in steps:
            pixels = np.column_stack([(columns + du).ravel(), (rows + dv).ravel()])
            floor = floor_points(camera, pose, pixels)[:, :2] - np.asarray(p1)
            # the first texel's centre lies half a texel within the paper
            at = [
                ((floor @ axis) * _PPM + border - 0.5).reshape(rows.shape).astype(np.float32) for axis in (along, down)
            ]
            patch += cv2.remap(
                paper.astype(np.float32), *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0
            )
            weight += cv2.remap(
                np.ones_like(paper, np.float32), *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0
            )
    share = weight / samples**2
    cut = picture[top:bottom, left:right]
    picture[top:bottom, left:right] = cut * (1 - share) + share * 20 + 0.7 * patch / samples**2
    picture = cv2.GaussianBlur(picture, (0, 0), 0.7)
    return np.clip(picture + rng.normal(0, noise, picture.shape), 0, 255).astype(np.uint8)
