"""Converts borders and the issues of their checks to and from messages."""

from __future__ import annotations

from typing import List, Sequence

import numpy as np
import rospy
from vb_msgs.msg import BorderIssue
from vb_msgs.msg import VirtualBorder as BorderMessage

from vb_core.notices import Notice, Severity
from vb_core.ros import messages
from vb_core.zones import ZONES
from vb_map_integration.border import IntegrationError, VirtualBorder

# whether the chain of each kind is closed; None if the gap between its ends decides
KINDS = {
    BorderMessage.AUTO: None,
    BorderMessage.POLYGON: True,
    BorderMessage.SEPARATING_CURVE: False,
    BorderMessage.VIRTUAL_WALL: False,
}
_ZONES = {zone.number: zone for zone in ZONES.values()}
_NOTHING = np.zeros((0, 2))
_SEVERITIES = {Severity.WARNING: BorderIssue.WARNING, Severity.ERROR: BorderIssue.ERROR}


def border_from_message(message: BorderMessage) -> VirtualBorder:
    """Reads a border from a message; inverse of `message_from_border`. Raises IntegrationError if it is invalid."""
    if message.kind not in KINDS:
        raise IntegrationError("bad_kind", kind=message.kind, known=", ".join(map(str, sorted(KINDS))))
    if message.zone not in _ZONES:
        raise IntegrationError("bad_zone", zone=message.zone, known=", ".join(ZONES))
    return VirtualBorder(
        points=messages.array_from_points(message.points),
        seed=[message.seed.x, message.seed.y],
        # float32 in the message: 0.2 arrives as 0.20000000298
        occupancy=round(message.occupancy, 6),
        closed=KINDS[message.kind],
        id=message.id,
        name=message.name,
        enabled=message.enabled,
        created=message.created.to_sec(),
        modified=message.modified.to_sec(),
        robots=tuple(message.robots),
        is_wall=message.kind == BorderMessage.VIRTUAL_WALL,
        zone=_ZONES[message.zone],
        max_speed=round(message.max_speed, 6),
    )


def message_from_border(
    border: VirtualBorder,
    area_m2: float = 0.0,
    in_force: bool = False,
    reason: str = "",
    outlines: Sequence[np.ndarray] = (_NOTHING, _NOTHING),
) -> BorderMessage:
    """Writes a border as a message; inverse of `border_from_message`.

    Args:
        outlines: two outlines (N, 2) [m], before and after the confirmation that the border waits for.
    """
    kind = BorderMessage.POLYGON if border.closed else BorderMessage.SEPARATING_CURVE
    message = BorderMessage(
        id=border.id,
        name=border.name,
        points=messages.points_from_array(border.points),
        kind=BorderMessage.VIRTUAL_WALL if border.is_wall else kind,
        occupancy=border.occupancy,
        enabled=border.enabled,
        created=rospy.Time.from_sec(border.created),
        modified=rospy.Time.from_sec(border.modified),
        robots=list(border.robots),
        area_m2=area_m2,
        zone=border.zone.number,
        max_speed=border.max_speed,
        in_force=in_force,
        reason=reason,
        before=messages.points_from_array(outlines[0]),
        after=messages.points_from_array(outlines[1]),
    )
    message.seed.x, message.seed.y = (float(value) for value in border.seed)
    return message


def messages_from_issues(issues: Sequence[Notice]) -> List[BorderIssue]:
    """Converts the issues that the check of a border reports."""
    result = []
    for issue in issues:
        severity = _SEVERITIES[issue.severity]
        values = messages.values_from_mapping(issue.values)
        result.append(BorderIssue(severity=severity, code=issue.code, message=issue.message, values=values))
    return result
