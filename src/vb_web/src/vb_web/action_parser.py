"""Parses browsers' requests: a closed list of actions, each with a closed list of fields.

Every request passes this parser, which returns checked and converted values. A single field that is missing, unknown,
of the wrong type, too long, not finite or outside the map makes the whole request fail.
"""

from __future__ import annotations

import json
import re
import time
import unicodedata
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, Mapping, Optional, Sequence, Tuple

from vb_core.errors import CodedError
from vb_core.interaction_tables import COMMANDS
from vb_core.zones import ZONES

BORDER_KINDS = ("polygon", "curve", "wall")
MAX_POINTS = 500  # a finger's line is thinned out to fewer than 100
MAX_ROBOTS = 50
MAX_BYTES = 64 * 1024
MARGIN = 1.0  # [m] how far outside the map a point may be

# Unicode categories of control characters, lone surrogates, and marks that change the direction of writing
_HIDDEN = frozenset(("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"))
_ID = re.compile(r"[0-9A-Za-z_.:-]{1,64}")
_ROBOT = re.compile(r"[A-Za-z][A-Za-z0-9_/]{0,63}")  # a namespace

Bounds = Tuple[Sequence[float], Sequence[float]]  # [m] the map's lowest and highest x and y
FieldCheck = Callable[[Any, str, Optional[Bounds]], Any]  # converts a valid value, or raises with the field's name


@dataclass(frozen=True)
class ActionRequest:
    """A checked request.

    Attributes:
        id: chosen by the browser; however often a request is repeated with the same id, it is carried out once.
        action: one of ACTIONS.
        values: the checked values by field.
        arrived: [s] time of arrival on the monotonic clock.
    """

    id: str
    action: str
    values: Mapping[str, Any]
    arrived: float = field(default_factory=time.monotonic)


def _bad_field(field: str) -> CodedError:
    return CodedError("page_bad_request", field=field)


def _make_check(is_valid: Callable[[Any], Any], convert: Callable[[Any], Any] = lambda value: value) -> FieldCheck:
    """Makes a check from a predicate, and a conversion of the values that satisfy it."""

    def check(value: Any, field: str, _bounds: Optional[Bounds] = None) -> Any:
        if not is_valid(value):
            raise _bad_field(field)
        return convert(value)

    return check


def _text(limit: int, empty: bool = True) -> FieldCheck:
    def is_line(value: Any) -> bool:
        if not isinstance(value, str) or len(value) > limit:
            return False
        is_visible = _HIDDEN.isdisjoint(map(unicodedata.category, value))
        return is_visible and bool(empty or value.strip())

    return _make_check(is_line, lambda value: " ".join(value.split()))


def _choice(*allowed: str) -> FieldCheck:
    return _make_check(lambda value: isinstance(value, str) and value in allowed)


def _pattern(pattern: "re.Pattern[str]", empty: bool = False) -> FieldCheck:
    allowed = re.compile(f"({pattern.pattern})?") if empty else pattern
    return _make_check(lambda value: isinstance(value, str) and allowed.fullmatch(value))


def _number(low: float, high: float) -> FieldCheck:
    # compares the exact type, because in Python a bool is also an int; NaN and infinity fail the comparison with bounds
    return _make_check(lambda value: type(value) in (int, float) and low <= value <= high, float)


def _list_of(check: FieldCheck, low: int, high: int) -> FieldCheck:
    def check_all(value: Any, field: str, bounds: Optional[Bounds] = None) -> Tuple[Any, ...]:
        if not isinstance(value, list) or not low <= len(value) <= high:
            raise _bad_field(field)
        return tuple(check(entry, field, bounds) for entry in value)

    return check_all


