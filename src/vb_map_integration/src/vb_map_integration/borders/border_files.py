"""Borders as plain values, and as YAML."""

from __future__ import annotations

import json
from typing import Any, Dict, List, Sequence, Tuple

import yaml

from vb_core.errors import CodedError
from vb_map_integration.border import VirtualBorder

_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


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
        "expires": border.expires,
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


def borders_to_yaml(borders: Sequence[VirtualBorder]) -> str:
    """Writes the YAML list "borders"; inverse of `borders_from_yaml`."""
    if not borders:
        return "borders: []\n"
    # each border is a line of JSON, which is YAML too, and fifty times as fast
    lines = [f"- {json.dumps(border_to_mapping(border), ensure_ascii=False)}\n" for border in borders]
    return "".join(["borders:\n", *lines])


def borders_from_yaml(text: str) -> Tuple[List[VirtualBorder], Dict[str, Any]]:
    """Reads (borders, other keys) from a YAML document; inverse of `borders_to_yaml`.

    Raises:
        CodedError: "bad_border_file" or what a border raises.
    """
    head, _, lines = text.partition("borders:\n")
    try:
        try:  # as `borders_to_yaml` writes it
            borders = [json.loads(line[2:]) for line in lines.split("\n") if line]
            document = {**(yaml.load(head, Loader=_Loader) or {}), "borders": borders} if borders else None
        except (ValueError, TypeError):
            document = None
        if document is None:
            document = yaml.load(text, Loader=_Loader)
    except yaml.YAMLError as error:
        raise CodedError("bad_border_file", reason="$file_format", format="YAML", detail=str(error)) from None
    if not isinstance(document, dict) or not isinstance(document.get("borders"), list):
        raise CodedError("bad_border_file", reason="$file_value", key="borders", expected="[...]", found="-")
    borders = [border_from_mapping(values) for values in document.pop("borders")]
    return borders, document
