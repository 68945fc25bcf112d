"""Messages and notices become the states of entities."""

import cv2
import numpy as np
import rospy
from diagnostic_msgs.msg import KeyValue
from geometry_msgs.msg import Point
from vb_msgs.msg import InteractionState, VirtualBorder

from vb_core.grid_map import GridMap
from vb_core.notices import Notice, Severity
from vb_core.offer import ConnectedRobot, Connections, offer
from vb_mqtt import states


def asked(seconds_ago, code="confirm_save"):
    message = InteractionState(last_code=code, last_command="save", last_source="home_assistant", stop_number="1a")
    message.last_values = [KeyValue("command", "save"), KeyValue("answer", "yes save")]
    message.header.stamp = rospy.Time(1000)
    message.last_answered = rospy.Time(1000 - seconds_ago)
    return message


def test_a_question_is_open_until_it_is_too_old():
    question = states.question_value(asked(5), "en")
    assert (question["command"], question["answer"], question["asked"]) == ("save", "yes_save", "home_assistant")
    assert "yes save" in question["question"] and question["stop_number"] == "1a"
    assert states.question_value(asked(31), "en")["question"] == states.NOBODY_ASKS
    for code in ("saved", "confirm_map_first"):
        assert states.question_value(asked(5, code), "en")["answer"] == ""


def test_a_borders_state_has_its_name_area_and_zone():
    border = VirtualBorder(name="Rug", enabled=True, area_m2=2.345, zone=VirtualBorder.SLOW, reason="disabled")
    state = states.border_value(border)
    assert (state["border"], state["enabled"], state["in_force"], state["area_m2"]) == ("Rug", True, False, 2.35)
    assert (state["zone"], state["reason"]) == ("slow", "disabled")
    assert states.border_value(VirtualBorder(area_m2=float("nan")))["area_m2"] is None


def test_a_robots_problems_are_its_own():
    lines = offer(Connections((ConnectedRobot("ada", driver=True, localized=True), ConnectedRobot("bob")))).lines
    notices = [Notice("robot_stopped", Severity.WARNING, robot="ada", values={"who": "ada"})]
    notices.append(Notice("camera_silent", Severity.ERROR, camera="red", values={"camera": "red"}))
    assert states.robot_problems("ada", lines, notices, "en") == [notices[0].sentence()]
    assert len(states.robot_problems("bob", lines, notices, "en")) == 1  # it is not there
    # the only robot has no name, and neither has a notice that is about no robot
    alone = offer(Connections((ConnectedRobot("", driver=True, localized=True),))).lines
    notices.append(Notice("robot_stopped", Severity.WARNING, values={"who": "$the_robot"}))
    assert states.robot_problems("", alone, notices, "en") == [notices[2].sentence()]


def test_long_sentences_fit_the_hubs_states():
    message = InteractionState(last_code="of_a_newer_version", last_message="x" * 900)
    assert len(states.state_value(message, "en")["last_answer"]) <= 255


def test_the_picture_shows_walls_and_borders_where_they_are():
    cells = np.zeros((100, 200), np.int8)
    cells[:, :10] = 100  # a wall at low x
    cells[:10, 100:] = -1
    before = GridMap(cells, 0.05, (0.0, 0.0, 0.0))
    after = before.with_data(np.where(np.indices(cells.shape)[0] >= 50, 100, cells).astype(np.int8))
    border = VirtualBorder(
        kind=VirtualBorder.SEPARATING_CURVE, enabled=True, points=[Point(0, 2.5, 0), Point(10, 2.5, 0)]
    )

    def drawn(*borders):
        return cv2.imdecode(np.frombuffer(states.draw_map(before, after, borders), np.uint8), cv2.IMREAD_COLOR)

    picture = drawn(border)
    assert picture.shape == (500, 1000, 3)

    def at(x, y):
        return picture[int(500 - y / 5.0 * 500), int(x / 10.0 * 1000)].astype(int)

    assert at(0.2, 1.0).max() < 60  # wall
    assert at(5.0, 1.0).min() > 250  # free
    blue, _, red = at(5.0, 4.0)
    assert red > blue + 80  # restricted
    assert np.ptp(at(8.0, 0.2)) < 10 and 150 < at(8.0, 0.2).mean() < 250  # unknown
    line = at(5.0, 2.5)
    assert line[2] > line[0] + 100
    border.enabled = False
    picture = drawn(border)
    assert np.ptp(at(5.0, 2.5)) < 10  # grey
    # one that cannot be drawn is left out
    nowhere = [VirtualBorder(), VirtualBorder(points=[Point(1, float("nan"), 0), Point(2, 2, 0)])]
    assert np.array_equal(drawn(*nowhere), drawn())
