"""Describes a lab to Home Assistant: its entities, and their states, converted from messages. No node, no broker.

Each entity has a retained message with its description (Home Assistant's MQTT discovery), and another one, with the
same key, with its state. An empty message removes an entity that no longer exists, even one from an earlier process.
A state holds only what people and automations use, and nothing that changes on its own, because each change is an entry
in the hub's history. Home Assistant does not translate the states of MQTT entities, so people read `state_text`.

A button sends the time, and the number of the newest stop in its own attributes, so that `resume` releases only the
stop that was on the screen.
"""

from __future__ import annotations

import hashlib
import math
import re
from dataclasses import dataclass
from typing import Any, Dict, Iterable, List, Mapping, Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core import sentences
from vb_core.grid_map import UNKNOWN, GridMap
from vb_core.interaction_tables import COMMANDS, QUESTIONS, STATES, STOP
from vb_core.notices import Notice, Severity
from vb_core.ros.messages import array_from_points, mapping_from_values, sentence_in
from vb_core.sentences import border_name, translate
from vb_core.zones import zone_by_number

PREFIX = "homeassistant"  # topic below which Home Assistant searches for descriptions
ONLINE, OFFLINE = "online", "offline"
MANAGER, INTEGRATOR, MONITOR, CONFIRM = "manager", "integrator", "monitor", "confirm"  # in `health`, with the commands
COMMAND, ANSWER, NOTICE = "command", "answer", "notice"  # topics of messages that are not states
ANSWERS = ("done", "asked", "refused")  # outcomes of a command
NOTICES = ("info", "warning", "error")
_KEY = re.compile(r"[A-Za-z0-9_-]{0,48}")
# what a button or switch sends besides its command: the time and an id, and the stop or the answer that its state shows
_DATED = '"at": {{ now().timestamp() }}, "id": "{{ now().timestamp() }}-{{ range(100000) | random }}"'
_SEEN_STOP = "{{ this.attributes.stop_number | default('', true) }}"
_ANSWER = "{{ this.attributes.answer | default('', true) }}"
NO_QUESTION = "-"
QUESTION_TIME = 30.0  # [s] for which a question can be answered
MAX_SIDE = 1000  # [px] of the map's picture
_MAX_TEXT = 250  # characters; Home Assistant accepts 255
# colours of the map's picture, bgr
_WALL, _FREE, _UNSEEN = (34, 34, 40), (255, 255, 255), (208, 208, 208)
_RESTRICTED, _SOFT = (60, 94, 213), (160, 175, 235)
_LINE, _LINE_OFF = (0, 60, 170), (150, 150, 150)


@dataclass(frozen=True)
class LabEntities:
    """The lab to be described.

    Attributes:
        device: the device's id, which is the prefix of its topics.
        language: the language of all names.
        cameras, robots: names of the cameras and robots; None if not known yet.
        borders: names of the borders by id; None if not known yet.
    """

    device: str
    language: str
    cameras: Tuple[str, ...] = ()
    robots: Optional[Tuple[str, ...]] = None
    borders: Optional[Mapping[str, str]] = None

    def topic(self, key: str) -> str:
        """Returns the topic of an entity's state or of another message."""
        return f"{self.device}/{key}"

    @property
    def discovery(self) -> str:
        """The topic filter for the descriptions of this lab's entities."""
        return f"{PREFIX}/+/{self.device}/+/config"


def entity_key(kind: str, name: str) -> str:
    """Returns the key of a border, camera or robot: safe in a topic, and different for different names."""
    if not _KEY.fullmatch(name):
        name = hashlib.blake2b(name.encode("utf-8"), digest_size=8).hexdigest()
    return f"{kind}_{name}" if name else kind


