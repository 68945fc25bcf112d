"""Borders as plain values, which JSON can hold."""

from __future__ import annotations

from typing import Any, Dict

from vb_core.errors import CodedError
from vb_map_integration.border import VirtualBorder


def border_to_mapping(border: VirtualBorder) -> Dict[str, Any]:
    """Writes a border as plain values; inverse of `border_from_mapping`."""
    return {
        "id": border.id,
        "name": border.name,
        "kind": border.kind,
        "points": border.points.tolist(),
        "seed": border.seed.tolist(),
        "occupancy": border.occupancy,
        "enabled": border.enabled,
        "created": border.created,
        "modified": border.modified,
        "robots": list(border.robots),
        "zone": border.zone.name,
        "max_speed": border.max_speed,
        "schedule": border.schedule,
        "map_id": border.map_id,
    }


def border_from_mapping(values: Any) -> VirtualBorder:
    """Reads a border from plain values; inverse of `border_to_mapping`.

    Raises:
        CodedError: what `VirtualBorder` raises, or "bad_border_file" for missing or unknown keys.
    """
    if not isinstance(values, dict):
        raise CodedError("bad_border_file", reason="$file_value", key="borders", expected="{...}", found=repr(values))
    values = dict(values)
    kind = values.pop("kind", None)
    if kind not in (None, "polygon", "separating_curve", "virtual_wall"):
        raise CodedError(
            "bad_border_file",
            reason="$file_value",
            key="kind",
            expected="polygon | separating_curve | virtual_wall",
            found=repr(kind),
        )
    try:
        if kind == "virtual_wall":
            values.setdefault("seed", (0.0, 0.0))
            return VirtualBorder(wall=True, **values)
        return VirtualBorder(closed=None if kind is None else kind == "polygon", **values)
    except TypeError as error:
        raise CodedError("bad_border_file", reason="$file_keys", detail=str(error)) from None
