"""What a person collects for a calibration: spots that are held still, and places in the map."""

import numpy as np
import pytest

from board_scene import CAMERA, POSE
from refusals import refused
from vb_core.camera_model import project_to_floor
from vb_laser_detect.calibration.pose_session import PoseCalibrationSession, StillSpotFinder
from vb_laser_detect.calibration.pose_session import describe_estimate, parse_point


def show(spot_finder, images, spots_of):
    """Shows images with these numbers, 25 per second; `spots_of` returns the spots in an image, by its number."""
    for number in images:
        spot_finder.add(0.04 * number, spots_of(number))


def test_a_spot_is_taken_only_while_it_is_still():
    spot_finder, rng = StillSpotFinder(), np.random.default_rng(0)
    with refused("spot_not_seen_by_camera"):
        spot_finder.median_position()
    show(spot_finder, range(25), lambda number: [(300 + 20 * number, 200)])
    with refused("spot_moving"):
        spot_finder.median_position()
    show(spot_finder, range(25, 100), lambda number: [rng.normal((800, 400), 0.5)] if number % 3 else [])
    assert spot_finder.median_position() == pytest.approx((800, 400), abs=0.5)
    show(spot_finder, range(100, 160), lambda number: [])
    with refused("spot_not_seen_by_camera"):
        spot_finder.median_position()
    show(spot_finder, [0], lambda number: [(1, 1)])  # time jumps back
    with refused("spot_not_seen_by_camera"):
        spot_finder.median_position()


def test_session_guides_to_a_result_and_back():
    pixels = np.array([(150, 120), (1780, 130), (1750, 960), (170, 950), (960, 150), (960, 930)], float)
    points = project_to_floor(CAMERA, POSE, pixels)[:, :2]
    session = PoseCalibrationSession(CAMERA)
    assert not session.undo()
    assert "at least 4" in session.describe_progress()
    for pixel, point in zip(pixels, points):
        session.add(pixel, point)
    assert len(session) == 6
    assert "cm on the floor" in session.describe_progress()
    assert "6 of 6" in "\n".join(describe_estimate(session.solve(), session.observed))
    for _ in range(3):
        assert session.undo()
    with refused("too_few_calibration_points"):
        session.solve()


def test_places_that_say_nothing_new_are_refused():
    session = PoseCalibrationSession(CAMERA)
    session.add((150.0, 120.0), (1.0, 2.0))
    with refused("same_place"):
        session.add((151.0, 121.0), (0.0, 0.0))
    with refused("bad_points"):
        session.add((500.0, 500.0), (0.0, float("nan")))
    assert len(session) == 1


def test_a_place_is_two_numbers():
    assert parse_point("1.5, -2") == [1.5, -2.0]
    assert not any(map(parse_point, ("1.5", "a b", "nan 1")))
