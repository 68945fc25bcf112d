"""Compares two snapshots of the borders and lists what changed. No ROS."""

from __future__ import annotations

from typing import Any, List, Mapping, Tuple

ADDED, REMOVED, RENAMED, ENABLED, DISABLED, CHANGED = "added", "removed", "renamed", "enabled", "disabled", "changed"


def find_border_changes(old_borders: Mapping[str, Any], new_borders: Mapping[str, Any]) -> List[Tuple[str, Any]]:
    """Compares two sets of borders, vb_msgs/VirtualBorder by id. Returns (change, border), at most one per border."""
    changes = [(REMOVED, border) for key, border in old_borders.items() if key not in new_borders]
    for key, border in new_borders.items():
        previous = old_borders.get(key)
        if previous is None:
            changes.append((ADDED, border))
        elif previous.enabled != border.enabled:
            change = ENABLED if border.enabled else DISABLED
            changes.append((change, border))
        elif previous.name != border.name:
            changes.append((RENAMED, border))
        elif _editable_properties(previous) != _editable_properties(border):
            changes.append((CHANGED, border))
    return changes


def _editable_properties(border: Any) -> Tuple:
    """Returns the properties of a border that a person can change, apart from its name and whether it is enabled.

    Points are rounded to 1 cm, because realigning a border with the walls of a larger map moves it by less than that.
    """
    points = [(round(point.x, 2), round(point.y, 2)) for point in [*border.points, border.seed]]
    return points, border.kind, border.zone, border.occupancy, border.max_speed, tuple(border.robots)
