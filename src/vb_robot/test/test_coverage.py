"""What a camera sees of the floor, against views worked out by hand and by other means."""

import math

import numpy as np
import pytest
from shapely.geometry import LineString, box

from vb_core import geometry
from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_robot.coverage import IMAGE_MARGIN, MAX_DISTANCE, OBSTACLE_HEIGHT, floor_seen

LENS = CameraModel.ideal(1600, 1000, 800.0)
# looks straight down, the image's top is +y: the camera's z is -z of the map
DOWN = np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]])


def above(x, y, height):
    return geometry.transform(DOWN, (x, y, height))


def room(width=8.0, height=6.0, resolution=0.05):
    return GridMap(np.zeros((int(round(height / resolution)), int(round(width / resolution))), np.int8), resolution)


def places(grid, mask):
    return grid.cell_to_world(np.argwhere(mask))


def test_camera_straight_above_sees_a_rectangle():
    grid = room()
    seen = floor_seen(grid, LENS, above(4.0, 3.0, 3.0))
    # 1600 px at a focal length of 800 px are 2 m per metre of height, 1000 px 1.25 m
    x, y = np.abs(places(grid, np.ones(grid.shape, bool)) - (4.0, 3.0)).T
    assert seen.ravel()[(x < 2.95) & (y < 1.83)].all() and not seen.ravel()[(x > 3.05) | (y > 1.92)].any()


def test_shadows_are_those_of_the_rays():
    grid = room()
    data = grid.data.copy()
    data[70:80, 100:110] = 100  # x from 5.0 to 5.5 m, y from 3.5 to 4.0 m
    grid = grid.with_data(data)
    eye = np.array([4.0, 3.0, 3.0])
    seen = floor_seen(grid, LENS, above(*eye))
    thing = box(5.0, 3.5, 5.5, 4.0)
    rng = np.random.default_rng(1)
    checked = 0
    for row, column in rng.integers((30, 60), (95, 140), (600, 2)):
        x, y = grid.cell_to_world(np.array([[row, column]]))[0]
        if data[row, column] or not (abs(x - 4.0) < 2.9 and abs(y - 3.0) < 1.8):
            continue
        # up to so high a thing it runs over this share of its way on the floor
        low = LineString([(x, y), np.array([x, y]) + (eye[:2] - (x, y)) * OBSTACLE_HEIGHT / eye[2]])
        gap = low.distance(thing)
        if 0.0 < gap < 0.06 or (gap == 0.0 and low.intersection(thing).length < 0.06):
            continue  # too near to the edge for cells of 5 cm
        assert seen[row, column] == (gap > 0.0), (x, y)
        checked += 1
    assert checked > 300


def test_tilted_camera_with_distortion_agrees_with_the_rays_of_its_pixels():
    grid = room()
    lens = CameraModel(1600, 1000, LENS.matrix, np.array([-0.06, 0.01, 0.0, 0.0, 0.0]))
    body = geometry.rotation_from_rpy(0.0, math.radians(55.0), math.radians(30.0))
    pose = geometry.transform(body @ geometry.optical_rotation(), (1.0, 1.0, 2.5))
    seen = floor_seen(grid, lens, pose)
    rng = np.random.default_rng(2)
    rays = (
        lens.rays(rng.uniform(IMAGE_MARGIN + 5.0, (1594 - IMAGE_MARGIN, 994 - IMAGE_MARGIN), (2000, 2)))
        @ pose[:3, :3].T
    )
    hits = [pose[:3, 3] - ray * pose[2, 3] / ray[2] for ray in rays if ray[2] < -0.05]
    cells = grid.world_to_cell(np.array(hits)[:, :2])
    near = np.linalg.norm(np.array(hits) - pose[:3, 3], axis=1) < MAX_DISTANCE - 0.1
    cells = cells[grid.contains_cells(cells) & near]
    assert len(cells) > 300
    assert seen[cells[:, 0], cells[:, 1]].mean() > 0.97
    corners = np.array([[-0.5, -0.5], [1599.5, -0.5], [1599.5, 999.5], [-0.5, 999.5]])
    floor = np.column_stack([places(grid, seen), np.zeros(seen.sum())])
    outside = lens.project(geometry.apply(geometry.invert(pose), floor))
    assert (outside >= corners.min(axis=0)).all() and (outside <= corners.max(axis=0)).all()


def test_camera_below_the_floor_is_refused():
    grid = room()
    with pytest.raises(CodedError) as caught:
        floor_seen(grid, LENS, above(4.0, 3.0, -1.0))
    assert caught.value.code == "bad_camera_pose"
