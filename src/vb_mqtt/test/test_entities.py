"""Entities for Home Assistant: their descriptions, the messages of their buttons, and their states."""

import re
from datetime import datetime, timezone

import cv2
import jinja2
import numpy as np
import pytest
import rospy
from diagnostic_msgs.msg import KeyValue
from geometry_msgs.msg import Point

from vb_testing import assert_fields
from vb_core import sentences
from vb_core.grid_map import GridMap
from vb_core.notices import Notice, Severity
from vb_core.capabilities import ConnectedRobot, Connections, derive_capabilities
from vb_core.interaction_tables import COMMANDS, STATES
from vb_mqtt import entities
from vb_mqtt.entities import LabEntities, describe_entities, key_from_topic, entity_key, find_stale_topics
from vb_mqtt.incoming_requests import Inbox
from vb_msgs.msg import InteractionState, VirtualBorder

NOW = 1_700_000_000.25
LAB = LabEntities("lab1", "en", ("red", "green"), ("", "ada"), {"b1": "Nursery", "ü/#+": "border 2"})


def request_of_press(config, attributes, value="PRESS"):
    """Renders the command template as Home Assistant does, and returns the inbox's request."""
    environment = jinja2.Environment()
    environment.globals["now"] = lambda: datetime.fromtimestamp(NOW, timezone.utc)
    rendered = environment.from_string(config["command_template"]).render(this={"attributes": attributes}, value=value)
    return Inbox(NOW - 60.0).accept_request(rendered.encode(), False, NOW + 1.0)


def config_of(key):
    return next(config for topic, config in describe_entities(LAB).items() if key_from_topic(topic) == key)


def test_all_entities_are_one_device_with_unique_ids():
    configs = describe_entities(LAB).values()
    assert len({config["unique_id"] for config in configs}) == len(configs)
    assert {tuple(config["device"]["identifiers"]) for config in configs} == {("lab1",)}
    assert all(config["name"] for config in configs)


@pytest.mark.parametrize("topic, config", describe_entities(LAB).items(), ids=describe_entities(LAB))
def test_an_entitys_topics_follow_from_its_key(topic, config):
    _, platform, _, key, _ = topic.split("/")
    assert topic == f"homeassistant/{platform}/lab1/{key}/config"
    assert re.fullmatch("[A-Za-z0-9_-]+", key)
    # the entity id of a border is better derived from its name
    assert config.get("default_entity_id") == (None if platform == "switch" else f"{platform}.lab1_{key}")
    topic_field = {"button": None, "image": "image_topic"}.get(platform, "state_topic")
    topics = {field: config[field] for field in ("state_topic", "image_topic") if field in config}
    assert topics == ({topic_field: f"lab1/{key}"} if topic_field else {})
    assert config["availability"][0] == {"topic": "lab1/availability"}
    assert config["availability_mode"] == "all"


def test_every_part_of_the_lab_has_its_entity():
    kinds = {key_from_topic(topic): topic.split("/")[1] for topic in describe_entities(LAB)}
    buttons = [key for key, kind in kinds.items() if kind == "button"]
    assert sorted(buttons) == sorted([*COMMANDS, "confirm"])
    assert len({config_of(key)["icon"] for key in buttons}) == len(buttons)
    assert [key for key, kind in kinds.items() if kind == "switch"] == ["border_b1", entity_key("border", "ü/#+")]
    assert [kinds[key] for key in ("camera_red", "camera_green", "robot", "robot_ada")] == ["binary_sensor"] * 4
    assert_fields(kinds, state="sensor", question="sensor", stopped="binary_sensor", map="image")


@pytest.mark.parametrize("language", sentences.languages())
def test_names_are_in_the_households_language(language):
    lab = LabEntities("lab1", language, ("red",), ("",), {"b1": "border 2"})
    names = {key_from_topic(topic): config["name"] for topic, config in describe_entities(lab).items()}
    assert names["border_b1"] == sentences.border_name("border 2", language)
    assert names["robot"].lower() == sentences.translate("the_robot", {}, language).lower()


@pytest.mark.parametrize("language", sentences.languages())
def test_each_state_is_one_of_the_words_that_the_hub_expects(language):
    description = describe_entities(LabEntities("lab1", language))["homeassistant/sensor/lab1/state/config"]
    states = [entities.state_payload(InteractionState(name=name), language) for name in STATES]
    shown = [jinja2.Template(description["value_template"]).render(value_json=state) for state in states]
    assert shown == description["options"]
    assert len(set(shown)) == len(STATES)


def test_resume_names_the_stop_that_its_button_shows():
    config = config_of("resume")
    request = request_of_press(config, {"stop_number": "12ab", "stopped": True})
    assert_fields(request, command="resume", seen_stop="12ab", age=1.0)
    # before any stop was shown: the manager then refuses, as for everybody
    assert request_of_press(config, {}).seen_stop == request_of_press(config, {"stop_number": None}).seen_stop == ""
    assert config["json_attributes_topic"] == "lab1/stopped"


def test_only_stop_is_always_available():
    assert len(config_of("stop")["availability"]) == 1
    assert config_of("save")["availability"][1]["value_template"] == "{{ value_json.save }}"
    assert config_of("border_b1")["availability"][1]["value_template"] == "{{ value_json.integrator }}"


def test_yes_answers_the_question_that_is_shown():
    assert request_of_press(config_of("confirm"), {"answer": "yes_save", "stop_number": "12ab"}).command == "yes_save"


def test_presses_name_their_border_and_have_new_ids():
    request = request_of_press(config_of(entity_key("border", "ü/#+")), {}, value="false")
    assert_fields(request, border=entity_key("border", "ü/#+"), enabled=False)
    assert request_of_press(config_of("border_b1"), {}, value="true").enabled
    assert len({request_of_press(config_of("save"), {}).id for _ in range(20)}) > 15