def describe_entities(lab: LabEntities) -> Dict[str, Dict[str, Any]]:
    """Returns the description of each entity, by its topic."""

    def title(code: str, **values: str) -> str:
        name = translate(code, values, lab.language)
        return name[:1].upper() + name[1:]

    def button(needs: str, shows: str, command: str, icon: str) -> Dict[str, Any]:
        template = f'{{"command": "{command}", "seen_stop": "{_SEEN_STOP}", {_DATED}}}'
        return {"needs": needs, "shows": shows, "command_template": template, "icon": f"mdi:{icon}"}

    entities: Dict[Tuple[str, str], Dict[str, Any]] = {
        ("sensor", "state"): {
            "needs": MANAGER,
            "value_template": "{{ value_json.state_text }}",
            "device_class": "enum",
            "options": [translate(f"page_state_{state}", {}, lab.language) for state in STATES],
        },
        ("sensor", "question"): {"needs": MANAGER, "value_template": "{{ value_json.question }}"},
        ("binary_sensor", "stopped"): {"needs": MANAGER, "value_template": _flag("stopped")},
        ("sensor", "notices"): {"value_template": "{{ value_json.count }}", "entity_category": "diagnostic"},
        ("event", NOTICE): {"event_types": list(NOTICES)},
        ("event", ANSWER): {"event_types": list(ANSWERS)},
        ("image", "map"): {"needs": INTEGRATOR, "content_type": "image/png"},
        ("button", CONFIRM): button(CONFIRM, "question", _ANSWER, "check"),
    }
    for (_, key), config in entities.items():
        config["name"] = title("mqtt_" + key)
    for name, command in COMMANDS.items():
        needs = "" if name == STOP else name
        entities["button", name] = {"name": title("command_" + name), **button(needs, "stopped", name, command.icon)}
    problem = {"device_class": "problem", "entity_category": "diagnostic", "value_template": _flag("problem")}
    for camera in lab.cameras:
        name = title("mqtt_camera", camera=camera)
        entities["binary_sensor", entity_key("camera", camera)] = {"name": name, **problem}
    for robot in lab.robots or ():
        name = title("mqtt_robot", **sentences.robot_values(robot))
        entities["binary_sensor", entity_key("robot", robot)] = {"name": name, "needs": MONITOR, **problem}
    for identity, name in (lab.borders or {}).items():
        key = entity_key("border", identity)
        entities["switch", key] = {
            "name": border_name(name, lab.language),
            "needs": INTEGRATOR,
            "icon": "mdi:vector-polygon",
            "value_template": _flag("enabled"),
            "payload_on": "true",
            "payload_off": "false",
            "state_on": "ON",
            "state_off": "OFF",
            "command_template": f'{{"border": "{key}", "enabled": {{{{ value }}}}, {_DATED}}}',
        }
    return {
        f"{PREFIX}/{platform}/{lab.device}/{key}/config": _complete(lab, platform, key, **config)
        for (platform, key), config in entities.items()
    }


def find_stale_topics(lab: LabEntities, described: Iterable[str]) -> List[str]:
    """Returns the topics of descriptions on the broker whose entities no longer belong to the lab.

    Entities of a kind that is not known yet are kept.
    """
    current = describe_entities(lab)
    unknown = [kind for kind, names in (("border", lab.borders), ("robot", lab.robots)) if names is None]
    stale = (topic for topic in described if topic not in current)
    return sorted(topic for topic in stale if key_from_topic(topic).split("_")[0] not in unknown)


def key_from_topic(topic: str) -> str:
    """Returns the key of the entity that a topic describes."""
    return topic.split("/")[3]


def _complete(
    lab: LabEntities, platform: str, key: str, needs: str = "", shows: str = "", **config: Any
) -> Dict[str, Any]:
    """Adds the fields that all entities have.

    Args:
        needs: field of `health` that must be online for the entity; "" for none.
        shows: key of the state that provides its attributes; "" for its own.
    """
    config["unique_id"] = f"{lab.device}_{key}"
    if platform != "switch":  # Home Assistant derives a border's id from its name
        config["default_entity_id"] = f"{platform}.{lab.device}_{key}"
    if platform != "button":
        field = "image_topic" if platform == "image" else "state_topic"
        config[field] = lab.topic(key)
    if platform not in ("event", "image"):
        config["json_attributes_topic"] = lab.topic(shows or key)
    if "command_template" in config:
        config.update(command_topic=lab.topic(COMMAND), qos=1)
    config["availability"] = [{"topic": lab.topic("availability")}]
    if needs:
        config["availability"].append({"topic": lab.topic("health"), "value_template": f"{{{{ value_json.{needs} }}}}"})
    config["availability_mode"] = "all"
    name = sentences.words_of_name(lab.device).capitalize()
    config["device"] = {"identifiers": [lab.device], "name": name, "model": "Virtual borders"}
    config["origin"] = {"name": "vb_mqtt"}
    return config


def _flag(field: str) -> str:
    return f"{{{{ 'ON' if value_json.{field} else 'OFF' }}}}"


def state_payload(message: Any, language: str) -> Dict[str, Any]:
    """Converts vb_msgs/InteractionState to the state and the last answer."""
    return {
        "state": message.name,
        "state_text": translate(f"page_state_{message.name}", {}, language),
        "available_commands": list(message.available_commands),
        "last_command": message.last_command,
        "last_source": message.last_source,
        "last_code": message.last_code,
        "last_answer": sentence_in(message, language, "last_")[:_MAX_TEXT],
    }


