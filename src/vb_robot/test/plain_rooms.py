"""Rooms that several tests of this package share, and a typical robot's camera and scanner."""

import math

import numpy as np

from vb_core import geometry
from vb_core.camera_model import CameraModel
from vb_core.grid_map import GridMap
from vb_robot.driving.scan_clearance import Scan
from vb_robot.dispatching.viewpoint import RobotCameraView

# an ideal camera with a 58 degree field of view, 0.45 m above the floor, pitched 30 degrees down
CAMERA = CameraModel.ideal(640, 480, 320.0 / math.tan(math.radians(29.0)))
PITCHED = geometry.rotation_from_rpy(0, math.pi / 6, 0) @ geometry.optical_rotation()
VIEW = RobotCameraView(CAMERA, geometry.make_transform(PITCHED, (0.1, 0, 0.45)))


def empty(width=8.0, height=5.0, resolution=0.025):
    """Returns a map of an empty floor with its origin at (0, 0)."""
    return GridMap(np.zeros((round(height / resolution), round(width / resolution)), np.int8), resolution)


def room(width=8.0, height=5.0, resolution=0.05):
    """Returns the same with walls one cell thick."""
    grid = empty(width, height, resolution)
    grid.data[[0, -1]], grid.data[:, [0, -1]] = 100, 100
    return grid


def with_border(grid, x0, y0, x1, y1, value=100):
    """Returns a grid with a rectangle [m] of this value."""
    data = grid.data.copy()
    (row0, column0), (row1, column1) = grid.world_to_cell(np.array([[x0, y0], [x1, y1]]) + 1e-9)
    data[row0:row1, column0:column1] = value
    return grid.with_data(data)


def scan_of(ranges, first=None, step=math.radians(1.0), mount=np.eye(4), radius=0.18, **options):
    """Returns a typical scanner's scan: beams a step [rad] apart, from `first` on, or centred on straight ahead."""
    ranges = np.asarray(ranges, float)
    first = -0.5 * step * (len(ranges) - 1) if first is None else first
    return Scan(ranges, first, step, 0.12, 8.0, mount, radius, **options)
