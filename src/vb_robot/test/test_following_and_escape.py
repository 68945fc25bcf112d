"""Following the spot, and the escape of a pinched robot: what each requests, and when."""

import math

import numpy as np
import pytest

from driving_rig import PROFILE
from vb_testing import assert_fields
from vb_core.navigation_parameters import PATH_MARGIN
from vb_robot.driving.escape import Escape
from vb_robot.driving.spot_follower import SpotFollower
from vb_robot.driving.velocity import VelocityRequest

RADIUS = PROFILE.radius
FULL_OVERLAP = -PATH_MARGIN - RADIUS  # [m] beyond PATH_MARGIN, if the robot's centre is at the obstacle's edge


# ------------------------------------------------------------ following
def follow_spot(follower, distance, degrees):
    """Returns (v, w, code) for a spot at a distance [m] and bearing [deg] from the robot."""
    bearing = math.radians(degrees)
    follower.spot = (distance * math.cos(bearing), distance * math.sin(bearing))
    request = follower.compute_request((0.0, 0.0, 0.0))
    return request.v, request.w, request.code


@pytest.mark.parametrize(
    "degrees, distances, speeds, turn",
    [
        (0.0, [1.29, 1.31, 1.15, 1.01, 0.99, 1.15], [0.0, 0.2, 0.16, 0.048, 0.0, 0.0], 0.0),
        (0.0, [0.76, 0.74, 0.5, 0.89, 0.91, 0.85], [0.0, -0.168, -0.2, -0.048, 0.0, 0.0], 0.0),
        (0.0, [1.31, 0.74, 1.31], [0.2, -0.168, 0.2], 0.0),
        (12.5, [1.31, 1.15], [0.144, 0.08], 1.8 * math.radians(12.5)),
        (-26.0, [1.31], [0.0], -0.8),
        (13.9, [0.74], [-0.168], 0.0),
        (14.1, [0.74], [-0.168], 1.8 * math.radians(14.1)),
    ],
    ids="nearer backwards both_ways steering turning_first not_steering_backwards turning_backwards".split(),
)
def test_a_robot_drives_nearer_from_130_to_100_cm_and_back_from_75_to_90_cm(degrees, distances, speeds, turn):
    follower = SpotFollower()
    for distance, speed in zip(distances, speeds):
        code = "driving" if speed or turn else "spot_in_view"
        assert follow_spot(follower, distance, degrees) == (pytest.approx(speed), pytest.approx(turn), code)


def test_a_robot_turns_from_14_to_4_degrees_off():
    follower = SpotFollower()
    turns = [follow_spot(follower, 1.0, bearing)[1] for bearing in (13.9, 14.1, 4.1, 3.9, 13.9, -14.1, -60.0)]
    assert turns == pytest.approx([0.0, 0.443, 0.1288, 0.0, 0.0, -0.443, -0.8], abs=1e-4)


@pytest.mark.parametrize("spot, pose", [(None, (0.0, 0.0, 0.0)), ((1.0, 0.0), None)], ids=["no spot", "no pose"])
@pytest.mark.parametrize("distance, next_distance", [(1.31, 1.15), (0.74, 0.85)])
def test_a_robot_that_lost_the_spot_stands_and_begins_anew(spot, pose, distance, next_distance):
    follower = SpotFollower()
    assert follow_spot(follower, distance, 20.0)[2] == "driving"
    follower.spot = spot
    assert follower.compute_request(pose) == VelocityRequest(0.0, 0.0, "spot_lost")
    assert follow_spot(follower, next_distance, 5.0) == (0.0, 0.0, "spot_in_view")


# ------------------------------------------------------------ escaping
class Pinched:
    """A robot and its workspace, with an obstacle `gap` [m] from its rim, and the nearest free place at `place`."""

    def __init__(self, gap, place=(0.3, 0.0)):
        self.gap, self.place = gap, place
        self.asked = []
        self.escape = Escape(RADIUS)

    def distance_to_blocked(self, _pose):
        return RADIUS + self.gap

    def nearest_free_position(self, _pose, clearance, reach):
        self.asked.append((clearance, reach))
        return None if self.place is None else np.array(self.place)

    def helped_at(self, *times, **options):
        """Returns for each of these times [s] whether the robot is helped."""
        options = {"has_goal": True, "moves": False, **options}
        return [self.escape.compute_request(now, (0.0, 0.0, 0.0), self, **options) is not None for now in times]


@pytest.mark.parametrize("gap, helped", [(0.019, 1), (0.021, 0), (FULL_OVERLAP + 0.001, 1), (FULL_OVERLAP - 0.001, 0)])
def test_escape_begins_near_an_obstacle_and_ends_farther_away(gap, helped):
    """A robot whose centre is inside an obstacle is not helped."""
    robot = Pinched(PATH_MARGIN + gap)
    assert robot.helped_at(100.0, 101.4, 101.5, 102.0) == [False, False, helped, helped]
    robot.gap = PATH_MARGIN + 0.039
    assert robot.helped_at(102.1) == [helped]
    robot.gap = PATH_MARGIN + 0.041
    assert robot.helped_at(102.2) == [False]
    assert robot.asked == [(pytest.approx(RADIUS + PATH_MARGIN + 0.09), 0.5)] * helped


@pytest.mark.parametrize("place", [(0.3, 0.0), None])
def test_escape_lasts_ten_seconds_and_then_rests_for_twenty(place):
    robot = Pinched(0.0, place)
    helped = place is not None
    assert robot.helped_at(100.0, 101.5, 111.4, 111.6) == [False, helped, helped, False]
    assert robot.helped_at(115.0, 131.4, 131.6, 141.5, 141.7) == [False, False, helped, helped, False]
    assert len(robot.asked) == 2


def test_escape_also_rests_after_the_robot_was_free_for_a_moment():
    robot = Pinched(0.0)
    assert robot.helped_at(100.0, 101.5) == [False, True]
    robot.gap = 1.0
    assert robot.helped_at(101.6) == [False]
    robot.gap = 0.0
    assert robot.helped_at(101.7, 131.4, 131.6) == [False, False, True]


def test_escape_waits_but_does_not_rest_after_time_was_set_back():
    robot = Pinched(0.0)
    assert robot.helped_at(100.0, 101.5, 101.2) == [False, True, False]
    assert robot.helped_at(99.7, 101.1, 101.3) == [False, False, True]


@pytest.mark.parametrize("options", [{"moves": True}, {"has_goal": False}], ids=["moves", "no goal"])
def test_a_robot_that_moves_or_has_no_goal_begins_to_wait_again(options):
    robot = Pinched(0.0)
    robot.helped_at(100.0)
    robot.helped_at(101.0, **options)
    assert robot.helped_at(102.4, 102.6) == [False, True]


@pytest.mark.parametrize("distance, v", [(0.01, 0.038), (0.1, 0.11), (0.5, 0.2)])
@pytest.mark.parametrize("bearing, share, w", [(0.0, 1.0, 0.0), (12.5, 0.5, 0.3927), (-30.0, 0.0, -0.8)])
def test_escape_drives_to_the_place_and_slows_down_before_it(distance, v, bearing, share, w):
    yaw = 3.0
    direction = yaw + math.radians(bearing)
    place = (1.0 + distance * math.cos(direction), 2.0 + distance * math.sin(direction))
    robot = Pinched(0.0, place)
    for now in (100.0, 101.5):
        request = robot.escape.compute_request(now, (1.0, 2.0, yaw), robot, has_goal=True, moves=False)
    assert_fields(request, v=pytest.approx(share * v), w=pytest.approx(w, abs=1e-3))