def stop_payload(message: Any) -> Dict[str, Any]:
    """Converts vb_msgs/InteractionState to the stop and its number, which `resume` must name."""
    return {"stopped": bool(message.stopped), "stopped_by": message.stopped_by, "stop_number": message.stop_number}


def question_payload(message: Any, language: str) -> Dict[str, Any]:
    """Converts vb_msgs/InteractionState to the open question, who was asked, and the command that answers yes."""
    answer_age = (message.header.stamp - message.last_answered).to_sec()
    is_open = message.last_code in QUESTIONS and answer_age <= QUESTION_TIME
    answer = mapping_from_values(message.last_values).get("answer", "") if is_open else ""
    return {
        "question": sentence_in(message, language, "last_")[:_MAX_TEXT] if is_open else NO_QUESTION,
        "command": message.last_command if is_open else "",
        "asked": message.last_source if is_open else "",
        "answer": answer.replace(" ", "_"),
        "stop_number": message.stop_number,
    }


def border_payload(border: Any) -> Dict[str, Any]:
    """Converts vb_msgs/VirtualBorder."""
    return {
        "enabled": bool(border.enabled),
        "border": border.name,
        "area_m2": round(float(border.area_m2), 2) if math.isfinite(border.area_m2) else None,
        "in_force": bool(border.in_force),
        "reason": border.reason,
        "zone": zone_by_number(border.zone).name,
        "robots": list(border.robots),
    }


def robot_problems(name: str, lines: Sequence[Notice], notices: Iterable[Notice], language: str) -> List[str]:
    """Returns sentences on a robot's problems, or that it is not connected."""
    mine = [line for line in lines if line.robot == name]
    problems = [line for line in mine if line.severity >= Severity.WARNING or line.code == "robot_not_connected"]
    # a notice about no robot has the empty name too, which is also that of the only robot
    named = sentences.robot_values(name).items()
    for notice in notices:
        is_about_it = (name and notice.robot == name) or named <= notice.values.items()
        if is_about_it and notice.severity >= Severity.WARNING:
            problems.append(notice)
    return [notice.sentence(language) for notice in problems]


def notice_payload(notice: Notice, language: str) -> Dict[str, Any]:
    """Converts a notice, for the list of notices and as an event."""
    about = {"robot": notice.robot, "border": notice.border_id, "camera": notice.camera}
    return {
        "event_type": NOTICES[notice.severity],
        "code": notice.code,
        "text": notice.sentence(language)[:_MAX_TEXT],
        **{field: value for field, value in about.items() if value},
    }


def answer_payload(sender_id: str, request_name: str, success: bool, code: str, text: str) -> Dict[str, Any]:
    """Returns the event that reports the result of a command or a switch."""
    done, asked, refused = ANSWERS
    unsuccessful = asked if code in QUESTIONS else refused
    outcome = done if success else unsuccessful
    return {"event_type": outcome, "id": sender_id, "command": request_name, "code": code, "text": text[:_MAX_TEXT]}


def map_png(prior: GridMap, posterior: GridMap, borders: Sequence[Any]) -> bytes:
    """Draws the map with walls, restricted areas and borders as a PNG of at most MAX_SIDE pixels in each direction.

    Args:
        prior, posterior: the map without and with borders, of the same geometry.
        borders: vb_msgs/VirtualBorder; disabled ones become grey.
    """
    added = posterior.data > prior.data
    pixels = np.full((*prior.shape, 3), _FREE, np.uint8)
    pixels[prior.data == UNKNOWN] = _UNSEEN
    pixels[prior.data > 50] = _WALL
    pixels[added] = _SOFT
    pixels[added & (posterior.data == 100)] = _RESTRICTED
    scale = MAX_SIDE / max(prior.shape)
    # a large map's walls must not vanish between its pixels
    kind = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_NEAREST
    pixels = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=kind)
    for border in borders:
        line = (prior.world_to_grid(array_from_points(border.points)) + 0.5) * scale
        if len(line) and np.isfinite(line).all():
            closed = border.kind == border.POLYGON
            color = _LINE if border.enabled else _LINE_OFF
            cv2.polylines(pixels, [np.rint(line.clip(-1e4, 1e4)).astype(np.int32)], closed, color, 3, cv2.LINE_AA)
    # the map's last row is the picture's first
    return cv2.imencode(".png", pixels[::-1])[1].tobytes()
