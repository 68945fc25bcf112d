"""What the manager says of a border that its neighbours do not give."""
import pytest

from vb_core.errors import CodedError
from vb_core.notices import Notice, Severity
from vb_core.ros import services
from vb_core.ros.notices import message_from_notice
from vb_msgs.msg import NoticeArray
from vb_msgs.srv import GetDrawnBorderResponse
from vb_voice_wizard.dialogue import border_services


@pytest.fixture
def neighbours(monkeypatch):
    """The services, with a border_fusion that has seen no spot."""
    monkeypatch.setattr(border_services.rospy, "get_time", lambda: 10.0)
    monkeypatch.setattr(services, "call", lambda *_arguments, **_more: GetDrawnBorderResponse(code="no_spots"))
    return border_services.BorderServices("border", 1.0, 1.0, 1.0)


def refusal(neighbours, *notices):
    messages = [message_from_notice(notice) for notice in notices]
    neighbours.on_notices(NoticeArray(source="/lab_monitor", notices=messages))
    with pytest.raises(CodedError) as caught:
        neighbours.candidate("i1")
    return caught.value


def test_without_spots_the_laser_is_to_blame(neighbours):
    about_a_robot = Notice("robot_inside_border", Severity.ERROR, robot="r1")
    slow = Notice("lab_camera_slow", Severity.WARNING, camera="north", values={"rate": "2"})
    assert refusal(neighbours, about_a_robot, slow).code == "no_spots"


def test_without_spots_a_faulty_camera_is_to_blame_before_the_laser(neighbours):
    error = refusal(neighbours, Notice("camera_no_pose", Severity.ERROR, camera="south", values={"camera": "south"}))
    assert error.code == "camera_no_pose" and "south" in error.message
    # mended meanwhile
    assert refusal(neighbours).code == "no_spots"
