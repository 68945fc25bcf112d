"""Closed-loop simulation of the servoing on a unicycle, and the free way it relies on."""
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from vb_core.errors import ParameterError
from vb_core.grid_map import GridMap
from vb_robot.safety import ForbiddenGround, SafetyParams, arc, free_by_scan, safe_speed, scan_points
from vb_robot.servoing import Servo, ServoParams
from vb_robot.view import FloorView, ViewParams, to_base

PARAMS, SAFETY, VIEW = ServoParams(), SafetyParams(), FloorView(ViewParams())
DT = 1.0 / 15.0


def empty(width=8.0, height=5.0, resolution=0.025):
    return GridMap(np.zeros((int(height / resolution), int(width / resolution)), dtype=np.int8), resolution)


def follow(path, speed, pose, grid=None, latency=0.12, noise=0.0, extra=4.0):
    """Drags a spot along a path; rows of (t, x, y, yaw, v, w, visible, spot distance)."""
    path = np.asarray(path, dtype=float)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    ground = ForbiddenGround(grid or empty(), SAFETY)
    servo = Servo(PARAMS, SAFETY, VIEW)
    rng = np.random.default_rng(7)
    x, y, yaw = pose
    sightings, rows = [], []
    for i in range(int((length[-1] / speed + extra) / DT)):
        t = i * DT
        spot = np.array([np.interp(t * speed, length, path[:, k]) for k in range(2)])
        visible = bool(VIEW.sees(to_base(spot[None], (x, y, yaw)))[0])
        if visible:
            sightings.append((t, spot + rng.normal(0.0, noise, 2) if noise else spot))
        known = [s for s in sightings if s[0] <= t - latency]
        place = to_base(known[-1][1][None], (x, y, yaw))[0] if known else None
        motion = servo.step(DT, place, t - known[-1][0] if known else 0.0,
                            lambda v, w: ground.free_way((x, y, yaw), v, w))
        middle = yaw + 0.5 * motion.w * DT
        x, y, yaw = x + motion.v * DT * math.cos(middle), y + motion.v * DT * math.sin(middle), yaw + motion.w * DT
        rows.append((t, x, y, yaw, motion.v, motion.w, visible, math.dist((x, y), spot)))
    return np.array(rows)


def check_limits(run, brake=False):
    v, w = run[:, 4], run[:, 5]
    assert np.abs(v).max() <= 0.2 + 1e-9
    assert v.min() >= -PARAMS.max_back_speed - 1e-9
    assert np.abs(w).max() <= PARAMS.max_turn + 1e-9
    limit = SAFETY.brake if brake else PARAMS.acceleration
    assert np.abs(np.diff(v, prepend=0.0)).max() <= limit * DT + 1e-9
    assert np.abs(np.diff(w, prepend=0.0)).max() <= PARAMS.turn_acceleration * DT + 1e-9


CIRCLE = np.column_stack([3 - np.cos(np.linspace(0, 2 * np.pi, 100)), 2.5 - np.sin(np.linspace(0, 2 * np.pi, 100))])
RECTANGLE = np.array([[2, 2.0], [4, 2.0], [4, 3.25], [2, 3.25], [2, 2.0]])


@pytest.mark.parametrize("speed", [0.1, 0.2])
@pytest.mark.parametrize(
    "path", [[[2, 2.5], [6, 2.5]], [[2, 2.5], [2, 4.5]], CIRCLE, RECTANGLE, RECTANGLE[::-1]],
    ids=["line away", "line sideways", "circle", "rectangle", "rectangle clockwise"],
)
def test_spot_stays_in_view(path, speed):
    start = np.asarray(path, dtype=float)[0]
    run = follow(path, speed, (start[0] - 1.0, start[1] + 0.1, 0.0), noise=0.003)
    check_limits(run)
    assert run[:, 6].all(), f"lost at {run[run[:, 6] == 0][0, 0]:.1f} s"
    assert run[:, 7].min() > 0.4
    assert abs(run[-1, 4]) < 0.01 and abs(run[-1, 5]) < 0.05, "it comes to rest with the spot"
    assert PARAMS.near_distance <= run[-1, 7] <= PARAMS.far_distance


def test_backs_off_from_a_spot_that_comes_near():
    run = follow([[4.0, 2.5], [1.5, 2.5]], 0.2, (3.0, 2.4, 0.0))
    check_limits(run)
    assert run[:, 6].all(), "a stroke towards the robot at full speed does not slip out of the image below"
    assert run[-1, 7] >= PARAMS.near_distance
    assert run[:, 4].min() < -0.02


def test_small_strokes_leave_it_at_rest():
    zigzag = [[2.0 + 0.05 * (i % 2), 2.5 + 0.1 * (i % 2)] for i in range(20)]
    assert np.abs(follow(zigzag, 0.2, (1.0, 2.5, 0.0))[:, 4:6]).max() == 0.0


