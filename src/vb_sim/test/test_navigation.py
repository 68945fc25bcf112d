"""Costmap, planner and follower of the stand-in for move_base."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.ndimage import distance_transform_edt
from scipy.sparse import lil_matrix
from scipy.sparse.csgraph import dijkstra

from refusals import refused
from vb_testing import assert_fields
from vb_core import geometry
from vb_core.errors import CodedError
from vb_core.grid_map import FREE, OCCUPIED, UNKNOWN, GridMap
from vb_core.robot_profile import RobotProfile
from vb_sim.robot.path_planner import COST_FACTOR, INFLATION, INSCRIBED, LETHAL, NEUTRAL_COST, NO_INFORMATION, Costmap
from vb_sim.robot.path_planner import Planner
from vb_sim.robot.navigator import GOAL_ANGLE, GOAL_DISTANCE, MAX_TURN_RATE, PathFollower
from vb_sim.robot.robot_body import advance

RADIUS = 0.18


def room(rows=100, columns=140, resolution=0.05, origin=(-1.0, -2.0, 0.0)):
    data = np.zeros((rows, columns), np.int8)
    data[[0, -1], :] = data[:, [0, -1]] = OCCUPIED
    return GridMap(data, resolution, origin)


def with_wall(gap=True):
    """Returns a room with a wall across it at x = 2.5 m, which has a 1 m gap near the top."""
    grid = room()
    data = grid.data
    column = grid.world_to_cell([(2.5, 0.0)])[0][1]
    data[:, column] = OCCUPIED
    if gap:
        low, high = grid.world_to_cell([(2.5, 1.5), (2.5, 2.5)])[:, 0]
        data[low:high, column] = FREE
    return grid


# ------------------------------------------------------------ costmap
def test_inflation_is_that_of_costmap_2d():
    grid = room()
    costmap = Costmap(grid, RADIUS)
    obstacles = grid.data == OCCUPIED
    distance = distance_transform_edt(~obstacles) * grid.resolution
    expected = np.zeros(grid.shape)
    near = distance <= RADIUS + INFLATION + 1e-6
    expected[near] = np.floor(252 * np.exp(-8.0 * (distance[near] - RADIUS)))
    expected[distance <= RADIUS] = INSCRIBED
    expected[obstacles] = LETHAL
    assert np.abs(costmap.costs.astype(int) - expected).max() <= 1
    assert ((costmap.costs == INSCRIBED) == (expected == INSCRIBED)).all()


@pytest.mark.parametrize("value, cost", [(0, 0), (75, 190), (100, LETHAL), (UNKNOWN, NO_INFORMATION)])
def test_map_values_cost_what_costmap_2ds_static_layer_says(value, cost):
    assert (Costmap(GridMap(np.full((3, 3), value, np.int8), 0.05), RADIUS).costs == cost).all()


# ------------------------------------------------------------ planner
def oracle(costmap, start, goal):
    """Returns the cost between two cells, by a graph built cell by cell."""
    free = costmap.costs < INSCRIBED
    ids = np.arange(free.size).reshape(free.shape)
    weight = NEUTRAL_COST + COST_FACTOR * costmap.costs.astype(float)
    graph = lil_matrix((free.size, free.size))
    for (r, c), (dr, dc) in itertools.product(np.argwhere(free), ((0, 1), (1, 0), (1, 1), (1, -1))):
        around = (r, r, r + dr, r + dr), (c, c + dc, c, c + dc)  # no step passes between two blocked cells
        if r + dr < free.shape[0] and 0 <= c + dc < free.shape[1] and free[around].all():
            cost = (weight[r, c] + weight[r + dr, c + dc]) / 2 * math.hypot(dr, dc)
            graph[ids[r, c], ids[r + dr, c + dc]] = cost
    return dijkstra(graph.tocsr(), directed=False, indices=ids[start])[ids[goal]]


@pytest.mark.parametrize("seed", range(4))
def test_paths_are_the_cheapest(seed):
    rng = np.random.default_rng(seed)
    data = np.where(rng.random((30, 40)) < 0.2, OCCUPIED, FREE).astype(np.int8)
    costmap = Costmap(GridMap(data, 0.1), 0.05)  # some blocked cells meet only at their corners
    free = np.argwhere(costmap.costs < INSCRIBED)
    start, goal = free[0], free[-1]
    planner = Planner(costmap)
    ends = costmap.grid.cell_to_world(np.array([start, goal]))
    expected = oracle(costmap, tuple(start), tuple(goal))
    if not np.isfinite(expected):
        with refused("no_path"):
            planner.plan(*ends)
        return
    costs, _ = planner._search(tuple(start))  # of the path over cells, before it is shortened
    assert costs[tuple(goal)] == pytest.approx(expected)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6))
def test_no_path_touches_a_blocked_cell(seed):
    rng = np.random.default_rng(seed)
    data = np.where(rng.random((40, 50)) < 0.012, OCCUPIED, FREE).astype(np.int8)
    costmap = Costmap(GridMap(data, 0.05), 0.1)
    free = np.argwhere(costmap.costs < INSCRIBED)
    if len(free) < 2:
        return
    ends = costmap.grid.cell_to_world(free[rng.integers(len(free), size=2)])
    try:
        path = Planner(costmap).plan(*ends)
    except CodedError as error:
        assert error.code == "no_path"
        return
    assert np.allclose(path[[0, -1]], ends)
    fine = geometry.resample_chain(path, 0.01) if len(path) > 1 else path
    cells = costmap.grid.world_to_cell(fine)
    # it never enters an obstacle, and the inscribed zone by less than a cell, where a line cuts its corner
    assert (costmap.costs[cells[:, 0], cells[:, 1]] != LETHAL).all()
    inside = distance_transform_edt(~(costmap.costs < INSCRIBED))[cells[:, 0], cells[:, 1]]
    assert inside.max() <= 1.5


def test_straight_lines_are_straight():
    planner = Planner(Costmap(room(), RADIUS))
    path = planner.plan(np.array([0.0, 0.0]), np.array([4.0, 1.3]))
    assert geometry.chain_length(path) < 1.01 * math.hypot(4.0, 1.3)
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() <= 0.05 + 1e-9
    assert np.allclose(planner.plan(path[0], path[0]), path[0])


@pytest.mark.parametrize(
    "start, goal, tolerance, code",
    [
        ((0.0, 0.0), (4.5, 0.0), 0.0, "no_path"),
        ((0.0, 0.0), (2.5, 0.0), 0.0, "goal_blocked"),
        ((2.5, 0.0), (0.0, 0.0), 0.0, "start_blocked"),
        ((0.0, 0.0), (99.0, 0.0), 0.0, "off_map"),
        ((0.0, 0.0), (math.nan, 0.0), 0.0, "off_map"),
        ((0.0, 0.0), (4.5, 0.0), 0.5, "no_path"),
    ],
)
def test_a_plan_without_a_path_is_refused_with_the_reason(start, goal, tolerance, code):
    planner = Planner(Costmap(with_wall(gap=False), RADIUS))
    with refused(code):
        planner.plan(np.array(start), np.array(goal), tolerance)


def test_tolerance_ends_at_the_nearest_reachable_place():
    planner = Planner(Costmap(with_wall(gap=False), RADIUS))
    path = planner.plan(np.array([0.0, 0.0]), np.array([2.45, 0.0]), 0.5)
    # the wall's cells begin at 2.5 m; the nearest cell centre 0.18 m from theirs is at 2.325 m
    assert path[-1] == pytest.approx((2.325, 0.0), abs=0.03)


def test_a_robot_that_touches_the_inscribed_zone_gets_out():
    planner = Planner(Costmap(with_wall(), RADIUS))
    path = planner.plan(np.array([2.37, 0.0]), np.array([0.0, 0.0]))  # 0.15 m from the wall
    assert np.allclose(path[0], (2.37, 0.0))
    assert path[:, 0].max() <= 2.37 + 1e-9


# ------------------------------------------------------------ follower
STRAIGHT = np.column_stack([np.linspace(0.0, 3.0, 61), np.zeros(61)])


def follow(path, goal, pose, obstacles=lambda pose: np.zeros((0, 2)), limit=60.0, dt=0.1):
    poses = [pose]
    motions = []
    follower = PathFollower(RobotProfile(), goal)
    follower.set_path(path)
    for _ in range(int(limit / dt)):
        motion = follower.step(pose, obstacles(pose), dt)
        motions.append(motion)
        if motion.arrived:
            break
        pose = advance(pose, motion.speed * dt, motion.turn_rate * dt)
        poses.append(pose)
    return np.array(poses), motions


@pytest.mark.parametrize("yaw", [0.0, 2.0, math.pi, -1.5])
def test_goal_is_reached_from_any_heading(yaw):
    path = Planner(Costmap(with_wall(), RADIUS)).plan(np.array([0.0, 0.0]), np.array([4.5, 0.0]))
    poses, motions = follow(path, (4.5, 0.0, 1.0), (0.0, 0.0, yaw))
    assert motions[-1].arrived
    assert np.linalg.norm(poses[-1, :2] - (4.5, 0.0)) < 3 * GOAL_DISTANCE
    assert abs(geometry.wrap_angle(poses[-1, 2] - 1.0)) < GOAL_ANGLE
    assert max(abs(motion.speed) for motion in motions) <= 0.5
    assert max(abs(motion.turn_rate) for motion in motions) <= MAX_TURN_RATE + 1e-9
    assert np.linalg.norm(poses[:, None, :2] - path[None], axis=2).min(axis=1).max() < 0.15


def test_it_stops_before_an_obstacle_and_says_so():
    def person(pose):
        map_to_robot = geometry.invert_transform(geometry.transform_from_pose2d(*pose))
        return geometry.transform_points(map_to_robot, np.array([[2.0, 0.05, 0.0], [2.0, -0.05, 0.0]]))[:, :2]

    poses, motions = follow(STRAIGHT, (3.0, 0.0, 0.0), (0.0, 0.0, 0.0), person, limit=20.0)
    last = motions[-1]
    assert_fields(last, arrived=False, blocked=True, speed=0.0)
    assert 1.6 < poses[-1, 0] < 2.0 - 0.18


def test_what_stands_beside_the_path_does_not_matter():
    beside = np.array([[0.5, 0.3], [0.2, -0.3]])
    _, motions = follow(STRAIGHT, (3.0, 0.0, 0.0), (0.0, 0.0, 0.0), lambda pose: beside, 20.0)
    assert motions[-1].arrived
