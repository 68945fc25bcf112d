"""Floor view, clearance map and viewpoints: the invariants of every pose that is offered."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from shapely.geometry import LineString, Point, Polygon

from plain_rooms import VIEW, room, with_border
from vb_core.grid_map import clearance_grid
from vb_core.geometry import map_to_base
from vb_robot.clearance_map import STOP_MARGIN, ClearanceMap
from vb_robot.dispatching.viewpoint import IMAGE_MARGIN, LINE_MARGIN, MAX_DISTANCE, MAX_LOOKAHEAD, MIN_DISTANCE
from vb_robot.dispatching.viewpoint import MIN_LOOKAHEAD, NO_POINTS, REACTION, DrawingState, ViewpointPlanner


def two_rooms(door=True):
    """Returns 8 m x 5 m, divided at x = 4 m by a wall with a 0.7 m doorway at y = 4 m, a table in the left room."""
    grid = room(resolution=0.025)
    grid.data[:, 158:162] = 100
    if door:
        grid.data[146:174, 158:162] = 0
    grid.data[60:80, 60:80] = 100
    return grid


CLEARANCE_MAP = ClearanceMap(two_rooms(), 0.18)


# ------------------------------------------------------------------ view
def test_floor_is_visible_from_where_the_geometry_says():
    # the image's lower and upper edges look 52.57 and 7.43 degrees down
    half = math.degrees(math.atan(240.0 / (320.0 / math.tan(math.radians(29.0)))))
    near = 0.10 + 0.45 / math.tan(math.radians(30.0 + half))
    points = np.array([[near + 0.01, 0.0], [near - 0.01, 0.0], [3.1, 0.0], [-1.0, 0.0]])
    assert VIEW.sees(points).tolist() == [True, False, False, False]
    # a point to the left (y > 0) lies left in the image
    assert VIEW.pixels(np.array([[1.0, 0.2]]))[0, 0] < VIEW.pixels(np.array([[1.0, -0.2]]))[0, 0]


# ------------------------------------------------------------------ clearance map
def test_clearance_is_never_overestimated():
    rng = np.random.default_rng(3)
    blocked = rng.random((30, 40)) < 0.03
    clearance = clearance_grid(blocked, 0.1)
    rows, columns = np.nonzero(blocked)
    for row, column in rng.integers(0, (30, 40), (50, 2)):
        # by brute force: the nearest point of every blocked cell's square
        dr = np.maximum(np.abs(rows - row) - 0.5, 0.0)
        dc = np.maximum(np.abs(columns - column) - 0.5, 0.0)
        true = 0.0 if blocked[row, column] else 0.1 * np.hypot(dr, dc).min()
        assert true - 0.1 <= clearance[row, column] <= true + 1e-5


@pytest.mark.parametrize("width, is_passable", [(0.7, True), (0.35, False), (0.0, False)])  # [m] the robot needs 0.42 m
def test_paths_lead_only_through_a_doorway_that_is_wide_enough(width, is_passable):
    grid = two_rooms()
    grid.data[146 + round(width / 0.025) : 174, 158:162] = 100  # the rest of the doorway
    start, doorway, goal = (1.0, 1.0), (4.0, 3.7), (7.0, 1.0)
    (length,) = ClearanceMap(grid, 0.18).path_lengths(start, np.array([goal]))
    shortest = math.dist(start, doorway) + math.dist(doorway, goal)
    # eight-connected paths are up to 8 % too long, and keep off the doorposts
    assert shortest <= length <= 1.15 * shortest if is_passable else length == np.inf


def test_walls_hide_floor_and_borders_do_not():
    grid = two_rooms()
    borders = with_border(grid, 5.0, 0.0, 5.25, 5.0)
    clearance_map = ClearanceMap(borders, 0.18, physical=grid)
    assert clearance_map.has_line_of_sight(np.array([[4.5, 1.0]]), (6.0, 1.0))[0]
    assert not clearance_map.has_line_of_sight(np.array([[3.5, 1.0]]), (4.8, 1.0))[0]
    assert not ClearanceMap(borders, 0.18).has_line_of_sight(np.array([[4.5, 1.0]]), (6.0, 1.0))[0]


def test_sides_of_polygon_and_curve():
    square = np.array([[5.0, 1.0], [6.0, 1.0], [6.0, 2.0], [5.0, 2.0]])
    inside = CLEARANCE_MAP.predict_restricted_side((5.5, 1.5), square, True)
    assert inside.sum() * 0.025**2 == pytest.approx(1.0, abs=0.1)
    door = np.array([[4.0, 3.7], [4.0, 4.3]])
    left_side = CLEARANCE_MAP.predict_restricted_side((1.0, 1.0), door, False)
    assert [left_side[40, column] for column in (40, 280)] == [True, False]
    # without a line there are no sides
    assert not CLEARANCE_MAP.predict_restricted_side((5.5, 1.5), np.zeros((0, 2)), False).any()


# ------------------------------------------------------------------ the target
RIGHTWARDS = np.array([0.3, 0.0])  # [m/s]


@pytest.mark.parametrize(
    "x, velocity, marks_side, expected",
    [
        (4.5, None, False, 4.5),
        (4.5, RIGHTWARDS, True, 4.5),
        (4.5, RIGHTWARDS, False, 4.5 + MIN_LOOKAHEAD),
        (4.5, 3.0 * RIGHTWARDS, False, 4.5 + 0.45 * REACTION),
        (4.5, 9.0 * RIGHTWARDS, False, 4.5 + MAX_LOOKAHEAD),
        (4.5, -RIGHTWARDS, False, 4.5 - MIN_LOOKAHEAD),
        (7.8, RIGHTWARDS, False, 7.9),
        (7.94, RIGHTWARDS, False, 7.94),
    ],
    ids="rests seed slow quick very_quick left to_a_wall at_a_wall".split(),
)
def test_the_target_is_ahead_of_a_moving_spot_and_not_in_a_wall(x, velocity, marks_side, expected):
    clearance_map = ClearanceMap(room(), 0.18)
    drawing = DrawingState(np.array([x, 2.5]), velocity=velocity, marks_side=marks_side)
    ahead = drawing.extrapolate_line(clearance_map)
    assert drawing.target_point(ahead) == pytest.approx((expected, 2.5), abs=0.06)
    assert ahead[0] == pytest.approx((x, 2.5))
    assert ahead[:, 0].max() <= 7.95


# ------------------------------------------------------------------ viewpoints
def best_viewpoints(clearance_map, robot, drawing, others=()):
    """Lists the best viewpoint, then the best at least 0.3 m from those before, up to twelve."""
    viewpoints = []
    planner = ViewpointPlanner(clearance_map, VIEW, drawing, others)
    for _ in range(12):
        best = planner.best_viewpoint(robot, [(*viewpoint.pose[:2], 0.3) for viewpoint in viewpoints])
        if best is None:
            break
        viewpoints.append(best)
    return viewpoints


@settings(max_examples=8)
@given(st.floats(0.1, 7.9), st.floats(0.1, 4.9), st.floats(0, 6.28), st.integers(0, 3))
def test_every_viewpoint_is_sound(x, y, angle, length):
    spot = np.array([x, y])
    direction = np.array([math.cos(angle), math.sin(angle)])
    chain = spot - np.linspace(0.0, 0.5 * length, 6)[:, None] * direction if length else NO_POINTS
    drawing = DrawingState(spot, chain, direction if length else None)
    robot = (7.0, 0.7, 0.0)
    viewpoints = best_viewpoints(CLEARANCE_MAP, robot, drawing)
    assert all(a.cost <= b.cost for a, b in zip(viewpoints, viewpoints[1:]))
    planner = ViewpointPlanner(CLEARANCE_MAP, VIEW, drawing)
    target = planner.target_point
    for viewpoint in viewpoints:
        place = np.array([viewpoint.pose[:2]])
        # clearance by an independent oracle: the distance to every blocked cell's centre
        blocked = CLEARANCE_MAP.grid.cell_to_world(np.argwhere(CLEARANCE_MAP.blocked))
        assert np.linalg.norm(blocked - place, axis=1).min() >= CLEARANCE_MAP.radius + STOP_MARGIN
        distance = math.dist(place[0], target)
        at_home = math.dist(place[0], robot[:2]) < 1e-6  # where it stands tolerances are wider: it only has to turn
        nearer, farther = (0.8, 1.3) if at_home else (1.0, 1.0)
        assert MIN_DISTANCE * nearer - 1e-6 <= distance <= MAX_DISTANCE * farther + 1e-6
        assert VIEW.sees(map_to_base(target[None], viewpoint.pose), IMAGE_MARGIN - 1e-6)[0]
        assert abs(map_to_base(target[None], viewpoint.pose)[0, 1]) < 1e-6, "faces it"
        assert VIEW.sees(map_to_base(drawing.spot[None], viewpoint.pose), 0.05)[0], "only the robot sees the spot"
        for point in drawing.chain:
            assert math.dist(place[0], point) >= CLEARANCE_MAP.radius + LINE_MARGIN
        assert viewpoint.cost >= math.dist(place[0], robot[:2]) - 0.6
        assert planner.is_suitable(viewpoint.pose)


def test_open_floor_has_viewpoints_on_the_robots_side():
    viewpoints = best_viewpoints(CLEARANCE_MAP, (6.0, 0.5, 0.0), DrawingState(np.array([6.0, 2.5]), NO_POINTS))
    assert len(viewpoints) == 12, "as many as are asked for"
    assert viewpoints[0].pose[1] < 2.0, "it need not go round the spot"


def test_robot_that_only_has_to_turn_does_not_drive():
    # the spot lies 1.3 m to its left: poses closer to the best distance are a few decimetres away
    viewpoints = best_viewpoints(CLEARANCE_MAP, (6.0, 1.0, 0.0), DrawingState(np.array([6.0, 2.3]), NO_POINTS))
    assert viewpoints[0].pose == pytest.approx((6.0, 1.0, math.pi / 2))


def test_places_of_other_robots_are_taken():
    drawing = DrawingState(np.array([6.0, 2.5]), NO_POINTS)
    robot = (6.0, 0.5, math.pi / 2)
    taken = best_viewpoints(CLEARANCE_MAP, robot, drawing)[0].pose[:2]
    others = best_viewpoints(CLEARANCE_MAP, robot, drawing, [taken])
    assert min(math.dist(viewpoint.pose[:2], taken) for viewpoint in others) >= 2 * 0.18 + 0.10


def test_paths_lead_round_other_robots():
    start, goal = (6.0, 1.0), np.array([[6.0, 3.0]])
    straight = CLEARANCE_MAP.path_lengths(start, goal)[0]
    assert straight == pytest.approx(2.0, abs=0.1)
    assert straight + 0.1 < CLEARANCE_MAP.path_lengths(start, goal, [(6.0, 2.0)])[0] < straight + 0.5
    assert CLEARANCE_MAP.path_lengths((1.0, 1.0), np.array([[7.0, 1.0]]), [(4.0, 4.0)])[0] == np.inf


def test_unreachable_spot_has_no_viewpoint():
    shut = ClearanceMap(two_rooms(door=False), 0.18)
    assert best_viewpoints(shut, (1.0, 1.0, 0.0), DrawingState(np.array([7.0, 2.0]), NO_POINTS)) == []


def test_seed_side_is_left():
    door = np.array([[4.0, 3.65], [4.0, 4.35]])
    # the seed and the robot are in the right room: the robot must leave it
    drawing = DrawingState(np.array([7.0, 1.0]), door, None, closed=False, marks_side=True)
    viewpoints = best_viewpoints(CLEARANCE_MAP, (6.0, 1.0, 0.0), drawing)
    assert viewpoints[0].pose[0] < 4.0
    assert not viewpoints[0].sees_spot
    assert not ViewpointPlanner(CLEARANCE_MAP, VIEW, drawing).is_suitable((6.0, 1.0, 0.0))
    # the seed cannot be seen from the left room, and the robot need not go anywhere
    assert best_viewpoints(CLEARANCE_MAP, (1.0, 3.0, 0.0), drawing) == []


CARPET = np.array([[5.1, 1.6], [7.1, 1.6], [7.1, 2.9], [5.1, 2.9]])


@settings(max_examples=8)
@given(st.floats(5.15, 7.05), st.floats(1.65, 2.85), st.floats(0, 6.28), st.booleans())
def test_a_robot_is_not_sent_where_the_border_would_lock_it_in(x, y, yaw, marks_side):
    # three sides are drawn; while the seed is shown, a robot inside has to leave
    spot, velocity = (CARPET.mean(axis=0), None) if marks_side else (CARPET[3], np.array([0.0, -1.0]))
    drawing = DrawingState(spot, CARPET, velocity, closed=marks_side, marks_side=marks_side, seen_by_stationary=True)
    viewpoints = best_viewpoints(CLEARANCE_MAP, (x, y, yaw), drawing)[:4]
    gaps = [Polygon(CARPET).distance(Point(viewpoint.pose[:2])) for viewpoint in viewpoints]
    assert min(gaps) >= CLEARANCE_MAP.radius


def drawing_with_seed(chain, seen_by_stationary):
    return DrawingState(chain.mean(axis=0), chain, closed=True, marks_side=True, seen_by_stationary=seen_by_stationary)


def length_over_carpet(robot, viewpoint):
    """Returns the length [m] over the carpet of the straight way, which in an empty room is the shortest."""
    return LineString([robot[:2], viewpoint.pose[:2]]).intersection(Polygon(CARPET)).length


@pytest.mark.parametrize("robot", [(5.0, 4.0, 3.0), (5.6, 3.8, 0.0)])
@pytest.mark.parametrize("drawn", [0.5, 0.75])
def test_a_robot_is_not_sent_over_the_area_that_is_being_drawn(robot, drawn):
    # The last, long side is being drawn, which is too far away from beyond the carpet. Not every start avoids the area:
    # a path that grazes it costs as much as one through its middle, so that from (7.0, 4.0) a robot still crosses it.
    chain = np.vstack([np.roll(CARPET, -1, axis=0), CARPET[0] + drawn * (CARPET[1] - CARPET[0])])
    drawing = DrawingState(chain[-1], chain, np.array([0.3, 0.0]), seen_by_stationary=True)
    best = ViewpointPlanner(CLEARANCE_MAP, VIEW, drawing).best_viewpoint(robot)
    assert length_over_carpet(robot, best) < 0.65  # it may cut a corner


@settings(max_examples=25)
@given(st.floats(4.5, 7.6), st.floats(0.4, 4.6), st.floats(0, 6.28))
def test_no_area_is_crossed_while_another_camera_sees_the_seed(x, y, yaw):
    assume(Polygon(CARPET).distance(Point(x, y)) > CLEARANCE_MAP.radius + 0.05)
    best = ViewpointPlanner(CLEARANCE_MAP, VIEW, drawing_with_seed(CARPET, True)).best_viewpoint((x, y, yaw))
    assert best is None or length_over_carpet((x, y), best) < 0.65  # it may cut a corner


def test_a_robot_crosses_the_seeds_side_only_for_an_unseen_seed():
    robot, failed = (6.1, 1.2, math.pi), [(6.1, 0.6, 2.35)]  # all viewpoints but those beyond the carpet
    best = ViewpointPlanner(CLEARANCE_MAP, VIEW, drawing_with_seed(CARPET, False)).best_viewpoint(robot, failed)
    assert length_over_carpet(robot, best) > 0.5
    assert ViewpointPlanner(CLEARANCE_MAP, VIEW, drawing_with_seed(CARPET, True)).best_viewpoint(robot, failed) is None


def test_a_view_from_inside_the_border_is_offered_only_until_the_seed_is_shown():
    ring = np.array([[4.4, 0.3], [7.7, 0.3], [7.7, 4.7], [4.4, 4.7]])
    robot = (1.0, 4.0, 0.0)
    assert best_viewpoints(CLEARANCE_MAP, robot, DrawingState(np.array([6.0, 2.5]), ring))
    shown = DrawingState(np.array([6.0, 2.5]), ring, None, closed=True, marks_side=True)
    assert best_viewpoints(CLEARANCE_MAP, robot, shown) == []


def test_seed_outside_sends_the_robot_into_the_allowed_corner():
    line = np.array([[6.0, 4.95], [6.0, 3.4], [7.95, 3.4]])
    drawing = DrawingState(np.array([5.3, 3.0]), line, None, closed=False, marks_side=True, seen_by_stationary=True)
    best = best_viewpoints(CLEARANCE_MAP, (7.0, 1.0, 1.5), drawing)[0]
    assert (np.array(best.pose[:2]) > (6.1, 3.5)).all()
