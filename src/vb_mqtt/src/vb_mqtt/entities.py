"""Describes a lab to Home Assistant: its entities, and the topics of their states. No ROS, no broker.

One retained message per entity describes it (Home Assistant's MQTT discovery), another with the same key has its state.
An empty message removes an entity that no longer exists, even one that an earlier process left on the broker.

A button sends the time, and the number of the newest stop in its own attributes, so that `resume` releases the stop
that was on the screen, and no later one.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from typing import Any, Dict, Iterable, List, Mapping, Optional, Tuple

from vb_core import sentences
from vb_core.sentences import border_name, translate
from vb_core.vocabulary import COMMANDS, STATES, STOP

PREFIX = "homeassistant"  # Home Assistant looks for descriptions below this topic
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
        device: its id, with which its own topics begin.
        language: the language of all names.
        cameras, robots: their names; None: not known yet.
        borders: their names by id; None: not known yet.
    """

    device: str
    language: str
    cameras: Tuple[str, ...] = ()
    robots: Optional[Tuple[str, ...]] = None
    borders: Optional[Mapping[str, str]] = None

    def topic(self, key: str) -> str:
        """Returns the topic of an entity's state, or of one of the other messages."""
        return f"{self.device}/{key}"

    @property
    def discovery(self) -> str:
        """Returns the filter of all topics that describe entities of this lab."""
        return f"{PREFIX}/+/{self.device}/+/config"


def key_of(kind: str, name: str) -> str:
    """Returns the key of a border, camera or robot: safe in a topic, and different for different names."""
    if not _KEY.fullmatch(name):
        name = hashlib.blake2b(name.encode("utf-8"), digest_size=8).hexdigest()
    return f"{kind}_{name}" if name else kind


def describe(lab: Lab) -> Dict[str, Dict[str, Any]]:
    """Returns the description of each entity, by the topic that it is published on."""

    def word(code: str, **values: str) -> str:
        name = translate(code, values, lab.language)
        return name[:1].upper() + name[1:]

    def press(needs: str, shows: str, command: str) -> Dict[str, Any]:
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
        ("button", CONFIRM): press(CONFIRM, "question", _ANSWER),
    }
    for (_, key), config in entities.items():
        config["name"] = word("mqtt_" + key)
    for command in COMMANDS:
        needs = "" if command == STOP else command
        entities["button", command] = {"name": word("command_" + command), **press(needs, "stopped", command)}
    problem = {"device_class": "problem", "entity_category": "diagnostic", "value_template": _flag("problem")}
    for camera in lab.cameras:
        entities["binary_sensor", key_of("camera", camera)] = {"name": word("mqtt_camera", camera=camera), **problem}
    for robot in lab.robots or ():
        name = word("mqtt_robot", who=sentences.robot_value(robot))
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
    """Returns the topics of those descriptions on the broker that no longer belong to the lab.

    Entities of a kind that is not known yet are left alone.
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
        needs: field of `health` that must be online for it; "": none.
        shows: key of the state that provides its attributes, if not its own.
    """
    config["unique_id"] = f"{lab.device}_{key}"
    if platform != "switch":  # Home Assistant derives a border's from its name
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
