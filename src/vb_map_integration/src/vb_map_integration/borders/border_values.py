"""Borders as plain values, which JSON can hold."""

from __future__ import annotations

import dataclasses
from typing import Any, Dict

from vb_core.errors import CodedError
from vb_map_integration.border import VirtualBorder


def border_to_mapping(border: VirtualBorder) -> Dict[str, Any]:
    """Writes a border as plain values; inverse of `border_from_mapping`."""
    plain = {one.name: getattr(border, one.name) for one in dataclasses.fields(border)}
    del plain["closed"], plain["wall"]
    points, seed = border.points.tolist(), border.seed.tolist()
    return {**plain, "kind": border.kind, "points": points, "seed": seed, "zone": border.zone.name}


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
