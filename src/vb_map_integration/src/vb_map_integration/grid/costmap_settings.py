"""Tells from move_base's parameters how its costmaps treat soft values."""

from __future__ import annotations

from typing import Any, Mapping


def is_trinary(costmap: Any) -> bool:
    """Returns whether a costmap takes a soft occupancy for free space, by its parameters as from `rosparam get`."""
    if not isinstance(costmap, Mapping):
        return False  # there is none
    named = [
        str(plugin.get("name", "static_layer"))
        for plugin in costmap.get("plugins") or []
        if isinstance(plugin, Mapping) and str(plugin.get("type", "")).endswith("StaticLayer")
    ]
    layers = [costmap.get(name) for name in named or ["static_layer"]]
    return any(layer.get("trinary_costmap", True) if isinstance(layer, Mapping) else True for layer in layers)
