"""Converts messages to sections of the page's view, and the page's drafts to messages. Needs the messages, but no node.

Lengths are in metres, but chains and points are compact lists of whole centimetres, [x0, y0, x1, y1, ...].
"""

from __future__ import annotations

import base64
from typing import Any, Dict, Iterable, List, Mapping, Optional

import numpy as np
from geometry_msgs.msg import Point
from vb_msgs.msg import BorderIssue, BorderPreview, BorderProgress, DetectorStatus, DriverState, InteractionState
from vb_msgs.msg import LaserSpot, RobotStatusArray, VirtualBorder, VirtualBorderArray

from vb_core import sentences
from vb_core.notices import Notice
from vb_core.capabilities import Capabilities, describe_ignored_zone
from vb_core.ros.messages import mapping_from_values
from vb_core.zones import ZONES, zone_by_number
from vb_web import page_images
from vb_web.page_view import json_number

_KINDS = {"polygon": VirtualBorder.POLYGON, "curve": VirtualBorder.SEPARATING_CURVE, "wall": VirtualBorder.VIRTUAL_WALL}
_KIND_NAMES = {number: name for name, number in _KINDS.items()}


def centimeters(points: Iterable[Point]) -> List[int]:
    """Converts points to one list of coordinates in whole centimetres. Leaves out points that are not finite."""
    coordinates = np.array([(point.x, point.y) for point in points], dtype=float).reshape(-1, 2)
    coordinates = coordinates[np.isfinite(coordinates).all(axis=1)].clip(-1e6, 1e6)
    return np.rint(coordinates * 100.0).astype(int).ravel().tolist()


def copy_fields(source: Any, *fields: str) -> Dict[str, Any]:
    """Returns fields of a message or dataclass, unchanged and under the same names."""
    return {field: getattr(source, field) for field in fields}


def coded_sentence(message: Any) -> Dict[str, Any]:
    """Returns the code, the values and the English sentence of a message that has these three fields."""
    return {"code": message.code, "values": mapping_from_values(message.values), "message": message.message}


def issues_section(issues: Iterable[BorderIssue]) -> List[Dict[str, Any]]:
    """Converts the issues that a check reported."""
    return [{"severity": int(issue.severity), **coded_sentence(issue)} for issue in issues]


def state_section(message: InteractionState) -> Dict[str, Any]:
    """Converts the state of the interaction. Times become seconds."""
    seconds_left = 0.0
    if not message.ends_at.is_zero():
        seconds_left = (message.ends_at - message.header.stamp).to_sec()
    return {
        **copy_fields(message, "name", "available_commands", "stopped", "stopped_by", "stop_number"),
        "ends_in_s": max(0, int(seconds_left)),
        "confirm": message.confirm_save,
        "outcome": message.last_outcome,
        "last": {
            "command": message.last_command,
            "source": message.last_source,
            "ok": message.last_success,
            "code": message.last_code,
            "values": mapping_from_values(message.last_values),
            "message": message.last_message,
            "at": json_number(message.last_answered.to_sec(), 2),
        },
    }


def progress_section(message: BorderProgress) -> Dict[str, Any]:
    """Converts what has been drawn so far."""
    return {
        "spots": message.border_spots,
        "points": centimeters(message.points),
        "chain": centimeters(message.chain),
        "left_out": centimeters(message.left_out),
        "seed": centimeters([message.seed]) if message.has_seed else [],
        **copy_fields(message, "closed", "cameras_seeing_spot"),
        **coded_sentence(message),
    }


def region_uri(region: Any) -> str:
    """Draws a region (OccupancyGrid) as an image in a data URI. Returns "" if its cells are invalid."""
    info = region.info
    cells = np.asarray(region.data, np.int8)
    if not cells.size or cells.size != info.width * info.height:
        return ""
    cells = cells.reshape(info.height, info.width)
    image = page_images.draw_region(cells, info.resolution, page_images.PREVIEW_COLOR, page_images.PREVIEW_SIDE)
    return "data:image/png;base64," + base64.b64encode(image.encoded).decode("ascii")


def preview_section(message: BorderPreview) -> Dict[str, Any]:
    """Converts a preview, which describes what saving now would do."""
    if not message.available:
        return {"available": False}
    return {
        "available": True,
        "ok": message.success,
        "area": json_number(message.area_m2, 2),
        "parts": message.free_parts,
        "issues": issues_section(message.issues),
        "region": region_uri(message.region),
        **coded_sentence(message),
    }


