"""Changes parameters while a node runs, with dynamic_reconfigure (rqt_reconfigure, dynparam).

The parameter class is the only source of names, limits and units. The description that dynamic_reconfigure needs is
generated from its fields instead of a .cfg file.
"""

from __future__ import annotations

import dataclasses
import types
from typing import Any, Callable, Dict, Generic, List, Sequence, TypeVar

import rospy
from dynamic_reconfigure.server import Server

from vb_core.errors import CodedError
from vb_core.parameters import Parameters

P = TypeVar("P", bound=Parameters)

# each type's name, smallest and largest value
_KINDS = {bool: ("bool", False, True), int: ("int", -(2**31), 2**31 - 1), float: ("double", -1e9, 1e9)}


def reconfigure_description(params: Parameters, fixed: Sequence[str] = ()) -> Any:
    """Describes a parameter class's numbers and booleans as a compiled .cfg file does.

    Args:
        params: the parameters whose current values become the defaults.
        fixed: names of fields that cannot be changed while the node runs.
    """
    entries: List[Dict[str, Any]] = []
    for field in dataclasses.fields(params):
        value = getattr(params, field.name)
        value_type = type(value)
        if value_type not in _KINDS or field.name in fixed:
            continue
        metadata = field.metadata
        minimum = metadata["low"] if metadata["low"] is not None else metadata["above"]
        kind, type_minimum, type_maximum = _KINDS[value_type]
        unit = f" [{metadata['unit']}]" if metadata["unit"] else ""
        entry = {
            "name": field.name,
            "type": kind,
            "default": value,
            "min": value_type(type_minimum if minimum is None else minimum),
            "max": value_type(type_maximum if metadata["high"] is None else metadata["high"]),
            "level": 1,
            "description": f"{metadata['doc'] or field.name.replace('_', ' ')}{unit}",
            "edit_method": "",
        }
        entries.append(entry)
    group = {"name": "Default", "type": "", "id": 0, "parent": 0, "state": True, "cstate": "true", "groups": []}
    group["parameters"] = entries
    columns = {"defaults": "default", "min": "min", "max": "max", "level": "level", "type": "type"}
    by_name = {column: {entry["name"]: entry[key] for entry in entries} for column, key in columns.items()}
    return types.SimpleNamespace(config_description=group, all_level=1, **by_name)


class ReconfigureServer(Generic[P]):
    """Serves the numbers and booleans of a parameter class for reconfiguration.

    dynamic_reconfigure clamps single values to their limits. If the class rejects a combination, for instance a
    smallest size above the largest one, the old values stay and are sent back, and one warning says why.

    Services:
        <namespace>/set_parameters (dynamic_reconfigure/Reconfigure)
    Published topics:
        <namespace>/parameter_descriptions, <namespace>/parameter_updates (latched)

    Args:
        params: the initial values.
        namespace: where `vb_core.ros.parameters.read` read them, for instance "~detector".
        apply: applies the new parameters, in a service's thread; rejects them by raising a CodedError.
        fixed: names of fields that cannot be changed while the node runs.
    """

    def __init__(self, params: P, namespace: str, apply: Callable[[P], None], fixed: Sequence[str] = ()) -> None:
        self._params = params
        self._apply = apply
        self._where = rospy.resolve_name(namespace)
        description = reconfigure_description(params, fixed)
        # the server does not convert values from the parameter server: a 3 instead of 3.0 would change the type
        for name, value in description.defaults.items():
            rospy.set_param(f"{namespace}/{name}", value)
        self._server = Server(description, self._change, namespace)

    def _change(self, config: Any, _level: int) -> Any:
        names = {field.name for field in dataclasses.fields(self._params)}
        values = {name: value for name, value in config.items() if name in names}
        try:
            changed = self._params.replace(**values)
            if changed != self._params:
                self._apply(changed)
                rospy.loginfo("%s: %s", self._where, changed.describe() or "all as by default")
            self._params = changed
        except CodedError as error:
            rospy.logwarn("%s: not changed: %s", self._where, error)
            config.update({name: getattr(self._params, name) for name in values})
        return config
