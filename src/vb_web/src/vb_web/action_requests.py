"""Parses what a browser may ask for: a closed list of actions, each with a closed list of fields.

The idea: parsing is the only entry. What leaves this module are checked values in our own types; a field that is
missing, unknown, of another type, too long, not finite or off the map makes the whole request fail.
"""

from __future__ import annotations

import json
import math
import re
import time
import unicodedata
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, Mapping, Optional, Tuple

import numpy as np

from vb_core.errors import CodedError
from vb_core.vocabulary import COMMANDS
from vb_core.zones import ZONES

KINDS = ("polygon", "curve", "wall")
MAX_POINTS = 500  # a finger's line is thinned out to less than 100
MAX_ROBOTS = 50
MAX_BYTES = 64 * 1024
MARGIN = 1.0  # [m] a line may leave the map by this much

_ID = re.compile(r"[0-9A-Za-z_.:-]{1,64}")
_ROBOT = re.compile(r"[A-Za-z][A-Za-z0-9_/]{0,63}")  # a namespace


@dataclass(frozen=True)
class Bounds:
    """[m] where points may be: the map and a margin."""

    low: Tuple[float, float]
    high: Tuple[float, float]


@dataclass(frozen=True)
class Draft:
    """A border as drawn or edited on the page.

    Attributes:
        points: (N, 2) float64 [m], map frame.
        kind: one of KINDS.
        seed: (2,) [m], on the side to be restricted; ignored for a wall.
        zone: the name of one of ZONES; max_speed [m/s] if it limits that.
        robots: names of those that it is for; none: all.
    """

    points: np.ndarray
    kind: str
    seed: np.ndarray
    name: str
    zone: str
    max_speed: float
    enabled: bool
    robots: Tuple[str, ...] = ()


@dataclass(frozen=True)
class Request:
    """A checked request.

    Attributes:
        id: chosen by the browser; a repeated request with the same one is carried out once.
        action: one of ACTIONS.
        values: by field, checked.
        arrived: [s] of the monotonic clock: how long it has waited counts.
    """

    id: str
    action: str
    values: Mapping[str, Any]
    arrived: float = field(default_factory=time.monotonic)


class RequestError(CodedError):
    """A message that is not a valid request.

    Attributes:
        request_id: its id, if it has a usable one: the browser learns which request failed.
    """

    request_id = ""


def _fail(field: str) -> RequestError:
    return RequestError("page_bad_request", field=field)