def border_section(border: VirtualBorder, capabilities: Optional[Capabilities] = None) -> Dict[str, Any]:
    """Converts one border. If `capabilities` are known, its entry `unkept` says which robots ignore the border."""
    zone = zone_by_number(border.zone).name
    unkept = None
    if capabilities is not None and border.in_force:
        unkept = describe_ignored_zone(capabilities, zone, border.robots)
    return {
        **copy_fields(border, "id", "name", "enabled", "in_force", "reason", "robots"),
        "points": centimeters(border.points),
        "kind": _KIND_NAMES.get(border.kind, "curve"),
        "seed": centimeters([border.seed]),
        "zone": zone,
        "max_speed": json_number(border.max_speed, 2),
        "area": json_number(border.area_m2, 2),
        "before": centimeters(border.before),
        "after": centimeters(border.after),
        "unkept": {"code": unkept[0], "values": unkept[1]} if unkept else None,
    }


def borders_section(message: VirtualBorderArray, capabilities: Optional[Capabilities] = None) -> Dict[str, Any]:
    """Converts all borders. `capabilities` are those of the connected robots, if they are known."""
    return {
        **copy_fields(message, "revision", "map_id", "map_name", "available_commands"),
        "unconfirmed": message.needs_confirmation,
        "list": [border_section(border, capabilities) for border in message.borders],
        **coded_sentence(message),
    }


def capabilities_section(
    capabilities: Capabilities, message: RobotStatusArray, more_commands: Iterable[str] = ()
) -> Dict[str, Any]:
    """Converts the capabilities of the lab, and the notices about its robots. Offers `more_commands` too."""
    notices = [
        {"robot": notice.robot, "severity": int(notice.severity), "code": notice.code, "values": dict(notice.values)}
        for notice in capabilities.robot_notices
    ]
    return {
        **copy_fields(capabilities, "state", "zones", "sendable_robots"),
        "interaction": message.interaction,
        "commands": [*capabilities.commands, *more_commands],
        "robots": [robot.robot for robot in message.robots],
        "lines": notices,
    }


def goals_section(message: RobotStatusArray) -> Dict[str, Any]:
    """Converts the goal and the path of each robot that has a goal, by robot."""
    return {
        robot.robot: {"goal": centimeters([robot.goal]), "path": centimeters(robot.path)}
        for robot in message.robots
        if robot.has_goal
    }


def spot_entry(message: LaserSpot) -> Optional[List[Any]]:
    """Converts a spot to [x, y, track], x and y in cm. Returns None if it is not finite."""
    position = centimeters([message.position])
    return [*position, int(message.track)] if position else None


def detector_entry(message: DetectorStatus) -> Dict[str, Any]:
    """Converts a detector's status to the entry of its camera."""
    return {
        "name": message.camera,
        "hz": json_number(message.rate_hz, 0),
        "ms": json_number(message.latency_ms, 0),
        "spots": int(message.spots),
    }


def driver_entry(message: DriverState) -> Dict[str, Any]:
    """Converts the state of a robot's driver: which program drives the robot, and why it drives or stands still."""
    code = "robot_stopped_inside_border" if message.code == "inside_border" else f"robot_{message.code}"
    values = {**sentences.robot_values(message.robot), "others_code": "page_other_program"}
    return {"source": message.source, "code": code, "values": values, "message": message.message}


def notices_section(notices: Iterable[Notice]) -> List[Dict[str, Any]]:
    """Converts the notices that are now in effect."""
    return [
        {
            **copy_fields(notice, "code", "message", "robot", "camera"),
            "severity": int(notice.severity),
            "values": dict(notice.values),
            "border": notice.border_id,
        }
        for notice in notices
    ]


def apply_draft(draft: Mapping[str, Any], border: VirtualBorder) -> VirtualBorder:
    """Puts a draft that `action_parser` has checked into a border's message. The message's other fields are unchanged."""
    border.name = draft["name"]
    border.enabled = draft["enabled"]
    border.robots = list(draft["robots"])
    border.points = [Point(x, y, 0.0) for x, y in draft["points"]]
    border.kind = _KINDS[draft["kind"]]
    border.seed = Point(*draft["seed"], 0.0)
    zone = ZONES[draft["zone"]]
    if border.zone != zone.number or not border.occupancy:
        border.occupancy = zone.occupancy
    border.zone = zone.number
    border.max_speed = draft["max_speed"] if zone.limits_speed else 0.0
    return border
