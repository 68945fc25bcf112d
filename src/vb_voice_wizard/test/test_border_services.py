"""What the manager says of a border that other nodes do not give."""

import pytest

from refusals import refused
from vb_core.errors import CodedError
from vb_core.notices import Notice, Severity
from vb_core.ros import services
from vb_msgs.msg import VirtualBorder
from vb_msgs.srv import GetDrawnBorderResponse, UndoRedoResponse
from vb_voice_wizard.dialogue import border_services
from vb_voice_wizard.interaction_manager_node import _what_changed


@pytest.fixture
def made(monkeypatch):
    """Makes the services, with a border_fusion that has seen no spot, of what people are told."""
    monkeypatch.setattr(services, "call", lambda *_arguments, **_more: GetDrawnBorderResponse(code="no_spots"))
    return lambda *notices: border_services.BorderServices(1.0, 1.0, 1.0, lambda: list(notices))


def refusal(made, *notices):
    with pytest.raises(CodedError) as caught:
        made(*notices).fetch_drawn_border("i1")
    return caught.value


def test_without_spots_the_laser_is_to_blame(made):
    about_a_robot = Notice("robot_caught_in_border", Severity.ERROR, robot="r1")
    slow = Notice("lab_camera_slow", Severity.WARNING, camera="north", values={"rate": "2"})
    assert refusal(made, about_a_robot, slow).code == "no_spots"


def test_without_spots_a_faulty_camera_is_to_blame_before_the_laser(made):
    error = refusal(made, Notice("camera_no_pose", Severity.ERROR, camera="south", values={"camera": "south"}))
    assert error.code == "camera_no_pose" and "south" in error.message


def test_what_cannot_be_redone_says_why_by_a_code(monkeypatch):
    monkeypatch.setattr(services, "call", lambda *_arguments, **_more: UndoRedoResponse(code="nothing_to_redo"))
    with refused("nothing_to_redo"):
        border_services.BorderServices(1.0, 1.0, 1.0, list).change("redo", "r1")


def test_what_was_undone_is_named():
    def told(before, after, command="undo"):
        answer = _what_changed(
            command, {border.id: border for border in before}, {border.id: border for border in after}
        )
        return answer.code, answer.values.get("borders")

    rug, bed = VirtualBorder(id="b1", name="Rug", enabled=True), VirtualBorder(id="b2", name="Bed", enabled=True)
    off, renamed = VirtualBorder(id="b1", name="Rug"), VirtualBorder(id="b1", name="Carpet", enabled=True)
    # what the map integrator fills in is nobody's change
    idle = VirtualBorder(id="b2", name="Bed", enabled=True, reason="inactive_on_this_map")
    assert told([rug, bed], [rug]) == ("border_removed", "Bed")
    assert told([rug], [rug, bed]) == ("border_restored", "Bed")
    assert told([rug, bed], [off, idle]) == ("border_disabled", "Rug")
    assert told([off, bed], [rug, bed]) == ("border_enabled", "Rug")
    assert told([rug, bed], [renamed, bed]) == ("change_undone", "Carpet")
    assert told([rug, bed], [renamed, bed], "redo") == ("change_redone", "Carpet")
    assert told([rug], [off, bed]) == ("borders_changed", None)
    assert told([rug, idle], [rug, bed]) == ("borders_changed", None)
