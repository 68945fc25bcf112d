"""Borders and findings as messages."""
from __future__ import annotations

from typing import Iterable, List, Sequence, Tuple

import rospy
from vb_msgs.msg import Finding as FindingMessage
from vb_msgs.msg import VirtualBorder as BorderMessage

from vb_core.ros import messages
from vb_map_integration.border import VirtualBorder
from vb_map_integration.findings import ERROR, WARNING, Finding, IntegrationError

KINDS = {BorderMessage.DECIDE: None, BorderMessage.POLYGON: True, BorderMessage.SEPARATING_CURVE: False}
_SEVERITIES = {WARNING: FindingMessage.WARNING, ERROR: FindingMessage.ERROR}


def border_from_message(message: BorderMessage) -> VirtualBorder:
    """A message to a border; inverse of `message_from_border`.

    Raises:
        IntegrationError: if it is none.
    """
    if message.kind not in KINDS:
        raise IntegrationError("bad_kind", f"the kind must be one of {sorted(KINDS)}, got {message.kind}")
    return VirtualBorder(
        points=messages.array_from_points(message.points),
        seed=[message.seed.x, message.seed.y],
        # float32 on the wire: 0.2 comes as 0.20000000298
        occupancy=round(message.occupancy, 6),
        closed=KINDS[message.kind],
        id=message.id,
        name=message.name,
        enabled=message.enabled,
        created=message.created.to_sec(),
        modified=message.modified.to_sec(),
        expires=message.expires.to_sec(),
        robots=tuple(message.robots),
    )


def message_from_border(border: VirtualBorder, area_m2: float = 0.0) -> BorderMessage:
    """A border to a message; inverse of `border_from_message`."""
    message = BorderMessage(
        id=border.id,
        name=border.name,
        points=messages.points_from_array(border.points),
        kind=BorderMessage.POLYGON if border.closed else BorderMessage.SEPARATING_CURVE,
        occupancy=border.occupancy,
        enabled=border.enabled,
        created=rospy.Time.from_sec(border.created),
        modified=rospy.Time.from_sec(border.modified),
        expires=rospy.Time.from_sec(border.expires),
        robots=list(border.robots),
        area_m2=area_m2,
    )
    message.seed.x, message.seed.y = (float(value) for value in border.seed)
    return message


def finding_messages(findings: Sequence[Finding]) -> List[FindingMessage]:
    """Findings to messages; inverse of `findings_from_messages`."""
    return [FindingMessage(_SEVERITIES[found.severity], found.code, found.message) for found in findings]


def findings_from_messages(found: Iterable[FindingMessage]) -> Tuple[Finding, ...]:
    """Messages to findings; inverse of `finding_messages`."""
    severities = {value: key for key, value in _SEVERITIES.items()}
    return tuple(Finding(severities.get(one.severity, ERROR), one.code, one.message) for one in found)
