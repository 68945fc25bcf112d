"""What the display says beside the last answer."""
from __future__ import annotations

import numpy as np

from vb_core.grid_map import GridMap
from vb_feedback.notices import Preview, Workspace, of_preview, of_spot


def texts(found):
    return [(notice.text, notice.warning) for notice in found]


def test_what_save_would_do():
    assert of_preview(None) == []
    assert texts(of_preview(Preview(True, "Ok.", (), 2.5))) == [("Save would restrict 2.50 m2.", False)]
    mind = of_preview(Preview(True, "Ok.", ((False, "it parts the room."), (False, "more")), 8.0))
    assert texts(mind)[1] == ("Mind: it parts the room.", True)
    refused = of_preview(Preview(False, "Cannot be added.", ((False, "a"), (True, "the seed is on a wall."))))
    assert texts(refused) == [("Save would be refused: the seed is on a wall.", True)]
    assert texts(of_preview(Preview(False, "No map."))) == [("Save would be refused: No map.", True)]


def test_a_robot_in_a_border_stays_said_until_it_has_left():
    workspace = Workspace(6.0)
    assert workspace.notices(0.0) == []
    workspace.hear("the robot is inside 'Carpet'", 1.0)
    workspace.hear("the goal of the robot at x 1.00 m, y 2.00 m lies inside 'Carpet'", 2.0)
    assert texts(workspace.notices(3.0)) == [
        ("The robot is inside 'Carpet'.", True),
        ("The goal of the robot at x 1.00 m, y 2.00 m lies inside 'Carpet'.", True),
    ]
    assert texts(workspace.notices(500.0)) == [("The robot is inside 'Carpet'.", True)]
    workspace.hear("the robot has left 'Carpet'", 501.0)
    assert texts(workspace.notices(502.0)) == [("The robot has left 'Carpet'.", False)]
    workspace.hear("the robot is inside 'Carpet'", 503.0)
    workspace.hear("", 503.5)
    assert workspace.notices(504.0) == []
    workspace.hear("the robot has left 'Carpet'", 505.0)
    # it goes, also if time jumps back
    assert workspace.notices(600.0) == workspace.notices(3.0) == []


def test_a_spot_that_nobody_sees():
    covered = GridMap(np.ones((50, 80), np.int8), 0.1)
    corner = covered.data.copy()
    corner[:10, :10] = 0
    partly = covered.with_data(corner)
    assert of_spot("default", (), (1.0, 1.0), partly, True) == of_spot("border", ("red",), (1.0, 1.0), partly, True) == []
    assert of_spot("border", (), None, partly, True) == []
    assert texts(of_spot("border", (), (1.2, 0.5), partly, True)) == [("No camera sees this place: a robot will be sent.", True)]
    # where cameras see all the floor it was switched off
    assert of_spot("seed", (), (1.2, 0.5), covered, True) == of_spot("seed", (), (6.0, 4.0), partly, True) == []
    assert texts(of_spot("seed", (), (1.2, 0.5), None, True)) == [("No camera sees a spot. Keep pointing: a robot comes.", False)]
    for coverage in (None, partly):
        assert "robot" not in texts(of_spot("seed", (), (1.2, 0.5), coverage, False))[0][0]
