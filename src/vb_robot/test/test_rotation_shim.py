"""A robot that faces away from navigation's path is turned towards it; all other requests pass as they are."""

import math

import numpy as np
import pytest

from vb_robot.driving.rotation_shim import RECOVERY, RotationShim
from vb_robot.driving.velocity import VelocityRequest

STEP, NOW = 0.05, 100.0  # [s]
PATH = np.column_stack([np.linspace(0.0, 3.0, 61), np.zeros(61)])


def shim_with(path=PATH):
    shim = RotationShim()
    shim.path = path
    return shim


def align(shim, v, w, yaw, now=NOW):
    """Returns what the shim makes of a request [m/s, rad/s] for a robot on the path with this yaw [rad]."""
    aligned = shim.align(VelocityRequest(v, w), (1.0, 0.0, yaw), now)
    return aligned.v, aligned.w


def turned_round(seed, shim, sweep_s):
    """Returns whether a robot that faces away turns round though its controller turns to and fro, each for `sweep_s` [s]."""
    rng = np.random.default_rng(seed)
    x, y = 1.0, 0.0
    yaw = math.pi + rng.uniform(-0.2, 0.2)
    for step in range(int(30.0 / STEP)):
        offset = math.remainder(yaw, 2.0 * math.pi)
        if abs(offset) < 0.3:
            return True
        if step % int(sweep_s / STEP) == 0:
            # back to facing away, and beyond
            rate = rng.uniform(0.2, 0.4) if abs(offset) > math.radians(110) else -0.5
            w = math.copysign(1.0, offset) * rate
        request = VelocityRequest(0.03 * float(rng.random() < 0.3), w)
        aligned = shim.align(request, (x, y, yaw), NOW) if shim else request
        x, y = x + STEP * aligned.v * math.cos(yaw), y + STEP * aligned.v * math.sin(yaw)
        yaw += STEP * aligned.w
    return False


@pytest.mark.parametrize("sweep_s", [1.0, 3.0])
def test_a_robot_that_faces_away_from_its_path_turns_round(sweep_s):
    assert all(turned_round(seed, shim_with(), sweep_s) for seed in range(30))
    assert not all(turned_round(seed, None, sweep_s) for seed in range(30))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_it_turns_the_shorter_way_and_keeps_to_it(side):
    shim = shim_with()
    for degrees in (170, 175, 185, 190, 120, 91, 80, 40):
        v, w = align(shim, 0.1, -side * 0.3, side * math.radians(degrees))
        assert v == 0.0
        assert -side * w >= 0.5
    for degrees in (20, 80):  # it has turned round; and a path to the side is not behind
        assert align(shim, 0.1, side * 0.3, side * math.radians(degrees)) == (0.1, side * 0.3)
    assert align(shim, 0.0, 1.2, side * 3.0)[1] == -side * 1.2, "a faster turn keeps its speed"


def test_a_stop_is_a_stop():
    shim = shim_with()
    align(shim, 0.0, 0.3, 3.0)
    assert align(shim, 0.0, 0.0, 3.0) == (0.0, 0.0)
    # a new drive begins after the stop, with the path to the robot's side
    align(shim, 0.0, 0.0, math.radians(-80))
    assert align(shim, 0.1, 0.2, math.radians(-80)) == (0.1, 0.2)


OTHERS = {
    "no path": (None, (1.0, 0.0, math.pi)),
    "an empty path": (np.empty((0, 2)), (1.0, 0.0, math.pi)),
    "no pose": (PATH, None),
    "the path is ahead": (PATH, (1.0, 0.0, 1.0)),
    "at the goal": (PATH, (3.05, 0.0, 0.0)),
    "within its tolerance": (PATH, (2.78, 0.0, math.pi)),
    "another path": (PATH, (1.0, 2.0, math.pi)),
}


@pytest.mark.parametrize("path, pose", OTHERS.values(), ids=OTHERS)
def test_all_other_requests_pass(path, pose):
    shim = shim_with(path)
    for request in (VelocityRequest(0.1, 0.3), VelocityRequest(0.0, -0.3), VelocityRequest(-0.1, 0.0)):
        assert shim.align(request, pose, NOW) == request


def test_a_path_that_bends_is_followed_from_the_nearest_place():
    corner = np.concatenate([PATH, np.column_stack([np.full(40, 3.0), np.linspace(0.05, 2.0, 40)])])
    aligned = shim_with(corner).align(VelocityRequest(0.1, 0.0), (3.0, 0.5, math.radians(-85)), NOW)
    assert aligned.v == 0.0
    assert aligned.w > 0.0


def test_a_turning_recovery_passes_until_navigation_drives_on():
    shim = shim_with()
    assert align(shim, 0.0, 1.0, -3.0)[1] > 0.0
    shim.recover(NOW)
    for degrees in range(0, 360, 10):  # a full turn, also while facing away
        assert align(shim, 0.0, 1.0, math.radians(degrees), NOW + 0.04 * degrees) == (0.0, 1.0)
    assert align(shim, 0.1, 0.0, -3.0, NOW + 15.0)[0] == 0.0, "the controller drives again"
    shim.recover(NOW)
    assert align(shim, 0.0, -1.0, -3.0, NOW + RECOVERY + 0.1)[1] > 0.0


def test_reverse_is_never_turned_into_a_turn():
    assert align(shim_with(), -0.2, 0.0, 3.0) == (-0.2, 0.0)
