"""Derives what happened to borders by comparing two snapshots of them; no ROS."""

from __future__ import annotations

from typing import Any, List, Mapping, Tuple

ADDED, REMOVED, RENAMED, ENABLED, DISABLED, CHANGED = "added", "removed", "renamed", "enabled", "disabled", "changed"


def border_changes(before: Mapping[str, Any], after: Mapping[str, Any]) -> List[Tuple[str, Any]]:
    """Compares two sets of borders, vb_msgs/VirtualBorder by id; returns at most one change per border, with it."""
    changes = [(REMOVED, border) for key, border in before.items() if key not in after]
    for key, border in after.items():
        old = before.get(key)
        if old is None:
            changes.append((ADDED, border))
        elif old.enabled != border.enabled:
            changes.append((ENABLED if border.enabled else DISABLED, border))
        elif old.name != border.name:
            changes.append((RENAMED, border))
        elif _drawn(old) != _drawn(border):
            changes.append((CHANGED, border))
    return changes


def _drawn(border: Any) -> Tuple:
    """Returns the properties of a border that a person can change, apart from its name and whether it is enabled.

    Points are rounded to 1 cm: on a map that has grown, a border is aligned with its walls again, which moves it less.
    """
    places = [(round(point.x, 2), round(point.y, 2)) for point in [*border.points, border.seed]]
    return places, border.kind, border.zone, border.occupancy, border.max_speed, tuple(border.robots)