def _check_point(value: Any, field: str, bounds: Optional[Bounds]) -> Tuple[float, float]:
    if bounds is None:
        raise CodedError("page_no_map")
    if not isinstance(value, list) or len(value) != 2:
        raise _bad_field(field)
    (low_x, low_y), (high_x, high_y) = bounds
    x = _number(low_x - MARGIN, high_x + MARGIN)(value[0], field, None)
    y = _number(low_y - MARGIN, high_y + MARGIN)(value[1], field, None)
    return x, y


def _check_draft(value: Any, field: str, bounds: Optional[Bounds]) -> Dict[str, Any]:
    if not isinstance(value, dict) or set(value) != set(_BORDER):
        raise _bad_field(field)
    checked = {name: check(value[name], name, bounds) for name, check in _BORDER.items()}
    if ZONES[checked["zone"]].limits_speed and checked["max_speed"] < 0.02:
        raise _bad_field("max_speed")  # a robot that is slower would stand still, for which there is the zone keep_out
    return checked


_FLAG = _make_check(lambda value: isinstance(value, bool))
_REVISION = _make_check(lambda value: type(value) is int and 0 <= value < 2**53)
_BORDER: Dict[str, FieldCheck] = {  # a draft that was drawn or edited on the page
    "name": _text(60),
    "kind": _choice(*BORDER_KINDS),
    "zone": _choice(*ZONES),
    "max_speed": _number(0.0, 2.0),  # [m/s] if the zone limits the speed
    "enabled": _FLAG,
    "robots": _list_of(_pattern(_ROBOT), 0, MAX_ROBOTS),  # the robots to which the border applies; all if it is empty
    "points": _list_of(_check_point, 2, MAX_POINTS),  # [m] map frame
    "seed": _check_point,  # [m] on the side to be restricted; ignored for a wall
}
_TARGET = {"border": _pattern(_ID), "revision": _REVISION}

ACTIONS: Dict[str, Dict[str, FieldCheck]] = {
    "command": {"command": _choice(*COMMANDS), "seen_stop": _text(64), "age": _number(0.0, 60.0)},
    "preview": {"draft": _check_draft, "border": _pattern(_ID, empty=True)},
    "add": {"draft": _check_draft},
    "update": {"draft": _check_draft, **_TARGET},
    "rename": {"name": _text(60, empty=False), **_TARGET},
    "enable": {"enabled": _FLAG, **_TARGET},
    "remove": dict(_TARGET),
    "send": {"robot": _pattern(_ROBOT, empty=True), "goal": _check_point},
    "halt": {"robot": _pattern(_ROBOT, empty=True)},
    "confirm_map": {"same": _FLAG, "map_id": _text(100)},
    "invite": {},
}


def parse(text: Any) -> Tuple[str, Dict[str, Any]]:
    """Parses a message, JSON of at most MAX_BYTES. Returns the request's id and its unchecked fields.

    Raises CodedError "page_bad_request" with the field's name.
    """
    if not isinstance(text, str) or len(text.encode("utf-8", "replace")) > MAX_BYTES:
        raise _bad_field("message")
    try:
        fields = json.loads(text)
    except (ValueError, RecursionError):
        raise _bad_field("message") from None
    if not isinstance(fields, dict):
        raise _bad_field("message")
    request_id = _pattern(_ID)(fields.pop("id", None), "id", None)
    return request_id, fields


def check(request_id: str, fields: Dict[str, Any], bounds: Optional[Bounds]) -> ActionRequest:
    """Checks the fields that `parse` returned. `bounds` are those of the map, or None as long as there is no map.

    Raises CodedError "page_bad_request" with the field's name, or "page_no_map".
    """
    action = fields.pop("do", None)
    if not isinstance(action, str) or action not in ACTIONS:
        raise _bad_field("do")
    checks = ACTIONS[action]
    wrong_fields = sorted(set(fields) ^ set(checks))
    if wrong_fields:
        raise _bad_field(wrong_fields[0][:40])
    values = {field: check_value(fields[field], field, bounds) for field, check_value in checks.items()}
    return ActionRequest(request_id, action, values)
