"""What the manager says of a border that other nodes do not give."""
import pytest

from vb_core.errors import CodedError
from vb_core.notices import Notice, Severity
from vb_core.ros import services
from vb_msgs.srv import GetDrawnBorderResponse
from vb_voice_wizard.dialogue import border_services


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
    about_a_robot = Notice("robot_inside_border", Severity.ERROR, robot="r1")
    slow = Notice("lab_camera_slow", Severity.WARNING, camera="north", values={"rate": "2"})
    assert refusal(made, about_a_robot, slow).code == "no_spots"


def test_without_spots_a_faulty_camera_is_to_blame_before_the_laser(made):
    error = refusal(made, Notice("camera_no_pose", Severity.ERROR, camera="south", values={"camera": "south"}))
    assert error.code == "camera_no_pose" and "south" in error.message
