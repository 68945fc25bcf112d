"""What the display says beside the last answer."""
from __future__ import annotations

import numpy as np

from vb_core.grid_map import GridMap
from vb_core.notices import Notice as Held
from vb_core.notices import Severity
from vb_feedback.display.notices import Issue, Preview, of_others, preview_notices, coverage_notices


def texts(found):
    return [(notice.text, notice.warning) for notice in found]


def test_what_save_would_do():
    assert preview_notices(None, "en") == []
    assert texts(preview_notices(Preview(True, area_m2=2.5), "en")) == [("Save would restrict 2.50 m\u00b2.", False)]
    found = (Issue(False, "of_the_integrator", (), "it parts the room."), Issue(False, "more"))
    mind = preview_notices(Preview(True, issues=found, area_m2=8.0), "en")
    assert texts(mind)[1] == ("Mind: it parts the room.", True)
    errors = (Issue(False, "a"), Issue(True, "b", (), "the seed is on a wall."))
    refused = preview_notices(Preview(False, Issue(True, "c"), errors), "en")
    assert texts(refused) == [("Save would be refused: the seed is on a wall.", True)]
    why = Issue(True, "no_service", (("who", "$map_integrator"),), "in English")
    assert texts(preview_notices(Preview(False, why), "de")) == [
        ("Speichern w\u00fcrde abgelehnt: Die Kartenverwaltung l\u00e4uft nicht.", True)
    ]


def test_what_others_say_is_said_whatever_its_words():
    held = [
        Held("robot_in_a_newer_version", Severity.ERROR, message="Der Roboter steht im Teppich."),
        Held("robots_stopped", Severity.WARNING), Held("robots_stopped", Severity.WARNING, robot="b"),
        Held("robot_coming_along", Severity.INFO, message="It comes."),
    ]
    assert texts(of_others(held, "en")) == [
        ("Der Roboter steht im Teppich.", True), ("Robots are stopped. Say resume to let them drive.", True), ("It comes.", False),
    ]
    assert "angehalten" in texts(of_others(held, "de"))[1][0]
    assert len(of_others([Held(f"code_{number}") for number in range(9)], "en")) == 3


def test_a_spot_that_nobody_sees():
    covered = GridMap(np.ones((50, 80), np.int8), 0.1)
    corner = covered.data.copy()
    corner[:10, :10] = 0
    partly = covered.with_data(corner)
    assert coverage_notices("default", (), (1.0, 1.0), partly, True, (), "en") == coverage_notices("border", ("red",), (1.0, 1.0), partly, True, (), "en") == []
    assert coverage_notices("border", (), None, partly, True, (), "en") == []
    assert texts(coverage_notices("border", (), (1.2, 0.5), partly, True, (), "en")) == [("No camera sees this place: a robot will be sent.", True)]
    # where cameras see all the floor it was switched off
    assert coverage_notices("seed", (), (1.2, 0.5), covered, True, (), "en") == coverage_notices("seed", (), (6.0, 4.0), partly, True, (), "en") == []
    assert texts(coverage_notices("seed", (), (1.2, 0.5), None, True, (), "en")) == [("No camera sees a spot. Keep pointing: a robot comes.", False)]
    for coverage in (None, partly):
        assert "robot" not in texts(coverage_notices("seed", (), (1.2, 0.5), coverage, False, (), "en"))[0][0]
    # a dispatcher that says so itself knows better
    assert coverage_notices("border", (), (1.2, 0.5), partly, True, [Held("spot_unseen_robot_comes")], "en") == []
