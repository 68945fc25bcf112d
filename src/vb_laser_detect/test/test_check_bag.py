"""`calibrate_camera check --bag` on recorded spots: cameras that overlap, and what is wrong with one of their poses."""

import math
import re
import sys

import numpy as np
import pytest
import rosbag
import rospy
from std_msgs.msg import String

from vb_core import geometry, names
from vb_core.camera_model import CameraModel
from vb_laser_detect import calibrate_camera_node
from vb_laser_detect.calibration.consistency import CameraConsistency, find_suspect
from vb_laser_detect.detection.projection import floor_points, pixels_of
from vb_msgs.msg import LaserSpot

CAMERA = CameraModel(1920, 1080, [[1100.0, 0, 950], [0, 1105.0, 545], [0, 0, 1]], [-0.2, 0.05, 0.001, -0.001, 0])
HEIGHT = 2.95
POSES = {
    name: geometry.transform(geometry.rotation_from_rpy(math.pi, 0.0, yaw), (x, 2.5, HEIGHT))
    for name, x, yaw in (("red", 2.0, 0.0), ("green", 3.0, 0.4), ("blue", 4.0, -0.2))
}


def drawn(t):
    """(x, y) [m] where all three see the spot; up to 0.3 m/s."""
    return 3.0 + 0.5 * math.cos(0.6 * t), 2.5 + 0.4 * math.sin(0.6 * t)


def spot(camera, stamp, point, mobile=False):
    message = LaserSpot(camera=camera, mobile=mobile)
    message.header.stamp, message.header.frame_id = rospy.Time.from_sec(stamp), names.MAP_FRAME
    message.position.x, message.position.y = point
    return message


def record(path, believed, seconds=11.0, cameras=tuple(POSES)):
    """Each camera at 12.5 images/s, not at the same times, puts what it sees where it believes to hang."""
    rng = np.random.default_rng(1)
    with rosbag.Bag(str(path), "w") as bag:
        for k in range(int(12.5 * seconds)):
            for i, name in enumerate(cameras):
                stamp = 1000.0 + 0.08 * k + 0.027 * i
                pixel = pixels_of(CAMERA, POSES[name], np.array([[*drawn(stamp), 0.0]]))
                assert CAMERA.contains(pixel).all()
                pixel += rng.normal(0.0, 0.2, pixel.shape)
                place = floor_points(CAMERA, believed.get(name, POSES[name]), pixel)[0, :2]
                arrived = rospy.Time.from_sec(stamp + 0.03)
                bag.write(names.SPOTS, spot(name, stamp, place), arrived)
                # a robot's camera carries its localisation error, and other topics are no spots
                bag.write(names.SPOTS, spot("robot", stamp, place + 0.5, mobile=True), arrived)
                bag.write("/chatter", String("spot"), arrived)
    return path


LINE = re.compile(r"(\w+) - (\w+): \d+ pairs, \w+ is (\S+) cm in x and (\S+) cm in y of \w+; distance (\S+) cm median")


@pytest.fixture
def check(monkeypatch, capsys):
    """Runs the command on a bag.

    Gives (status, offsets {(first, second): (x, y) [cm]}, medians {(first, second): [cm]}, what it printed).
    """

    def run(path, *arguments):
        monkeypatch.setattr(sys, "argv", ["calibrate_camera", "check", "--bag", str(path), *arguments])
        status = calibrate_camera_node.main()
        text = "".join(capsys.readouterr())
        offsets, medians = {}, {}
        for first, second, x, y, median in LINE.findall(text):
            offsets[first, second], medians[first, second] = (float(x), float(y)), float(median)
        return status, offsets, medians, text

    return run


def test_cameras_that_agree(tmp_path, check):
    status, offsets, medians, text = check(record(tmp_path / "good.bag", {}))
    assert status == 0 and "cameras agree to within 2 cm" in text
    assert set(offsets) == {("blue", "green"), ("blue", "red"), ("green", "red")}, "the robot's camera does not count"
    assert max(medians.values()) <= 0.2


