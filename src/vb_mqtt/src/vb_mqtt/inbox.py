"""Judges what arrives by MQTT: a message becomes a request, or a refusal with a code. No ROS, no broker.

The idea: a broker delivers a message twice, keeps one for those who come later, and hands over what was written long ago.
So a message counts only with the time at which its sender gave it, and once. `stop` alone is taken at any age and in any
form: a stop too many does no harm. Nothing but a `Refusal` is raised, whatever arrives.

>>> inbox = Inbox(started=90.0)
>>> inbox.take(b'{"command": "save", "at": 99.5}', retained=False, now=100.0).age
0.5
>>> inbox.take(b'{"command": "save", "at": 99.5}', retained=False, now=101.0)    # delivered twice
>>> inbox.take(b"stop", retained=False, now=102.0).command
'stop'
"""

from __future__ import annotations

import hashlib
import json
import re
import uuid
from collections import deque
from dataclasses import dataclass
from typing import Any, Deque, Dict, Optional

from vb_core.errors import CodedError
from vb_core.limiter import Limiter
from vb_core.sentences import spelled_out
from vb_core.vocabulary import COMMANDS, STOP

# and the answers to the question whether one was meant
KNOWN = (*COMMANDS, *("yes_" + command for command in COMMANDS))
MAX_AGE = 5.0  # [s] a person does not expect what was asked for longer ago than this
MAX_BYTES = 2048
RATE, BURST = 2.0, 10.0  # [1/s] how many requests are let through, and how many at once
_TEXT = re.compile(r"[0-9A-Za-z_.-]{0,64}")
_KINDS = (frozenset({"command", "seen_stop"}), frozenset({"border", "enabled"}))  # fields, beside `at` and `id`


class Refusal(CodedError):
    """A message that is not taken.

    Attributes:
        sender_id: as far as it has one.
    """

    sender_id = ""


@dataclass(frozen=True)
class Request:
    """What somebody asks for.

    Attributes:
        id: a request that comes again with the same one is carried out once.
        sender_id: the sender's own id for it, as the answer names it.
        command: its name; "": a border is to be switched.
        seen_stop: number of the newest stop that the sender was shown, see vb_msgs/Command.
        border: its id; enabled: whether to switch it on.
        age: [s] how long ago it was given.
    """

    id: str
    sender_id: str = ""
    command: str = ""
    seen_stop: str = ""
    border: str = ""
    enabled: bool = False
    age: float = 0.0


class Inbox:
    """Remembers what was taken. Not thread safe.

    Args:
        started: [s] time of day; what was given before may have been carried out by the process before this one.
    """

    def __init__(self, started: float) -> None:
        self._started = started
        self._taken: Deque[str] = deque(maxlen=256)  # ids: more than the rate lets through while a request counts
        self._limiter = Limiter(RATE, BURST)

    def take(self, payload: bytes, retained: bool, now: float) -> Optional[Request]:
        """Returns the request in a message; None if it was taken before, or the message is empty.

        Args:
            retained: whether the broker had kept it.
            now: [s] time of day.

        Raises:
            Refusal: "mqtt_retained", "mqtt_bad_message", "mqtt_undated", "expired", "mqtt_clock", "mqtt_too_fast".
        """
        if not payload:
            return None  # this is how a retained message is deleted
        if retained:
            raise Refusal("mqtt_retained")
        found = _read(payload)
        given = found.get("id", "")
        given = given if isinstance(given, str) and _TEXT.fullmatch(given) else ""
        digest = f"mqtt:{hashlib.blake2b(payload, digest_size=12).hexdigest()}"
        if found.get("command") == STOP:
            # a sender that gives each of its stops the same id must be obeyed all the same
            return Request(digest if {"id", "at"} <= set(found) else f"mqtt:{uuid.uuid4().hex}", given, STOP)
        try:
            # a message without an id is told from the next one alike by its time
            request = self._checked(found, f"mqtt:{given}" if given else digest, given, now)
            if request.id in self._taken:
                return None
            if not self._limiter.allows("", now):
                raise Refusal("mqtt_too_fast")
        except Refusal as refusal:
            refusal.sender_id = given
            raise
        self._taken.append(request.id)
        return request

    def _checked(self, found: Dict[str, Any], identity: str, given: str, now: float) -> Request:
        fields = next((kind for kind in _KINDS if kind & set(found)), frozenset({"command"}))
        unknown = sorted(set(found) - fields - {"at", "id"})
        if unknown:
            raise _bad(unknown[0])
        _text(found, "id")
        command, border = _text(found, "command"), _text(found, "border")
        age = self._age(found.get("at"), now, command or border)
        if "border" in fields:
            if not border or not isinstance(found.get("enabled"), bool):
                raise _bad("enabled" if border else "border")
            return Request(identity, given, border=border, enabled=found["enabled"], age=age)
        if command not in KNOWN:
            raise _bad("command")
        return Request(identity, given, command, _text(found, "seen_stop"), age=age)

    def _age(self, given: Any, now: float, what: str) -> float:
        if isinstance(given, bool) or not isinstance(given, (int, float)) or not 0.0 <= given < 1e12:
            raise Refusal("mqtt_undated")
        if given > now + MAX_AGE:
            raise Refusal("mqtt_clock", seconds=round(given - now))
        if given < max(now - MAX_AGE, self._started):
            raise Refusal("expired", command=spelled_out(what))
        return max(0.0, now - given)


def _bad(field: str) -> Refusal:
    return Refusal("mqtt_bad_message", field=ascii(field[:40]))


def _read(payload: bytes) -> Dict[str, Any]:
    """Reads JSON, or the word "stop"."""
    if len(payload) > MAX_BYTES:
        raise _bad("length")
    try:
        text = payload.decode("utf-8")
        found = {"command": STOP} if text.strip().lower() == STOP else json.loads(text)
    except (ValueError, RecursionError):
        raise _bad("JSON") from None
    if not isinstance(found, dict):
        raise _bad("JSON")
    return found


def _text(found: Dict[str, Any], field: str) -> str:
    value = found.get(field, "")
    if not isinstance(value, str) or not _TEXT.fullmatch(value):
        raise _bad(field)
    return value
