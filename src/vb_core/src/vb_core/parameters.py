"""Parameters as frozen dataclasses that are checked once, when they are made.

A parameter class lists its values with `param`, which carries unit and limits:

    @dataclass(frozen=True)
    class DriveParams(Parameters):
        speed: float = param(0.2, "m/s", low=0.0, high=1.0)

`DriveParams.from_mapping({"speed": 0.1})` reads values from YAML or the parameter server. An unknown
key, a wrong type or a value out of range is a `ParameterError` that names the key.
"""

from __future__ import annotations

import dataclasses
import operator
from typing import Any, Mapping, Optional, Sequence, Type, TypeVar

from vb_core.errors import ParameterError

P = TypeVar("P", bound="Parameters")


def param(
    default: Any,
    unit: str = "",
    low: Optional[float] = None,
    high: Optional[float] = None,
    above: Optional[float] = None,
    choices: Optional[Sequence[Any]] = None,
    doc: str = "",
) -> Any:
    """Makes a dataclass field with a unit and limits.

    Args:
        default: its value unless set; its type is the parameter's type.
        low, high: the smallest and largest value allowed, both included.
        above: a limit that the value must exceed.
        choices: the only values allowed.
        doc: the meaning of a parameter that no file in config/ lists. Of one that is listed, the comment there is the
            meaning; `doc` may repeat how it begins, where dynamic_reconfigure shows it.
    """
    metadata = dict(default=default, unit=unit, low=low, high=high, above=above, choices=choices, doc=doc)
    if isinstance(default, (list, dict)):
        return dataclasses.field(default_factory=lambda: default.copy(), metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


@dataclasses.dataclass(frozen=True)
class Parameters:
    """Base of every parameter class; checks each value against its field's limits."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = _check(field.name, getattr(self, field.name), field.metadata)
            object.__setattr__(self, field.name, value)

    @classmethod
    def from_mapping(
        cls: Type[P], mapping: Optional[Mapping[str, Any]], where: str = "", others: Sequence[str] = ()
    ) -> P:
        """Makes parameters from a mapping; missing keys keep their defaults.

        Args:
            mapping: for instance a YAML document; None is an empty one.
            where: put before the key in errors, for instance the node's name.
            others: keys that are valid but not of this class; they are skipped.

        Raises:
            ParameterError: for an unknown key, a wrong type, a value out of range.
        """
        prefix = f"{where.rstrip('/')}/" if where else ""
        if mapping is None:
            mapping = {}
        if not isinstance(mapping, Mapping):
            raise ParameterError(prefix.rstrip("/") or "parameters", f"expected keys and values, got {mapping!r}")
        known = [field.name for field in dataclasses.fields(cls)]
        own = {key: value for key, value in mapping.items() if key not in others}
        for key in own:
            if key not in known:
                raise ParameterError(f"{prefix}{key}", f"unknown parameter; known are {', '.join([*known, *others])}")
        try:
            return cls(**own)
        except ParameterError as error:
            raise ParameterError(f"{prefix}{error.key}", error.message.split(": ", 1)[1]) from None

    def replace(self: P, **changes: Any) -> P:
        """Returns the same parameters with some of them changed, checked again."""
        return dataclasses.replace(self, **changes)

    def describe(self) -> str:
        """Lists each value that is not the default, with its unit, on one line for a node's log; "" if there is none."""
        parts = []
        for field in dataclasses.fields(self):
            value, unit = getattr(self, field.name), field.metadata["unit"]
            if value != field.metadata["default"]:
                parts.append(f"{field.name}={value}{' ' + unit if unit else ''}")
        return ", ".join(parts)


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
    """Checks a value against what `param` keeps of it; returns it in the default's type.

    Raises:
        ParameterError: names the key and says what was expected.
    """
    unit, kind = limits["unit"], type(limits["default"])
    accepted: Any = {float: (int, float), tuple: (list, tuple)}.get(kind, kind)
    right = isinstance(value, accepted) and (kind is bool or not isinstance(value, bool))
    if kind in _EXPECTED and not (right and value == value):  # nan is no number
        raise ParameterError(key, f"expected {_EXPECTED[kind]}{f' in {unit}' if unit else ''}, got {value!r}")
    if kind in (float, tuple):
        value = kind(value)
    # a list's limits apply to each of its numbers
    for number in value if isinstance(value, (list, tuple)) else [value]:
        if not isinstance(number, (int, float)) or isinstance(number, bool):
            continue
        for name, (words, breaks) in _LIMITS.items():
            limit = limits[name]
            if limit is not None and breaks(number, limit):
                raise ParameterError(key, f"must be {words} {limit} {unit}".rstrip() + f", got {number}")
    if limits["choices"] is not None and value not in limits["choices"]:
        raise ParameterError(key, f"must be one of {', '.join(map(str, limits['choices']))}, got {value!r}")
    return value
