"""What the display says in addition to the last answer."""

from vb_core.notices import Notice, Severity
from vb_core.ros.messages import values_from_mapping
from vb_feedback.ros.display_messages import preview_notices, select_notices
from vb_msgs.msg import BorderIssue, BorderPreview


def texts(found):
    return [(notice.text, notice.warning) for notice in found]


def issue(severity, code, message=""):
    return BorderIssue(severity=severity, code=code, message=message)


def test_the_preview_says_what_save_would_do():
    warning, error = BorderIssue.WARNING, BorderIssue.ERROR
    assert preview_notices(None, "en") == []
    preview = BorderPreview(success=True, area_m2=2.5)
    assert texts(preview_notices(preview, "en")) == [("Saving would restrict 2.50 m\u00b2.", False)]
    preview.issues = [issue(warning, "of_the_integrator", "it parts the room."), issue(warning, "more")]
    assert texts(preview_notices(preview, "en"))[1] == ("Note: it parts the room.", True)
    refused = BorderPreview(code="c", issues=[issue(warning, "a"), issue(error, "b", "the seed is on a wall.")])
    assert texts(preview_notices(refused, "en")) == [("Saving would be refused: the seed is on a wall.", True)]
    values = values_from_mapping({"who_code": "map_integrator"})
    unreached = BorderPreview(code="no_service", values=values, message="in English")
    german = "Speichern w\u00fcrde abgelehnt: Die Kartenverwaltung l\u00e4uft nicht."
    assert texts(preview_notices(unreached, "de")) == [(german, True)]


def test_what_others_say_is_said_whatever_its_words():
    held = [
        Notice("robot_in_a_newer_version", Severity.ERROR, message="Der Roboter steht im Teppich."),
        Notice("stopped", Severity.WARNING),
        Notice("stopped", Severity.WARNING, robot="b"),
        Notice("robot_coming_along", Severity.INFO, message="It comes."),
    ]
    assert texts(select_notices(held, "en")) == [
        ("Der Roboter steht im Teppich.", True),
        ('Stopped: no robot drives until you say "resume".', True),
        ("It comes.", False),
    ]
    assert "Angehalten" in texts(select_notices(held, "de"))[1][0]
    assert len(select_notices([Notice(f"code_{number}") for number in range(9)], "en")) == 3