@settings(max_examples=6, deadline=None)
@given(st.floats(-0.5, 0.5), st.integers(0, 5), st.floats(0.1, 0.3))
def test_footprint_never_enters_a_border(yaw, seed, speed):
    rng = np.random.default_rng(seed)
    grid = empty()
    data = grid.data.copy()
    for row, column in rng.integers((10, 70), (180, 300), (6, 2)):
        data[row:row + 20, column:column + 20] = 100
    data[80:120, 20:60] = 0
    grid = grid.with_data(data)
    path = np.array([[2.0, 2.5], [3.5, rng.uniform(1, 4)], [6.0, rng.uniform(1, 4)], [4.0, 2.5]])
    run = follow(path, speed, (1.0, 2.5, yaw), grid)
    assert np.abs(run[:, 4]).max() <= 0.2 + 1e-9
    blocked = grid.cell_to_world(np.argwhere(grid.data >= 99))
    near = cKDTree(blocked).query_ball_point(run[:, 1:3], 0.25)
    for place, cells in zip(run[:, 1:3], near):
        # to the square of a cell, not to its centre
        gaps = np.hypot(*np.maximum(np.abs(blocked[cells] - place) - grid.resolution / 2.0, 0.0).T)
        assert (gaps >= SAFETY.robot_radius).all()


def driving():
    """A servo at full speed."""
    servo = Servo(PARAMS, SAFETY, VIEW)
    for _ in range(20):
        motion = servo.step(DT, np.array([2.5, 0.3]), 0.05, lambda v, w: math.inf)
    assert motion.v == pytest.approx(0.2)
    return servo


@pytest.mark.parametrize("spot, age", [(None, 0.0), (np.array([2.5, 0.0]), 0.51), (np.array([2.5, 0.0]), -1.0),
                                       (np.array([np.nan, 0.0]), 0.0)])
def test_stands_within_0_3_s_when_the_spot_is_gone(spot, age):
    servo = driving()
    motions = [servo.step(DT, spot, age, lambda v, w: math.inf) for _ in range(4)]
    assert (motions[-1].v, motions[-1].w) == (0.0, 0.0)


@pytest.mark.parametrize("free", [0.0, -0.1, None])
def test_stands_within_0_3_s_before_an_obstacle(free):
    servo = driving()
    assert [servo.step(DT, np.array([2.5, 0.3]), 0.05, lambda v, w: free) for _ in range(4)][-1].v == 0.0


def test_no_time_no_motion():
    assert Servo(PARAMS, SAFETY, VIEW).step(0.0, np.array([2.5, 0.3]), 0.0, lambda v, w: math.inf).v == 0.0
    assert Servo(PARAMS, SAFETY, VIEW).step(-3.0, np.array([2.5, 0.3]), 0.0, lambda v, w: math.inf).v == 0.0


# ------------------------------------------------------------------ the free way
@given(st.floats(0.0, 2.0))
def test_safe_speed_stands_in_time(free):
    v = safe_speed(free, SAFETY)
    assert v * SAFETY.reaction + v * v / (2.0 * SAFETY.brake) == pytest.approx(free, abs=1e-9)


def test_free_by_scan():
    assert free_by_scan(np.zeros((0, 2)), True, SAFETY) == math.inf
    wall = np.column_stack([np.full(41, 1.0), np.linspace(-1, 1, 41)])
    # from the robot's front to the wall, less the margin
    assert free_by_scan(wall, True, SAFETY) == pytest.approx(1.0 - 0.18 - SAFETY.scan_margin, abs=0.005)
    assert free_by_scan(wall, False, SAFETY) == math.inf
    assert free_by_scan(-wall, False, SAFETY) == pytest.approx(1.0 - 0.18 - SAFETY.scan_margin, abs=0.005)
    assert free_by_scan(np.array([[1.0, 0.3]]), True, SAFETY) == math.inf, "beside the way"


def test_scan_points_leaves_out_what_is_no_echo():
    points = scan_points([1.0, math.inf, math.nan, 0.01, 2.0], -math.pi / 2, math.pi / 4, 0.1, 8.0)
    assert np.allclose(points, [[0.0, -1.0], [0.0 + 2 * math.cos(math.pi / 2), 2.0]], atol=1e-9)


def test_arc_closes_a_circle():
    assert np.allclose(arc((1.0, 2.0, 0.5), np.array([2 * math.pi * 0.7]), 1 / 0.7), [[1.0, 2.0]], atol=1e-9)
    assert np.allclose(arc((1.0, 2.0, math.pi / 2), np.array([0.5, -0.5]), 0.0), [[1.0, 2.5], [1.0, 1.5]])


def test_ground_lets_a_robot_out_but_not_further_in():
    grid = empty()
    data = grid.data.copy()
    data[:, 160:] = 100  # x = 4 m and more
    ground = ForbiddenGround(grid.with_data(data), SAFETY)
    assert ground.free_way((3.0, 2.5, 0.0), 0.2, 0.0) == pytest.approx(1.0 - 0.18 - SAFETY.map_margin, abs=0.04)
    assert ground.free_way((3.9, 2.5, 0.0), 0.2, 0.0) <= 0.04
    assert ground.free_way((3.9, 2.5, 0.0), -0.2, 0.0) == math.inf
    assert ForbiddenGround(grid, SAFETY).free_way((3.0, 2.5, 0.0), 0.2, 0.1) == math.inf


def test_bad_parameters():
    with pytest.raises(ParameterError, match="order"):
        ServoParams(near_distance=1.2)
    with pytest.raises(ParameterError, match="settled_zone"):
        ServoParams(settled_zone=0.9)
    with pytest.raises(ParameterError, match="max_speed"):
        ServoParams(max_speed=2.0)
