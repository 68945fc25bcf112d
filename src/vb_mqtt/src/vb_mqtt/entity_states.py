"""Converts messages to the states of entities; needs the messages' fields, but no node.

A state holds only what people and automations use, and nothing that changes by itself: each change is an entry in the
hub's history.
"""

from __future__ import annotations

import math
from typing import Any, Dict, Iterable, List, Sequence

import cv2
import numpy as np

from vb_core import sentences
from vb_core.grid_map import UNKNOWN, GridMap
from vb_core.notices import Notice, Severity
from vb_core.ros.messages import array_from_points, mapping_from_values, sentence_in
from vb_core.vocabulary import QUESTIONS
from vb_core.zones import zone_of
from vb_mqtt.entities import ANSWERS, NOTICES

NOBODY_ASKS = "-"
QUESTION_TIME = 30.0  # [s] for which a question can be answered
MAX_SIDE = 1000  # [px] of the map's picture
_TEXT = 250  # characters; Home Assistant accepts 255
_WALL, _FREE, _UNSEEN = (34, 34, 40), (255, 255, 255), (208, 208, 208)
_RESTRICTED, _SOFT = (60, 94, 213), (160, 175, 235)
_LINE, _LINE_OFF = (0, 60, 170), (150, 150, 150)  # bgr


def state_value(message: Any, language: str) -> Dict[str, Any]:
    """Converts vb_msgs/InteractionState to the state and the last answer."""
    return {
        "state": message.name,
        "available_commands": list(message.available_commands),
        "last_command": message.last_command,
        "last_source": message.last_source,
        "last_code": message.last_code,
        "last_answer": sentence_in(message, language, "last_")[:_TEXT],
    }


def stop_value(message: Any) -> Dict[str, Any]:
    """Converts vb_msgs/InteractionState to the stop and its number, which `resume` must name."""
    return {"stopped": bool(message.stopped), "stopped_by": message.stopped_by, "stop_number": message.stop_number}


def question_value(message: Any, language: str) -> Dict[str, Any]:
    """Converts vb_msgs/InteractionState to the open question, who was asked, and the command that answers yes."""
    since = (message.header.stamp - message.last_answered).to_sec()
    asked = message.last_code in QUESTIONS and since <= QUESTION_TIME
    answer = mapping_from_values(message.last_values).get("answer", "") if asked else ""
    return {
        "question": sentence_in(message, language, "last_")[:_TEXT] if asked else NOBODY_ASKS,
        "command": message.last_command if asked else "",
        "asked": message.last_source if asked else "",
        "answer": answer.replace(" ", "_"),
        "stop_number": message.stop_number,
    }


def border_value(border: Any) -> Dict[str, Any]:
    """Converts vb_msgs/VirtualBorder."""
    return {
        "enabled": bool(border.enabled),
        "border": border.name,
        "area_m2": round(float(border.area_m2), 2) if math.isfinite(border.area_m2) else None,
        "in_force": bool(border.in_force),
        "reason": border.reason,
        "zone": zone_of(border.zone).name,
        "robots": list(border.robots),
    }


def robot_problems(name: str, lines: Sequence[Notice], notices: Iterable[Notice], language: str) -> List[str]:
    """Returns sentences on a robot's problems, or that it is not connected."""
    mine = [line for line in lines if line.robot == name]
    bad = [one for one in mine if one.severity >= Severity.WARNING or one.code == "robot_not_connected"]
    # a notice about no robot has the empty name too, which is also that of the only robot
    who = sentences.robot_value(name)
    bad += [one for one in notices if one.severity >= Severity.WARNING and who in (one.robot, one.values.get("who"))]
    return [one.sentence(language) for one in bad]


def notice_value(notice: Notice, language: str) -> Dict[str, Any]:
    """Converts a notice, for the list of notices and as an event."""
    about = {"robot": notice.robot, "border": notice.border_id, "camera": notice.camera}
    return {
        "event_type": NOTICES[notice.severity],
        "code": notice.code,
        "text": notice.sentence(language)[:_TEXT],
        **{field: value for field, value in about.items() if value},
    }


def answer_value(sender_id: str, what: str, success: bool, code: str, text: str) -> Dict[str, Any]:
    """Returns the event that reports the result of a command or a switch."""
    kind = ANSWERS[0] if success else ANSWERS[1] if code in QUESTIONS else ANSWERS[2]
    return {"event_type": kind, "id": sender_id, "command": what, "code": code, "text": text[:_TEXT]}


def draw_map(before: GridMap, after: GridMap, borders: Sequence[Any]) -> bytes:
    """Draws the map with walls, restricted areas and borders as a PNG of at most MAX_SIDE pixels in each direction.

    Args:
        before: the map without borders.
        after: the map with them, of the same geometry.
        borders: vb_msgs/VirtualBorder; disabled ones become grey.
    """
    added = after.data > before.data
    pixels = np.full((*before.shape, 3), _FREE, np.uint8)
    pixels[before.data == UNKNOWN] = _UNSEEN
    pixels[before.data > 50] = _WALL
    pixels[added] = _SOFT
    pixels[added & (after.data == 100)] = _RESTRICTED
    scale = MAX_SIDE / max(before.shape)
    # a large map's walls must not vanish between its pixels
    kind = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_NEAREST
    pixels = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=kind)
    for border in borders:
        line = (before.world_to_grid(array_from_points(border.points)) + 0.5) * scale
        if len(line) and np.isfinite(line).all():
            closed = border.kind == border.POLYGON
            color = _LINE if border.enabled else _LINE_OFF
            cv2.polylines(pixels, [np.rint(line.clip(-1e4, 1e4)).astype(np.int32)], closed, color, 3, cv2.LINE_AA)
    # the map's last row is the picture's first
    return cv2.imencode(".png", pixels[::-1])[1].tobytes()
