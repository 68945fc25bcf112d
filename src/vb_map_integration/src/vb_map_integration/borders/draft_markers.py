"""How an unfinished border looks in RViz."""

from __future__ import annotations

from typing import Sequence, Tuple

import numpy as np
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker

from vb_core.ros import messages

DRAFT, STORED, SLEEPING, SEED, REFUSED = (
    ColorRGBA(1.0, 0.75, 0.0, 1.0),
    ColorRGBA(0.85, 0.1, 0.1, 1.0),
    ColorRGBA(0.5, 0.5, 0.5, 1.0),
    ColorRGBA(0.1, 0.4, 1.0, 1.0),
    ColorRGBA(1.0, 0.2, 0.2, 1.0),
)
LINE_WIDTH, VERTEX_DIAMETER, TEXT_HEIGHT = 0.03, 0.10, 0.15  # [m]


def _marker(kind: int, color: ColorRGBA, scale: Tuple[float, float, float]) -> Marker:
    marker = Marker(type=kind, action=Marker.ADD, color=color)
    marker.pose.orientation.w = 1.0
    marker.scale.x, marker.scale.y, marker.scale.z = scale
    return marker


def chain_marker(points: np.ndarray, closed: bool, color: ColorRGBA) -> Marker:
    """Draws a chain (N, 2) [m] as a line."""
    marker = _marker(Marker.LINE_STRIP, color, (LINE_WIDTH, 0.0, 0.0))
    line = np.concatenate([points, points[:1]]) if closed else points
    marker.points = messages.points_from_array(line)
    return marker


def ball_marker(color: ColorRGBA, size: float = VERTEX_DIAMETER) -> Marker:
    """Draws a ball at the origin of whatever it belongs to."""
    return _marker(Marker.SPHERE, color, (size, size, size))


def text_marker(text: str, point: Sequence[float], color: ColorRGBA) -> Marker:
    """Writes a sentence beside a point [m]."""
    marker = _marker(Marker.TEXT_VIEW_FACING, color, (0.0, 0.0, TEXT_HEIGHT))
    marker.text = text
    marker.pose.position.x, marker.pose.position.y, marker.pose.position.z = float(point[0]), float(point[1]) + 0.2, 0.1
    return marker
