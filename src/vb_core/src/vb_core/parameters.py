"""Parameters as frozen dataclasses that are checked once, when they are constructed.

A parameter class lists its values with `param`, which carries unit and limits:

    @dataclass(frozen=True)
    class DriveParams(Parameters):
        speed: float = param(0.2, "m/s", low=0.0, high=1.0)

`DriveParams.from_mapping({"speed": 0.1})` reads values from YAML or the parameter server. An unknown
key, a wrong type or a value out of range raises a `ParameterError` that names the key. A default that is itself
`Parameters` makes a group, as in `{"drive": {"speed": 0.1}}`, whose keys are named "drive/speed".
"""

from __future__ import annotations

import dataclasses
import math
import operator
import re
from typing import Any, List, Mapping, Optional, Sequence, Type, TypeVar

from vb_core.errors import ParameterError

P = TypeVar("P", bound="Parameters")

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")  # the name of a camera, a robot or a computer


def param(
    default: Any,
    unit: str = "",
    low: Optional[float] = None,
    high: Optional[float] = None,
    above: Optional[float] = None,
    choices: Optional[Sequence[Any]] = None,
    of: Optional[Type[Parameters]] = None,
    doc: str = "",
) -> Any:
    """Makes a dataclass field with a unit and limits.

    Args:
        default: the value unless another one is set; its type is the parameter's type.
        low, high: the smallest and largest value allowed, both included.
        above: an excluded lower limit.
        choices: the only values allowed.
        of: class of a list's entries, each of which is read like a group.
        doc: explains a parameter that no file in config/ lists. If a file lists it, the comment there explains it;
            `doc` may repeat the comment's beginning for dynamic_reconfigure.
    """
    metadata = dict(default=default, unit=unit, low=low, high=high, above=above, choices=choices, of=of, doc=doc)
    if isinstance(default, (list, dict)):
        return dataclasses.field(default_factory=lambda: default.copy(), metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


@dataclasses.dataclass(frozen=True)
class Parameters:
    """Base of every parameter class. Checks each value against its field's limits."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = _check(field.name, getattr(self, field.name), field.metadata)
            object.__setattr__(self, field.name, value)

    @classmethod
    def from_mapping(cls: Type[P], mapping: Optional[Mapping[str, Any]], where: str = "") -> P:
        """Makes parameters from a mapping. Missing keys keep their defaults.

        Args:
            mapping: for instance a YAML document; None counts as empty.
            where: prefix of the keys in errors, for instance the node's name.

        Raises:
            ParameterError: for an unknown key, a wrong type, a value out of range.
        """
        prefix = f"{where.rstrip('/')}/" if where else ""
        if mapping is None:
            mapping = {}
        if not isinstance(mapping, Mapping):
            raise ParameterError(prefix.rstrip("/") or "parameters", f"expected keys and values, got {mapping!r}")
        names = [field.name for field in dataclasses.fields(cls)]
        for key in mapping:
            if key not in names:
                raise ParameterError(f"{prefix}{key}", f"unknown parameter; known are {', '.join(names)}")
        try:
            return cls(**mapping)
        except ParameterError as error:
            raise ParameterError(f"{prefix}{error.key}", error.message[len(error.key) + 2 :]) from None

    def replace(self: P, **changes: Any) -> P:
        """Returns a copy with some values changed, checked again."""
        return dataclasses.replace(self, **changes)

    def describe(self) -> str:
        """Lists on one line, for a node's log, each value that differs from its default, with its unit."""
        return ", ".join(self._changed())

    def _changed(self) -> List[str]:
        parts: List[str] = []
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, Parameters):
                parts += [f"{field.name}/{part}" for part in value._changed()]
            elif value != field.metadata["default"]:
                parts.append(f"{field.name}={value} {field.metadata['unit']}".rstrip())
        return parts


_EXPECTED = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "text",
    tuple: "a list",
    list: "a list",
    dict: "keys and values",
}
_LIMITS = {"low": ("at least", operator.lt), "high": ("at most", operator.gt), "above": ("above", operator.le)}


def _check(key: str, value: Any, limits: Mapping[str, Any]) -> Any:
    """Checks a value against the limits from `param`. Returns it in the default's type. Raises ParameterError."""
    kind = type(limits["default"])
    entry_class = limits["of"]
    if issubclass(kind, Parameters):
        return value if isinstance(value, kind) else kind.from_mapping(value, key)
    accepted: Any = {float: (int, float), tuple: (list, tuple)}.get(kind, kind)
    is_stray_bool = isinstance(value, bool) and kind is not bool
    has_type = isinstance(value, accepted) and not is_stray_bool
    if kind in _EXPECTED and not (has_type and value == value):  # nan does not equal itself
        unit = f" in {limits['unit']}" if limits["unit"] else ""
        raise ParameterError(key, f"expected {_EXPECTED[kind]}{unit}, got {value!r}")
    if kind in (float, tuple):
        value = kind(value)
    if entry_class is not None:
        return kind(
            item if isinstance(item, entry_class) else entry_class.from_mapping(item, f"{key}[{index}]")
            for index, item in enumerate(value)
        )
    if any(limits[name] is not None for name in _LIMITS):
        elements = value if isinstance(value, (list, tuple)) else [value]
        for element in elements:
            _check_limits(key, element, limits)
    if limits["choices"] is not None and value not in limits["choices"]:
        choices = ", ".join(map(str, limits["choices"]))
        raise ParameterError(key, f"must be one of {choices}, got {value!r}")
    return value


def _check_limits(key: str, number: Any, limits: Mapping[str, Any]) -> None:
    if isinstance(number, bool) or not isinstance(number, (int, float)) or not math.isfinite(number):
        raise ParameterError(key, f"expected finite numbers, got {number!r}")
    for name, (phrase, violates) in _LIMITS.items():
        limit = limits[name]
        if limit is not None and violates(number, limit):
            expected = f"{phrase} {limit} {limits['unit']}".rstrip()
            raise ParameterError(key, f"must be {expected}, got {number}")
