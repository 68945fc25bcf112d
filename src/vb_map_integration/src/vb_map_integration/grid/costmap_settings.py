"""Tells from move_base's parameters how its costmaps treat soft values."""

from __future__ import annotations

from typing import Any, List, Mapping, Optional, Tuple

from vb_map_integration.borders.issues import WARNING, Issue, make_issue


def check_soft_value(value: int, costmaps: Mapping[str, Any]) -> Optional[Issue]:
    """Warns if a costmap takes a soft occupancy for free space; None if all is well or nothing is known.

    Args:
        value: 0 .. 100; 0 and 100 are not soft.
        costmaps: the parameters of each costmap by its name, as from `rosparam get`; None: it has none.
    """
    if value in (0, 100):
        return None
    blind = [name for name, settings in costmaps.items() if isinstance(settings, Mapping) and _is_trinary(settings)]
    if not blind:
        return None
    return make_issue(WARNING, "soft_border_ignored", costmaps=", ".join(blind))


def _is_trinary(settings: Mapping[str, Any]) -> bool:
    return any(_get(settings, layer).get("trinary_costmap", True) for layer in _static_layers(settings))


def _static_layers(settings: Mapping[str, Any]) -> Tuple[str, ...]:
    plugins: List[Any] = settings.get("plugins") or []
    named = tuple(
        str(plugin.get("name", "static_layer"))
        for plugin in plugins
        if isinstance(plugin, Mapping) and str(plugin.get("type", "")).endswith("StaticLayer")
    )
    return named or ("static_layer",)


def _get(settings: Mapping[str, Any], layer: str) -> Mapping[str, Any]:
    found = settings.get(layer)
    return found if isinstance(found, Mapping) else {}
