"""Describes a lab to Home Assistant: its entities, and the topics of their states. No ROS, no broker.

Each entity has a retained message with its description (Home Assistant's MQTT discovery), and another one, with the
same key, with its state. An empty message removes an entity that no longer exists, even one from an earlier process.

A button sends the time, and the number of the newest stop in its own attributes, so that `resume` releases only the
stop that was on the screen.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from typing import Any, Dict, Iterable, List, Mapping, Optional, Tuple

from vb_core import sentences
from vb_core.sentences import border_name, translate
from vb_core.vocabulary import COMMANDS, STATES, STOP

PREFIX = "homeassistant"  # topic below which Home Assistant searches for descriptions
ONLINE, OFFLINE = "online", "offline"
MANAGER, INTEGRATOR, MONITOR, CONFIRM = "manager", "integrator", "monitor", "confirm"  # in `health`, beside commands
COMMAND, ANSWER, NOTICE = "command", "answer", "notice"  # topics of messages that are not states
ANSWERS = ("done", "asked", "refused")  # outcomes of a command
NOTICES = ("info", "warning", "error")
_KEY = re.compile(r"[A-Za-z0-9_-]{0,48}")
_DATED = '"at": {{ now().timestamp() }}, "id": "{{ now().timestamp() }}-{{ range(100000) | random }}"'
_SEEN = "{{ this.attributes.stop_number | default('', true) }}"
_ANSWER = "{{ this.attributes.answer | default('', true) }}"


@dataclass(frozen=True)
class Lab:
    """The lab to be described.

    Attributes:
        device: its id, the prefix of its topics.
        language: the language of all names.
        cameras, robots: their names; None if not known yet.
        borders: their names by id; None if not known yet.
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
        """Returns the topic filter for the descriptions of this lab's entities."""
        return f"{PREFIX}/+/{self.device}/+/config"


def key_of(kind: str, name: str) -> str:
    """Returns the key of a border, camera or robot: safe in a topic, and different for different names."""
    if not _KEY.fullmatch(name):
        name = hashlib.blake2b(name.encode("utf-8"), digest_size=8).hexdigest()
    return f"{kind}_{name}" if name else kind


def describe(lab: Lab) -> Dict[str, Dict[str, Any]]:
    """Returns the description of each entity, by its topic."""

    def title(code: str, **values: str) -> str:
        name = translate(code, values, lab.language)
        return name[:1].upper() + name[1:]

    def button(needs: str, shows: str, command: str) -> Dict[str, Any]:
        template = f'{{"command": "{command}", "seen_stop": "{_SEEN}", {_DATED}}}'
        return {"needs": needs, "shows": shows, "command_template": template}

    entities: Dict[Tuple[str, str], Dict[str, Any]] = {
        ("sensor", "state"): {
            "needs": MANAGER,
            "value_template": "{{ value_json.state }}",
            "device_class": "enum",
            "options": list(STATES),
        },
        ("sensor", "question"): {"needs": MANAGER, "value_template": "{{ value_json.question }}"},
        ("binary_sensor", "stopped"): {"needs": MANAGER, "value_template": _flag("stopped")},
        ("sensor", "notices"): {"value_template": "{{ value_json.count }}", "entity_category": "diagnostic"},
        ("event", NOTICE): {"event_types": list(NOTICES)},
        ("event", ANSWER): {"event_types": list(ANSWERS)},
        ("image", "map"): {"needs": INTEGRATOR, "content_type": "image/png"},
        ("button", CONFIRM): button(CONFIRM, "question", _ANSWER),
    }
    for (_, key), config in entities.items():
        config["name"] = title("mqtt_" + key)
    for command in COMMANDS:
        needs = "" if command == STOP else command
        entities["button", command] = {"name": title("command_" + command), **button(needs, "stopped", command)}
    problem = {"device_class": "problem", "entity_category": "diagnostic", "value_template": _flag("problem")}
    for camera in lab.cameras:
        entities["binary_sensor", key_of("camera", camera)] = {"name": title("mqtt_camera", camera=camera), **problem}
    for robot in lab.robots or ():
        name = title("mqtt_robot", who=sentences.robot_value(robot))
        entities["binary_sensor", key_of("robot", robot)] = {"name": name, "needs": MONITOR, **problem}
    for identity, name in (lab.borders or {}).items():
        key = key_of("border", identity)
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


def leftovers(lab: Lab, described: Iterable[str]) -> List[str]:
    """Returns the topics of descriptions on the broker whose entities no longer belong to the lab.

    Entities of a kind that is not known yet are kept.
    """
    current = describe(lab)
    unknown = [kind for kind, names in (("border", lab.borders), ("robot", lab.robots)) if names is None]
    return sorted(topic for topic in described if topic not in current and key_in(topic).split("_")[0] not in unknown)


def key_in(topic: str) -> str:
    """Returns the key of the entity that a topic describes."""
    return topic.split("/")[3]


def _complete(lab: Lab, platform: str, key: str, needs: str = "", shows: str = "", **config: Any) -> Dict[str, Any]:
    """Adds the fields that all entities have.

    Args:
        needs: field of `health` that must be online for the entity; "" for none.
        shows: key of the state that provides its attributes; "" for its own.
    """
    config["unique_id"] = f"{lab.device}_{key}"
    if platform != "switch":  # Home Assistant derives a border's id from its name
        config["default_entity_id"] = f"{platform}.{lab.device}_{key}"
    if platform != "button":
        config["image_topic" if platform == "image" else "state_topic"] = lab.topic(key)
    if platform not in ("event", "image"):
        config["json_attributes_topic"] = lab.topic(shows or key)
    if "command_template" in config:
        config["command_topic"], config["qos"] = lab.topic(COMMAND), 1
    config["availability"] = [{"topic": lab.topic("availability")}]
    if needs:
        config["availability"].append({"topic": lab.topic("health"), "value_template": f"{{{{ value_json.{needs} }}}}"})
    config["availability_mode"] = "all"
    config["device"] = {
        "identifiers": [lab.device],
        "name": lab.device.replace("_", " ").capitalize(),
        "model": "Virtual borders",
    }
    config["origin"] = {"name": "vb_mqtt"}
    return config


def _flag(field: str) -> str:
    return f"{{{{ 'ON' if value_json.{field} else 'OFF' }}}}"