def test_a_pose_that_is_shifted_is_off_by_that_amount(tmp_path, check):
    wrong = POSES["green"].copy()
    wrong[:2, 3] += (0.06, -0.025)
    path = record(tmp_path / "shifted.bag", {"green": wrong})
    status, offsets, medians, text = check(path)
    assert status == 1 and "calibrate green again" in text
    assert offsets["blue", "green"] == pytest.approx((6.0, -2.5), abs=0.15)
    assert offsets["green", "red"] == pytest.approx((-6.0, 2.5), abs=0.15)
    assert offsets["blue", "red"] == pytest.approx((0.0, 0.0), abs=0.15)
    assert medians["blue", "green"] == pytest.approx(6.5, abs=0.15)
    assert check(path, "--limit", "7")[0] == 0 and check(path, "--limit", "6")[0] == 1


def test_a_pose_that_is_tilted_is_off_by_that_angle_at_its_height(tmp_path, check):
    tilt = math.radians(1.0)
    wrong = POSES["blue"] @ geometry.transform(geometry.rotation_from_rpy(tilt, 0.0, 0.0), (0.0, 0.0, 0.0))
    status, _, medians, _ = check(record(tmp_path / "tilted.bag", {"blue": wrong}))
    assert status == 1
    # more beside the camera than below it: h * tan(1 deg) * (1 + (y / h)^2), y being up to 1 m
    below = 100 * HEIGHT * math.tan(tilt)
    assert below <= medians["blue", "green"] <= 1.15 * below and below <= medians["blue", "red"] <= 1.15 * below
    assert medians["green", "red"] <= 0.2


@pytest.mark.parametrize("cameras, code", [((), "too_few_cameras"), (("red",), "too_few_cameras")])
def test_bags_that_say_nothing_about_overlap(tmp_path, check, cameras, code):
    status, _, _, text = check(record(tmp_path / "one.bag", {}, 2.0, cameras))
    assert status == 1 and code in text


def test_cameras_that_never_see_it_together(tmp_path, check):
    with rosbag.Bag(str(tmp_path / "apart.bag"), "w") as bag:
        for k in range(200):
            stamp = 10.0 + 0.04 * k
            bag.write(names.SPOTS, spot("red" if k < 100 else "green", stamp, (1.0, 1.0)), rospy.Time.from_sec(stamp))
    status, _, _, text = check(tmp_path / "apart.bag")
    assert status == 1 and "no_overlap" in text and "draw slowly where they overlap" in text


@pytest.mark.parametrize("content", [None, b"", b"this is no bag\n"])
def test_files_that_are_no_bag(tmp_path, check, content):
    path = tmp_path / "no.bag"
    if content is not None:
        path.write_bytes(content)
    status, _, _, text = check(path)
    assert status == 1 and "bad_file" in text


def test_a_bag_whose_recording_was_cut_off(tmp_path, check):
    path = record(tmp_path / "cut.bag", {}, 2.0)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    status, _, _, text = check(path)
    assert status == 1 and "bad_file" in text


@pytest.mark.parametrize(
    "medians, wrong",
    [
        ({"ab": 0.09}, ""),  # two cameras do not show which of them is wrong
        ({"ab": 0.09, "ac": 0.01}, "b"),
        ({"ab": 0.09, "ac": 0.08, "bc": 0.01}, "a"),
        ({"ab": 0.09, "ac": 0.08, "bc": 0.07}, ""),
        ({"ab": 0.01}, ""),
    ],
)
def test_a_camera_is_named_only_if_the_others_show_that_it_is_the_one(medians, wrong):
    pairs = [
        CameraConsistency(first, second, 100, (median, 0.0), median, median)
        for (first, second), median in medians.items()
    ]
    assert find_suspect(pairs, 0.02) == wrong
