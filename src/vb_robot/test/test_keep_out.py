"""Paths avoid what is being drawn: invariants against shapely's geometry."""

import math

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from shapely.geometry import LineString, Point, Polygon

from vb_core.grid_map import GridMap
from vb_robot.clearance_map import ClearanceMap
from vb_robot.dispatching.drawing import DrawingState
from vb_robot.dispatching.viewpoint import ViewpointPlanner
from vb_robot.floor_view import FloorView

VIEW = FloorView.usual()


def open_room():
    """8 m x 5 m, cells of 5 cm: walls, and a shelf in the middle of the left part."""
    data = np.zeros((100, 160), dtype=np.int8)
    data[[0, -1]] = 100
    data[:, [0, -1]] = 100
    data[40:60, 30:36] = 100
    return GridMap(data, 0.05)


CLEARANCE_MAP = ClearanceMap(open_room(), 0.18)
CARPET = np.array([[3.1, 1.6], [5.1, 1.6], [5.1, 2.9], [3.1, 2.9]])


def rank(robot, drawing, clearance_map=CLEARANCE_MAP):
    """The best place, the best one elsewhere, and so on."""
    outlook, found = ViewpointPlanner(clearance_map, VIEW, drawing), []
    while len(found) < 6:
        best = outlook.best_viewpoint(robot, [(*place.pose[:2], 0.3) for place in found])
        if best is None or best in found:
            break
        found.append(best)
    return found


def route(robot, viewpoint, clearance_map=CLEARANCE_MAP):
    return clearance_map.shortest_paths(robot[:2]).path_to(viewpoint.pose[:2])


def test_route_is_tight_and_keeps_off_obstacles():
    start, goal = (1.0, 2.5), (3.0, 2.4)
    ways = CLEARANCE_MAP.shortest_paths(start)
    way = ways.path_to(goal)
    assert np.allclose(way[0], start) and np.allclose(way[-1], goal)
    assert np.linalg.norm(np.diff(way, axis=0), axis=1).max() <= 0.05 + 1e-9
    length = LineString(way).length
    # round a corner of the shelf, which spans x 1.5 to 1.8 m and y 2 to 3 m
    least = math.dist(start, (1.5, 3.0)) + 0.3 + math.dist((1.8, 3.0), goal)
    assert least <= length <= ways.lengths_to(np.array([goal]))[0] + 0.1
    assert CLEARANCE_MAP.clearance_at(way).min() >= 0.18 - 0.025
    free = CLEARANCE_MAP.shortest_paths((4.0, 0.5)).path_to((7.0, 1.9))
    assert LineString(free).length == pytest.approx(math.dist((4.0, 0.5), (7.0, 1.9)), abs=1e-6), "straight on"
    assert ways.path_to((1.6, 2.5)) is None


@settings(max_examples=10, deadline=None)
@given(st.floats(0.4, 7.6), st.floats(0.4, 4.6), st.floats(0, 6.28), st.integers(0, 3), st.booleans())
@example(5.625, 2.0, 0.0, 0, True)  # past a corner, while the seed is shown
def test_paths_never_enter_the_polygon(x, y, yaw, corner, seeding):
    polygon = Polygon(CARPET)
    assume(polygon.distance(Point(x, y)) > 0.25)
    spot = CARPET.mean(axis=0) if seeding else CARPET[corner]
    drawing = DrawingState(spot, CARPET, None, closed=True, seeding=seeding, seen_by_stationary=True)
    for viewpoint in rank((x, y, yaw), drawing):
        assert not viewpoint.risky
        way = route((x, y), viewpoint)
        driven = LineString(way) if len(way) > 1 else Point(way[0])
        assert polygon.distance(driven) >= CLEARANCE_MAP.radius - 0.05 / 2
        assert ViewpointPlanner(CLEARANCE_MAP, VIEW, drawing).avoids_drawing((x, y, yaw), viewpoint.pose)


@settings(max_examples=8, deadline=None)
@given(st.floats(3.15, 5.05), st.floats(1.65, 2.85), st.floats(0, 6.28))
def test_robot_inside_leaves_when_the_seed_is_shown(x, y, yaw):
    drawing = DrawingState(CARPET.mean(axis=0), CARPET, None, closed=True, seeding=True, seen_by_stationary=True)
    found = rank((x, y, yaw), drawing)
    assert found
    polygon = Polygon(CARPET)
    for viewpoint in found:
        assert polygon.distance(Point(viewpoint.pose[:2])) >= CLEARANCE_MAP.radius
        way = [polygon.contains(Point(p)) for p in route((x, y), viewpoint)]
        out = way.index(False)
        assert not any(way[out:]), "once out it stays out"


def test_half_drawn_polygon_counts_with_what_it_will_enclose():
    # three sides are drawn; the way from the left to the right of the last one leads through
    drawing = DrawingState(CARPET[3], CARPET, np.array([0.0, -1.0]), seen_by_stationary=True)
    robot = (6.5, 2.3, math.pi)
    for viewpoint in rank(robot, drawing):
        assert Polygon(CARPET).distance(LineString(route(robot, viewpoint))) >= 0.15


def test_robot_within_a_half_drawn_polygon_gets_no_viewpoint_within_it():
    drawing = DrawingState(CARPET[3], CARPET, np.array([0.0, -1.0]), seen_by_stationary=True)
    robot = (4.6, 2.2, math.pi / 2)
    found = rank(robot, drawing)
    assert found and all(Polygon(CARPET).distance(Point(place.pose[:2])) >= CLEARANCE_MAP.radius for place in found)


def test_short_line_changes_nothing():
    line = np.array([[4.0, 2.0], [4.2, 2.0]])
    assert rank((6.0, 2.0, 0.0), DrawingState(line[1], line, seen_by_stationary=True)) == rank(
        (6.0, 2.0, 0.0), DrawingState(line[1], line)
    )


def test_without_a_safe_path_it_depends_on_who_sees_the_spot():
    # the line parts the room from wall to wall, and everything that shows the spot lies beyond it
    line = np.array([[4.0, 0.05], [4.0, 4.95]])
    spot = np.array([2.4, 0.7])
    robot = (6.5, 2.5, 0.0)
    assert rank(robot, DrawingState(spot, line, seen_by_stationary=True)) == []
    alone = rank(robot, DrawingState(spot, line, seen_by_stationary=False))
    assert alone and all(viewpoint.risky for viewpoint in alone)


def test_seed_outside_sends_the_robot_into_the_allowed_corner():
    line = np.array([[6.0, 4.95], [6.0, 3.4], [7.95, 3.4]])
    drawing = DrawingState(np.array([5.3, 3.0]), line, None, closed=False, seeding=True, seen_by_stationary=True)
    best = rank((7.0, 1.0, 1.5), drawing)[0]
    assert best.pose[0] > 6.1 and best.pose[1] > 3.5
