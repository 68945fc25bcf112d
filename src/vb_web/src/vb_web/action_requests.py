"""Parses browsers' requests: a closed list of actions, each with a closed list of fields.

Nothing enters but through this parser. What leaves it are checked values in the project's own types; a field that is
missing, unknown, of another type, too long, not finite or off the map makes the whole request fail.
"""

from __future__ import annotations

import json
import re
import time
import unicodedata
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, Mapping, Optional, Sequence, Tuple

from vb_core.errors import CodedError
from vb_core.vocabulary import COMMANDS
from vb_core.zones import ZONES

KINDS = ("polygon", "curve", "wall")
MAX_POINTS = 500  # a finger's line is thinned out to fewer than 100
MAX_ROBOTS = 50
MAX_BYTES = 64 * 1024
MARGIN = 1.0  # [m] by which a line may leave the map

# categories of control characters, lone surrogates, and marks that change a line's direction
_HIDDEN = frozenset(("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"))
_ID = re.compile(r"[0-9A-Za-z_.:-]{1,64}")
_ROBOT = re.compile(r"[A-Za-z][A-Za-z0-9_/]{0,63}")  # a namespace

Bounds = Tuple[Sequence[float], Sequence[float]]  # [m] the map's lowest and highest x and y
Check = Callable[[Any, str, Optional[Bounds]], Any]  # returns the value converted, or raises with the field's name


@dataclass(frozen=True)
class Request:
    """A checked request.

    Attributes:
        id: chosen by the browser; a request repeated with the same id is carried out once.
        action: one of ACTIONS.
        values: by field, checked.
        arrived: [s] time of arrival on the monotonic clock, which tells how long it has waited.
    """

    id: str
    action: str
    values: Mapping[str, Any]
    arrived: float = field(default_factory=time.monotonic)


def _fail(field: str) -> CodedError:
    return CodedError("page_bad_request", field=field)


def _valid(is_valid: Callable[[Any], Any], convert: Callable[[Any], Any] = lambda value: value) -> Check:
    """Makes a check from a test of values, and a conversion of those that pass."""

    def check(value: Any, field: str, _bounds: Optional[Bounds] = None) -> Any:
        if not is_valid(value):
            raise _fail(field)
        return convert(value)

    return check


def _text(limit: int, empty: bool = True) -> Check:
    def is_line(value: Any) -> bool:
        shown = isinstance(value, str) and len(value) <= limit and _HIDDEN.isdisjoint(map(unicodedata.category, value))
        return shown and bool(empty or value.strip())

    return _valid(is_line, lambda value: " ".join(value.split()))


def _choice(*allowed: str) -> Check:
    return _valid(lambda value: isinstance(value, str) and value in allowed)


def _matching(pattern: "re.Pattern[str]", empty: bool = False) -> Check:
    return _valid(lambda value: isinstance(value, str) and (pattern.fullmatch(value) or (empty and not value)))


def _number(low: float, high: float) -> Check:
    # a bool, which to Python is an int, is refused; NaN and infinity fail the comparison
    return _valid(lambda value: type(value) in (int, float) and low <= value <= high, float)


def _list_of(check: Check, low: int, high: int) -> Check:
    def check_all(value: Any, field: str, bounds: Optional[Bounds] = None) -> Tuple[Any, ...]:
        if not isinstance(value, list) or not low <= len(value) <= high:
            raise _fail(field)
        return tuple(check(one, field, bounds) for one in value)

    return check_all


def _point(value: Any, field: str, bounds: Optional[Bounds]) -> Tuple[float, float]:
    if bounds is None:
        raise CodedError("page_no_map")
    if not isinstance(value, list) or len(value) != 2:
        raise _fail(field)
    x, y = (_number(low - MARGIN, high + MARGIN)(number, field, None) for number, low, high in zip(value, *bounds))
    return x, y


def _draft(value: Any, field: str, bounds: Optional[Bounds]) -> Dict[str, Any]:
    if not isinstance(value, dict) or set(value) != set(_BORDER):
        raise _fail(field)
    checked = {name: check(value[name], name, bounds) for name, check in _BORDER.items()}
    if ZONES[checked["zone"]].limits_speed and checked["max_speed"] < 0.02:
        raise _fail("max_speed")  # slower amounts to standing still, for which there is keep_out
    return checked


_FLAG = _valid(lambda value: isinstance(value, bool))
_BORDER: Dict[str, Check] = {  # a draft, as drawn or edited on the page
    "name": _text(60),
    "kind": _choice(*KINDS),
    "zone": _choice(*ZONES),
    "max_speed": _number(0.0, 2.0),  # [m/s] if the zone limits the speed
    "enabled": _FLAG,
    "robots": _list_of(_matching(_ROBOT), 0, MAX_ROBOTS),  # to which it applies; none: all
    "points": _list_of(_point, 2, MAX_POINTS),  # [m] map frame
    "seed": _point,  # [m] on the side to be restricted; ignored for a wall
}
_TARGET = {"border": _matching(_ID), "revision": _valid(lambda value: type(value) is int and 0 <= value < 2**53)}

ACTIONS: Dict[str, Dict[str, Check]] = {
    "command": {"command": _choice(*COMMANDS), "seen_stop": _text(64), "age": _number(0.0, 60.0)},
    "preview": {"draft": _draft, "border": _matching(_ID, empty=True)},
    "add": {"draft": _draft},
    "update": {"draft": _draft, **_TARGET},
    "rename": {"name": _text(60, empty=False), **_TARGET},
    "enable": {"enabled": _FLAG, **_TARGET},
    "remove": dict(_TARGET),
    "send": {"robot": _matching(_ROBOT, empty=True), "goal": _point},
    "halt": {"robot": _matching(_ROBOT, empty=True)},
    "confirm_map": {"same": _FLAG, "map_id": _text(100)},
    "invite": {},
}


def read(text: Any) -> Tuple[str, Dict[str, Any]]:
    """Reads a browser's message, JSON of at most MAX_BYTES; returns the request's id, and the rest, not yet checked.

    Raises:
        CodedError: "page_bad_request" with the field's name.
    """
    if not isinstance(text, str) or len(text.encode("utf-8", "replace")) > MAX_BYTES:
        raise _fail("message")
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        raise _fail("message") from None
    if not isinstance(found, dict):
        raise _fail("message")
    return _matching(_ID)(found.pop("id", None), "id", None), found


def check(request_id: str, found: Dict[str, Any], bounds: Optional[Bounds]) -> Request:
    """Checks a message that was read; `bounds`: of the map, None until there is one.

    Raises:
        CodedError: "page_bad_request" with the field's name, "page_no_map".
    """
    action = found.pop("do", None)
    if not isinstance(action, str) or action not in ACTIONS:
        raise _fail("do")
    fields = ACTIONS[action]
    if set(found) != set(fields):
        raise _fail(sorted(set(found) ^ set(fields))[0][:40])
    values = {field: check_value(found[field], field, bounds) for field, check_value in fields.items()}
    return Request(request_id, action, values)
