"""Turns that navigation makes to and fro are finished; all its other requests pass as they are."""

import math

import numpy as np
import pytest

from vb_robot.driving.spot_follower import VelocityRequest
from vb_robot.driving.turn_finisher import TurnFinisher

STEP = 0.05  # [s]


def turned_round(seed, finisher):
    """Whether a robot that faces away from its path gets round, with a controller that behind itself sees no better way."""
    rng = np.random.default_rng(seed)
    yaw, w = math.pi + rng.uniform(-0.2, 0.2), 0.0
    for step in range(int(30.0 / STEP)):
        off = math.remainder(yaw, 2.0 * math.pi)
        if abs(off) < 0.3:
            return True
        if step % 20 == 0:
            # as DWA was seen to do: back to where it faced away, and beyond
            w = math.copysign(rng.uniform(0.2, 0.4), off) if abs(off) > math.radians(120) else -math.copysign(0.5, off)
        request = VelocityRequest(0.02 * float(rng.random() < 0.3), w)
        yaw += STEP * (finisher.finish(STEP * step, request, (1.0, 2.0, yaw)) if finisher else request).w
    return False


def test_a_robot_that_faces_away_from_its_path_turns_round():
    assert all(turned_round(seed, TurnFinisher()) for seed in range(30))
    assert not any(turned_round(seed, None) for seed in range(30))


def passed(requests, pose=lambda now: (0.0, 0.0, 0.0), step=1.0):
    """What becomes of requests (v, w), one each `step` [s]."""
    finisher = TurnFinisher()
    found = [
        finisher.finish(step * number, VelocityRequest(*request), pose(step * number))
        for number, request in enumerate(requests)
    ]
    return [(request.v, request.w) for request in found]


TO_AND_FRO = [(0.0, 0.3), (0.0, 0.3), (0.0, -0.3), (0.0, 0.3), (0.0, -0.3), (0.0, 0.3), (0.0, -0.3)]


@pytest.mark.parametrize(
    "requests",
    [
        TO_AND_FRO[:4],
        [(0.0, 0.3), (0.0, -0.3), (0.2, 0.3), (0.0, -0.3), (0.0, 0.3), (0.0, -0.3)],
        [(0.3, 0.3), (0.3, -0.3), (0.3, 0.3), (0.3, -0.3), (0.3, 0.3)],
    ],
    ids=["corrections", "drives between", "a winding path"],
)
def test_other_requests_pass(requests):
    assert passed(requests) == requests


def test_turns_to_and_fro_go_on_in_one_direction_until_navigation_drives():
    found = passed([*TO_AND_FRO, (0.2, 0.3)])
    assert found[:5] == TO_AND_FRO[:5]
    assert found[5] == found[6] == (0.0, -0.5)
    assert found[7] == (0.2, 0.3)


def test_a_stop_is_a_stop():
    assert passed([*TO_AND_FRO[:6], (0.0, 0.0)])[-1] == (0.0, 0.0)


def test_turns_with_minutes_between_them_are_turns_of_their_own():
    assert passed(TO_AND_FRO, step=60.0) == TO_AND_FRO


def test_a_robot_that_comes_along_or_does_not_know_where_it_is_turns_as_navigation_requests():
    assert passed(TO_AND_FRO, pose=lambda now: (0.1 * now, 0.0, 0.0)) == TO_AND_FRO
    assert passed(TO_AND_FRO, pose=lambda now: None) == TO_AND_FRO