def test_templates_stay_within_the_hubs_limits():
    # the sandbox's range() refuses more than 100,000
    for config in describe_entities(LAB).values():
        template = config.get("command_template", "")
        assert all(int(part.split(")")[0]) <= 100_000 for part in template.split("range(")[1:])


def test_leftover_descriptions_are_those_of_known_kinds():
    fewer = LabEntities("lab1", "en", ("red",), ("ada",), {})
    topics = list(describe_entities(LAB))
    removed = {key_from_topic(topic) for topic in find_stale_topics(fewer, topics)}
    assert removed == {"camera_green", "robot", "border_b1", entity_key("border", "ü/#+")}
    # descriptions of borders and robots are left alone until these are known
    unknown = LabEntities("lab1", "en", ("red",))
    assert {key_from_topic(topic) for topic in find_stale_topics(unknown, topics)} == {"camera_green"}
    assert find_stale_topics(LAB, topics) == []


# ------------------------------------------------------------------ states
def state_after_question(seconds_ago, code="confirm_save"):
    message = InteractionState(last_code=code, last_command="save", last_source="home_assistant", stop_number="1a")
    message.last_values = [KeyValue("command", "save"), KeyValue("answer", "yes save")]
    message.header.stamp = rospy.Time(1000)
    message.last_answered = rospy.Time(1000 - seconds_ago)
    return message


def test_a_question_is_open_until_it_is_too_old():
    question = entities.question_payload(state_after_question(5), "en")
    assert_fields(question, command="save", answer="yes_save", asked="home_assistant", stop_number="1a")
    assert "yes save" in question["question"]
    assert entities.question_payload(state_after_question(31), "en")["question"] == entities.NO_QUESTION
    for code in ("saved", "confirm_map_first"):
        assert entities.question_payload(state_after_question(5, code), "en")["answer"] == ""


def test_a_borders_state_has_its_name_area_and_zone():
    border = VirtualBorder(name="Rug", enabled=True, area_m2=2.345, zone=VirtualBorder.SLOW, reason="disabled")
    state = entities.border_payload(border)
    assert_fields(state, border="Rug", enabled=True, in_force=False, area_m2=2.35, zone="slow", reason="disabled")
    assert entities.border_payload(VirtualBorder(area_m2=float("nan")))["area_m2"] is None


def test_a_robots_problems_are_its_own():
    robots = ConnectedRobot("ada", has_driver=True, is_localized=True), ConnectedRobot("bob")
    lines = derive_capabilities(Connections(robots)).robot_notices
    notices = [Notice("robot_stopped", Severity.WARNING, robot="ada", values={"who": "ada"})]
    notices.append(Notice("camera_silent", Severity.ERROR, camera="red", values={"camera": "red"}))
    assert entities.robot_problems("ada", lines, notices, "en") == [notices[0].sentence()]
    assert len(entities.robot_problems("bob", lines, notices, "en")) == 1  # bob is not connected
    # the only robot has no name, and a notice without a robot is about it
    alone = derive_capabilities(Connections((ConnectedRobot("", has_driver=True, is_localized=True),))).robot_notices
    notices.append(Notice("robot_stopped", Severity.WARNING, values={"who_code": "the_robot"}))
    assert entities.robot_problems("", alone, notices, "en") == [notices[2].sentence()]


def test_long_sentences_fit_the_hubs_states():
    message = InteractionState(last_code="of_a_newer_version", last_message="x" * 900)
    assert len(entities.state_payload(message, "en")["last_answer"]) <= 255


# ------------------------------------------------------------------ the picture
def draw_map(*borders):
    """Draws a room of 10 m x 5 m: a wall at low x, unknown floor in a corner, and y > 2.5 m restricted."""
    cells = np.zeros((100, 200), np.int8)
    cells[:, :10] = 100
    cells[:10, 100:] = -1
    posterior = cells.copy()
    posterior[50:] = 100
    encoded = entities.map_png(GridMap(cells, 0.05), GridMap(posterior, 0.05), borders)
    return cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_COLOR)


def color_at(picture, x, y):
    """Returns (blue, green, red) at a place [m]."""
    return picture[int(500 - y / 5.0 * 500), int(x / 10.0 * 1000)].astype(int)


def test_the_picture_shows_floor_and_walls():
    picture = draw_map()
    assert picture.shape == (500, 1000, 3)
    assert color_at(picture, 0.2, 1.0).max() < 60  # wall
    assert color_at(picture, 5.0, 1.0).min() > 250  # free
    blue, _, red = color_at(picture, 5.0, 4.0)
    assert red > blue + 80  # restricted
    unknown = color_at(picture, 8.0, 0.2)
    assert 150 < unknown.mean() < 250
    assert np.ptp(unknown) < 10


def test_the_picture_shows_enabled_and_disabled_borders():
    line = [Point(0, 2.5, 0), Point(10, 2.5, 0)]
    border = VirtualBorder(kind=VirtualBorder.SEPARATING_CURVE, enabled=True, points=line)
    blue, _, red = color_at(draw_map(border), 5.0, 2.5)
    assert red > blue + 100
    border.enabled = False
    assert np.ptp(color_at(draw_map(border), 5.0, 2.5)) < 10


def test_a_border_that_cannot_be_drawn_is_left_out():
    nowhere = [VirtualBorder(), VirtualBorder(points=[Point(1, float("nan"), 0), Point(2, 2, 0)])]
    assert np.array_equal(draw_map(*nowhere), draw_map())
