"""What a robot is to look at: the spot, or a little ahead of it while it moves."""

import numpy as np
import pytest

from vb_core.grid_map import GridMap
from vb_robot.clearance_map import ClearanceMap
from vb_robot.dispatching.drawing import MAX_LOOKAHEAD, MIN_LOOKAHEAD, REACTION, DrawingState

RIGHT = np.array([0.3, 0.0])  # [m/s]


def room():
    """8 m x 5 m with walls."""
    data = np.zeros((100, 160), dtype=np.int8)
    data[[0, -1]] = 100
    data[:, [0, -1]] = 100
    return ClearanceMap(GridMap(data, 0.05), 0.18)


CLEARANCE_MAP = room()


@pytest.mark.parametrize(
    "x, velocity, seeding, expected",
    [
        (4.5, None, False, 4.5),
        (4.5, RIGHT, True, 4.5),
        (4.5, RIGHT, False, 4.5 + MIN_LOOKAHEAD),
        (4.5, 3.0 * RIGHT, False, 4.5 + 0.45 * REACTION),
        (4.5, 9.0 * RIGHT, False, 4.5 + MAX_LOOKAHEAD),
        (4.5, -RIGHT, False, 4.5 - MIN_LOOKAHEAD),
        (7.8, RIGHT, False, 7.9),
        (7.94, RIGHT, False, 7.94),
    ],
    ids="rests seed slow quick very_quick left to_a_wall at_a_wall".split(),
)
def test_looks_ahead_of_a_spot_that_moves_and_not_into_a_wall(x, velocity, seeding, expected):
    drawing = DrawingState(np.array([x, 2.5]), velocity=velocity, seeding=seeding)
    ahead = drawing.line_ahead(CLEARANCE_MAP)
    assert drawing.look_at(ahead) == pytest.approx((expected, 2.5), abs=0.06)
    assert ahead[0] == pytest.approx((x, 2.5)) and ahead[:, 0].max() <= 7.95
