"""What the display says beside the last answer."""

from __future__ import annotations

import numpy as np

from vb_core.grid_map import GridMap
from vb_core.notices import Notice
from vb_core.notices import Severity
from vb_core.ros.messages import values_from_mapping
from vb_feedback.display.display_messages import preview_notices
from vb_feedback.display.notices import coverage_notices, select_others
from vb_msgs.msg import BorderIssue, BorderPreview


def texts(found):
    return [(notice.text, notice.warning) for notice in found]


def issue(severity, code, message=""):
    return BorderIssue(severity=severity, code=code, message=message)


def test_what_save_would_do():
    warning, error = BorderIssue.WARNING, BorderIssue.ERROR
    assert preview_notices(None, "en") == []
    preview = BorderPreview(success=True, area_m2=2.5)
    assert texts(preview_notices(preview, "en")) == [("Saving would restrict 2.50 m\u00b2.", False)]
    preview.issues = [issue(warning, "of_the_integrator", "it parts the room."), issue(warning, "more")]
    assert texts(preview_notices(preview, "en"))[1] == ("Note: it parts the room.", True)
    refused = BorderPreview(code="c", issues=[issue(warning, "a"), issue(error, "b", "the seed is on a wall.")])
    assert texts(preview_notices(refused, "en")) == [("Saving would be refused: the seed is on a wall.", True)]
    values = values_from_mapping({"who": "$map_integrator"})
    unreached = BorderPreview(code="no_service", values=values, message="in English")
    assert texts(preview_notices(unreached, "de")) == [
        ("Speichern w\u00fcrde abgelehnt: Die Kartenverwaltung l\u00e4uft nicht.", True)
    ]


def test_what_others_say_is_said_whatever_its_words():
    held = [
        Notice("robot_in_a_newer_version", Severity.ERROR, message="Der Roboter steht im Teppich."),
        Notice("stopped", Severity.WARNING),
        Notice("stopped", Severity.WARNING, robot="b"),
        Notice("robot_coming_along", Severity.INFO, message="It comes."),
    ]
    assert texts(select_others(held, "en")) == [
        ("Der Roboter steht im Teppich.", True),
        ('Stopped: no robot drives until you say "resume".', True),
        ("It comes.", False),
    ]
    assert "Angehalten" in texts(select_others(held, "de"))[1][0]
    assert len(select_others([Notice(f"code_{number}") for number in range(9)], "en")) == 3


def test_a_spot_that_nobody_sees():
    covered = GridMap(np.ones((50, 80), np.int8), 0.1)
    corner = covered.data.copy()
    corner[:10, :10] = 0
    partly = covered.with_data(corner)
    assert (
        coverage_notices("default", (), (1.0, 1.0), partly, True, (), "en")
        == coverage_notices("border", ("red",), (1.0, 1.0), partly, True, (), "en")
        == []
    )
    assert coverage_notices("border", (), None, partly, True, (), "en") == []
    assert texts(coverage_notices("border", (), (1.2, 0.5), partly, True, (), "en")) == [
        ("No camera sees this place: a robot will be sent.", True)
    ]
    # where cameras see all the floor it was switched off
    assert (
        coverage_notices("seed", (), (1.2, 0.5), covered, True, (), "en")
        == coverage_notices("seed", (), (6.0, 4.0), partly, True, (), "en")
        == []
    )
    assert texts(coverage_notices("seed", (), (1.2, 0.5), None, True, (), "en")) == [
        ("No camera sees a spot. Keep pointing: a robot is coming.", False)
    ]
    for coverage in (None, partly):
        assert "robot" not in texts(coverage_notices("seed", (), (1.2, 0.5), coverage, False, (), "en"))[0][0]
    # others that say so themselves know better
    for code in ("spot_not_seen_robot_looks", "spot_not_seen_check_laser"):
        assert coverage_notices("border", (), (1.2, 0.5), partly, True, [Notice(code)], "en") == []
