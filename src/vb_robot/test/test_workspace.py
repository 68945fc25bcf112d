"""What a robot keeps out of, and how uncertain its place is."""

import math

import numpy as np
import pytest

from plain_rooms import empty, with_border

from vb_robot.driving.workspace import MAX_UNCERTAINTY, MIN_UNCERTAINTY, UNCERTAINTY_UPDATES, PoseUncertainty, Workspace


def workspace(value=100):
    """One with a square border, and a wall."""
    physical = with_border(empty(6.0, resolution=0.05), 3.0, 0.0, 3.05, 5.0)
    return Workspace(with_border(physical, 0.5, 0.5, 1.5, 1.5, value), physical, 0.18), physical


def test_a_map_lets_a_robot_out_but_not_further_in():
    ground = Workspace(with_border(empty(), 4.0, 0.0, 8.0, 5.0), empty(), 0.18)
    assert ground.free_distance((3.0, 2.5, 0.0), 0.2, 0.0, 0.05) == pytest.approx(1.0 - 0.18 - 0.05, abs=0.04)
    assert ground.free_distance((3.9, 2.5, 0.0), 0.2, 0.0, 0.05) <= 0.04
    assert ground.free_distance((3.9, 2.5, 0.0), -0.2, 0.0, 0.05) == math.inf


def test_borders_but_not_walls_grow_by_the_pose_uncertainty():
    plain, physical = workspace()
    uncertain = Workspace(plain.borders, physical, 0.18, uncertainty=0.1)
    beside_border, beside_wall = (2.0, 1.0, math.pi), (2.4, 4.0, 0.0)
    for pose, less in ((beside_border, 0.1), (beside_wall, 0.0)):
        before, after = (here.free_distance(pose, 0.2, 0.0, 0.0) for here in (plain, uncertain))
        assert before - after == pytest.approx(less, abs=0.03)
    soft = Workspace(workspace(75)[0].borders, physical, 0.18, uncertainty=0.1)
    assert np.array_equal(soft.keep_out.data, soft.borders.data), "what may be entered is not made larger"


def test_navigations_map_has_what_the_driver_keeps_out_of():
    plain, physical = workspace()
    data = plain.borders.data.copy()
    data[31:, :] = -1
    here = Workspace(
        plain.borders.with_data(data), physical.with_data(np.minimum(data, physical.data)), 0.18, uncertainty=0.1
    )
    grown = here.keep_out.data != here.borders.data
    assert grown.any() and (here.keep_out.data[grown] == 100).all() and (here.borders.data[grown] == 0).all()
    assert (here.keep_out.data[data < 0] == -1).all(), "unknown floor stays unknown: navigation does not plan there"


def spread(std, turned=np.eye(2)):
    """The covariance (3, 3) of x, y and yaw; std (2,) [m] along turned axes."""
    covariance = np.diag([0.0, 0.0, 0.01])
    covariance[:2, :2] = turned @ np.diag(std) ** 2 @ turned.T
    return covariance


def test_the_uncertainty_rises_at_once_and_falls_slowly():
    uncertainty = PoseUncertainty()
    assert uncertainty.meters == MIN_UNCERTAINTY, "without a covariance"
    assert not uncertainty.add(spread([0.01, 0.005])) and uncertainty.meters == MIN_UNCERTAINTY
    turned = np.array([[0.5, 0.5], [-0.5, 0.5]]) * math.sqrt(2.0)
    assert uncertainty.add(spread([0.12, 0.005], turned)), "the worst direction, in steps"
    assert uncertainty.meters == pytest.approx(0.075)
    changed = [uncertainty.add(spread([0.01, 0.01])) for _ in range(UNCERTAINTY_UPDATES)]
    assert changed == [False] * (UNCERTAINTY_UPDATES - 1) + [True] and uncertainty.meters == MIN_UNCERTAINTY
    assert not uncertainty.lost
    uncertainty.add(np.full((3, 3), math.nan))
    assert uncertainty.meters == MAX_UNCERTAINTY, "what makes no sense is no reason to come nearer"


@pytest.mark.parametrize(
    "covariance, lost",
    [
        (np.diag([0.1, 0.1, 0.1]) ** 2, False),
        (np.diag([3.0, 0.1, 0.1]) ** 2, True),
        (np.diag([0.1, 0.1, 1.0]) ** 2, True),
        (np.full((3, 3), math.nan), True),
        (np.diag([0.01, 0.01, math.nan]), True),
        (np.diag([0.01, 0.01, -1.0]), True),
    ],
)
def test_a_localisation_that_may_be_anywhere_is_lost(covariance, lost):
    uncertainty = PoseUncertainty()
    uncertainty.add(covariance)
    assert uncertainty.lost == lost
    uncertainty.add(np.diag([0.05, 0.05, 0.05]) ** 2)
    assert not uncertainty.lost