def _text(limit: int, empty: bool = True) -> Callable[[Any, str], str]:
    def check(value: Any, field: str) -> str:
        if not isinstance(value, str) or len(value) > limit:
            raise _fail(field)
        # no control characters, half surrogate pairs, or marks that turn the direction of a line
        if any(unicodedata.category(letter) in ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp") for letter in value):
            raise _fail(field)
        cleaned = " ".join(value.split())
        if not cleaned and not empty:
            raise _fail(field)
        return cleaned

    return check


def _choice(*allowed: str) -> Callable[[Any, str], str]:
    def check(value: Any, field: str) -> str:
        if not isinstance(value, str) or value not in allowed:
            raise _fail(field)
        return value

    return check


def _matching(pattern: "re.Pattern[str]", empty: bool = False) -> Callable[[Any, str], str]:
    def check(value: Any, field: str) -> str:
        if not isinstance(value, str) or not (pattern.fullmatch(value) or (empty and value == "")):
            raise _fail(field)
        return value

    return check


def _number(low: float, high: float) -> Callable[[Any, str], float]:
    def check(value: Any, field: str) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise _fail(field)
        if not math.isfinite(value) or not low <= value <= high:
            raise _fail(field)
        return float(value)

    return check


def _flag(value: Any, field: str) -> bool:
    if not isinstance(value, bool):
        raise _fail(field)
    return value


def _revision(value: Any, field: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**53:
        raise _fail(field)
    return value


def _robots(value: Any, field: str) -> Tuple[str, ...]:
    if not isinstance(value, list) or len(value) > MAX_ROBOTS:
        raise _fail(field)
    return tuple(_matching(_ROBOT)(name, field) for name in value)


_BORDER = {
    "name": _text(60),
    "kind": _choice(*KINDS),
    "zone": _choice(*ZONES),
    "max_speed": _number(0.0, 2.0),
    "enabled": _flag,
    "robots": _robots,
}
_TARGET = {"border": _matching(_ID), "revision": _revision}

ACTIONS: Dict[str, Dict[str, Optional[Callable[[Any, str], Any]]]] = {
    "command": {"command": _choice(*COMMANDS), "seen_stop": _text(64), "age": _number(0.0, 60.0)},
    "preview": {"draft": None, "border": _matching(_ID, empty=True)},
    "add": {"draft": None},
    "update": {"draft": None, **_TARGET},
    "rename": {"name": _text(60, empty=False), **_TARGET},
    "enable": {"enabled": _flag, **_TARGET},
    "remove": dict(_TARGET),
    "send": {"robot": _matching(_ROBOT, empty=True), "goal": None},
    "halt": {"robot": _matching(_ROBOT, empty=True)},
    "confirm_map": {"same": _flag, "map_id": _text(100)},
    "invite": {},
}


def _point(value: Any, field: str, bounds: Bounds) -> Tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise _fail(field)
    limits = zip(value, bounds.low, bounds.high)
    x, y = (_number(low - MARGIN, high + MARGIN)(number, field) for number, low, high in limits)
    return x, y


def _draft(value: Any, bounds: Optional[Bounds]) -> Draft:
    if bounds is None:
        raise RequestError("page_no_map")
    if not isinstance(value, dict) or set(value) != {*_BORDER, "points", "seed"}:
        raise _fail("draft")
    checked = {field: check(value[field], field) for field, check in _BORDER.items()}
    points = value["points"]
    if not isinstance(points, list) or not 2 <= len(points) <= MAX_POINTS:
        raise _fail("points")
    points = np.array([_point(point, "points", bounds) for point in points])
    if ZONES[checked["zone"]].limits_speed and checked["max_speed"] < 0.02:
        raise _fail("max_speed")  # that slow is not at all: keep_out says so better
    return Draft(points=points, seed=np.array(_point(value["seed"], "seed", bounds)), **checked)


def _goal(value: Any, bounds: Optional[Bounds]) -> Tuple[float, float]:
    if bounds is None:
        raise RequestError("page_no_map")
    return _point(value, "goal", bounds)


_ON_THE_MAP: Dict[str, Callable[[Any, Optional[Bounds]], Any]] = {"draft": _draft, "goal": _goal}


def _refuse_constant(text: str) -> None:
    raise ValueError(text)


def parse(text: Any, bounds: Optional[Bounds]) -> Request:
    """Parses and checks a browser's message.

    Args:
        text: JSON, at most MAX_BYTES.
        bounds: of the map; None if there is none yet.

    Raises:
        RequestError: "page_bad_request" with the field's name, "page_no_map".
    """
    if not isinstance(text, str) or len(text.encode("utf-8", "replace")) > MAX_BYTES:
        raise _fail("message")
    try:
        found = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError):
        raise _fail("message") from None
    if not isinstance(found, dict):
        raise _fail("message")
    request_id = _matching(_ID)(found.pop("id", None), "id")
    try:
        return _request(request_id, found, bounds)
    except RequestError as error:
        error.request_id = request_id
        raise


def _request(request_id: str, found: Dict[str, Any], bounds: Optional[Bounds]) -> Request:
    action = found.pop("do", None)
    if not isinstance(action, str) or action not in ACTIONS:
        raise _fail("do")
    fields = ACTIONS[action]
    if set(found) != set(fields):
        raise _fail(sorted(set(found) ^ set(fields))[0][:40])
    try:
        values = {
            field: _ON_THE_MAP[field](found[field], bounds) if check is None else check(found[field], field)
            for field, check in fields.items()
        }
    except OverflowError:  # a whole number too large for a float
        raise _fail("message") from None
    return Request(request_id, action, values)
