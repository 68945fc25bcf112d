"""What a scan says about the floor: which of it is free, which is covered by beams, and which echoes count."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from examples import STEADY, off_thresholds
from plain_rooms import scan_of
from vb_core import geometry
from vb_robot.driving.scan_clearance import Clearance, arc_positions


@settings(STEADY, max_examples=300)
@given(
    st.lists(st.tuples(off_thresholds(-1.1, 1.1), off_thresholds(-0.35, 0.35)), min_size=1, max_size=6),
    st.sampled_from([1, -1]),
    st.sampled_from([0.0, 1.0, -1.0, 1.0 / 0.36, -1.0 / 0.36, 1.0 / 0.24]),
)
def test_the_free_distance_ends_where_a_round_robot_meets_a_point(places, direction, bend):
    """The distance is along its arc; a radius below 0.3 m counts as driving straight on.

    Args:
        places: (distance along the arc, distance to its left) [m] of each point.
        bend: curvature [1/m] of the arc.
    """
    (along, across), driven = np.transpose(places), bend if abs(bend) < 1.0 / 0.3 else 0.0
    scan, yaw = scan_of([0.0], 0.0, 0.01), direction * driven * along
    scan.points = arc_positions((0.0, 0.0, 0.0), direction * along, driven)
    scan.points += across[:, None] * np.column_stack([-np.sin(yaw), np.cos(yaw)])
    width, driven_to, ahead = 0.18 + 0.04, np.linspace(0.0, 1.5, 3001), along > 0.0
    met = (np.hypot(along[ahead, None] - driven_to, across[ahead, None]) < width).any(axis=0)
    expected = driven_to[np.argmax(met)] - 0.12 + 0.04 if met.any() else math.inf
    distance = scan.free_distance(0.2 * direction, 0.2 * direction * bend, 0.18, Clearance(0.12, 0.04, 0.05))
    assert max(distance, 0.04 - 0.12) == pytest.approx(expected, abs=1e-3), "a point beside its nose counts as touched"


@pytest.mark.parametrize("v", [0.2, -0.2])
@pytest.mark.parametrize(
    "w, needed, edge", [(0.0, 0.0, 6.4), (0.4, 0.0, 23.6), (-0.4, 0.0, 23.6), (0.4, 0.3, 33.9), (10.0, 0.0, 96.4)]
)
def test_beams_must_reach_along_the_arc_but_for_a_gap(v, w, needed, edge):
    """The robot's half width at 0.98 m is 10.4 deg, a hole may be 4 deg; an arc bends by half its turn within 0.3 m."""
    mount = geometry.make_transform(np.diag([math.copysign(1.0, v)] * 2 + [1.0]), (0.0, 0.0, 0.0))
    for half, seen in ((edge - 0.7, False), (edge + 0.7, True)):
        number = 2 * int(half * 10) + 1
        scan = scan_of(np.full(number, math.inf), -math.radians(half), math.radians(0.1), mount)
        assert scan.sees_path(v, w, 0.18, needed) is seen


@pytest.mark.parametrize("v", [0.2, -0.2])
@pytest.mark.parametrize("w, seen", [(0.4, True), (-0.4, False)])
def test_beams_to_its_left_show_the_arc_to_the_left(v, w, seen):
    """Relative to the direction of travel: 17 deg off straight on, backwards as forwards."""
    mount = geometry.make_transform(np.diag([math.copysign(1.0, v)] * 2 + [1.0]), (0.0, 0.0, 0.0))
    scan = scan_of(np.full(36, math.inf), math.radians(5.0), math.radians(1.0), mount)
    assert scan.sees_path(v, w, 0.18, 0.0) is seen


@settings(STEADY)
@given(
    st.lists(st.tuples(st.integers(0, 399), st.integers(1, 40)), max_size=6),
    st.lists(st.integers(0, 399), max_size=3),
    st.integers(-200, 199),
    st.integers(3, 60),
)
def test_a_covered_sector_has_beams_to_its_edges_and_no_hole(holes, alone, bearing, half):
    """In degrees, with beams 0.9 apart; at an edge, as elsewhere, four degrees may be dark."""
    ranges, bearing, half = np.full(400, math.inf), 0.9 * bearing + 0.45, 0.9 * half + 0.2
    for begin, wide in holes:
        ranges[np.arange(begin, begin + wide) % 400] = math.nan
    ranges[alone] = math.inf
    offsets = [(0.9 * beam - bearing) % 360.0 - 180.0 for beam in np.flatnonzero(np.isinf(ranges))]
    offsets = sorted(offset for offset in offsets if abs(offset) <= half + 4.0)
    covered = bool(offsets) and offsets[0] <= 4.0 - half and offsets[-1] >= half - 4.0 and all(np.diff(offsets) <= 4.0)
    assert scan_of(ranges, -math.pi, math.radians(0.9)).covers(math.radians(bearing), math.radians(half)) == covered


@pytest.mark.parametrize("nans, step, covered", [(3, 1.0, True), (4, 1.0, False), (2, 3.0, True), (3, 3.0, False)])
def test_a_hole_of_four_degrees_or_three_beams_hides_nothing(nans, step, covered):
    beams = int(360 / step)
    ranges = np.full(beams, math.inf)
    ranges[beams // 2 : beams // 2 + nans] = math.nan
    assert scan_of(ranges, -math.pi, math.radians(step)).covers(0.0, 0.3) is covered
    assert scan_of(ranges, -math.pi, math.radians(step)).covers(math.pi, 0.3)


def along_y(y):
    """Returns the mount of a scanner that looks along +y from a point [m] on that axis."""
    return geometry.make_transform(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), (0.0, y, 0.2))


@pytest.mark.parametrize(
    "radius, distances, counts",
    [
        (0.18, [0.16, 7.7], True),
        (0.18, [0.14, 7.9], False),
        (0.25, [0.225], True),
        (0.25, [0.215], False),
        (0.05, [0.022], True),
        (0.05, [0.015], False),
        (0.02, [0.001], True),  # a robot smaller than the margin takes no echo for its own part
    ],
)
def test_an_echo_counts_in_range_and_outside_the_robots_own_parts(radius, distances, counts):
    for distance in distances:
        points = scan_of([distance + 0.2], 0.0, 0.01, along_y(-0.2), radius).points
        assert points == pytest.approx(np.array([[0.0, distance]] if counts else np.zeros((0, 2))))


@pytest.mark.parametrize("scanner_y, point", [(0.0, 0.18), (0.3, 0.35)])
def test_an_echo_too_near_to_measure_touches_robot_or_scanner(scanner_y, point):
    mount = along_y(scanner_y)
    assert scan_of([0.05], 0.0, 0.01, mount).points[0] == pytest.approx([0.0, point])
    assert scan_of([-math.inf], 0.0, 0.01, mount).points[0] == pytest.approx([0.0, max(scanner_y, 0.18)])
