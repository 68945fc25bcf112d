"""Checks messages that arrive by MQTT: each becomes a request, or a refusal with a code. No ROS, no broker.

A broker may deliver a message twice, retain it for later subscribers, or deliver it late. So a message is accepted only
once, and only if it contains the time at which it was given. Only `stop` is accepted at any age and in any form, unless
it was retained, because an unnecessary stop does no harm. A malformed message raises nothing but a `Refusal`.

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
from vb_core.rate_limiter import Limiter
from vb_core.sentences import spelled_out
from vb_core.vocabulary import ANSWERS, COMMANDS, STOP

KNOWN = (*COMMANDS, *ANSWERS)
MAX_AGE = 5.0  # [s] nobody expects an older request to be carried out
MAX_BYTES = 2048
RATE, BURST = 2.0, 10.0  # accepted requests: [1/s] on average, and at once
_TEXT = re.compile(r"[0-9A-Za-z_.-]{0,64}")
_KINDS = (frozenset({"command", "seen_stop"}), frozenset({"border", "enabled"}))  # fields, beside `at` and `id`


class Refusal(CodedError):
    """The refusal of a message.

    Attributes:
        sender_id: the sender's own id for the message, or "".
    """

    sender_id = ""


@dataclass(frozen=True)
class Request:
    """A valid request.

    Attributes:
        id: the request's id; requests with the same id are carried out once.
        sender_id: the sender's own id for it, which the answer repeats.
        command: its name; "" if a border should be switched.
        seen_stop: number of the newest stop that the sender was shown, see vb_msgs/Command.
        border: key of the border to switch, see `entities.key_of`.
        enabled: whether to switch it on.
        age: [s] since it was given.
    """

    id: str
    sender_id: str = ""
    command: str = ""
    seen_stop: str = ""
    border: str = ""
    enabled: bool = False
    age: float = 0.0


class Inbox:
    """Accepts each request once. Not thread safe.

    Args:
        started: [s] time of day when this process started; an earlier one may have carried out older requests.
    """

    def __init__(self, started: float) -> None:
        self._started = started
        self._accepted_ids: Deque[str] = deque(maxlen=256)  # more than the rate allows within MAX_AGE
        self._limiter = Limiter(RATE, BURST)

    def take(self, payload: bytes, retained: bool, now: float) -> Optional[Request]:
        """Returns the request in a message; None if it was accepted before, or the message is empty.

        Args:
            retained: whether the broker had retained it.
            now: [s] time of day.

        Raises:
            Refusal: "mqtt_retained", "mqtt_bad_message", "mqtt_undated", "expired", "mqtt_clock", "mqtt_too_fast".
        """
        if not payload:
            return None  # this is how a retained message is deleted
        if retained:
            raise Refusal("mqtt_retained")
        fields = _read(payload)
        sender_id = fields.get("id", "")
        sender_id = sender_id if isinstance(sender_id, str) and _TEXT.fullmatch(sender_id) else ""
        digest = f"mqtt:{hashlib.blake2b(payload, digest_size=12).hexdigest()}"
        if fields.get("command") == STOP:
            # stops are obeyed even if their sender always uses the same id
            return Request(digest if {"id", "at"} <= set(fields) else f"mqtt:{uuid.uuid4().hex}", sender_id, STOP)
        try:
            # messages without an id are distinguished by their contents, which include the time
            request = self._make_request(fields, f"mqtt:{sender_id}" if sender_id else digest, sender_id, now)
            if request.id in self._accepted_ids:
                return None
            if not self._limiter.allows("", now):
                raise Refusal("mqtt_too_fast")
        except Refusal as refusal:
            refusal.sender_id = sender_id
            raise
        self._accepted_ids.append(request.id)
        return request

    def _make_request(self, fields: Dict[str, Any], identity: str, sender_id: str, now: float) -> Request:
        allowed = next((kind for kind in _KINDS if kind & set(fields)), frozenset({"command"}))
        unknown = sorted(set(fields) - allowed - {"at", "id"})
        if unknown:
            raise _bad_message(unknown[0])
        _read_text(fields, "id")
        command, border = _read_text(fields, "command"), _read_text(fields, "border")
        age = self._age(fields.get("at"), now, command or border)
        if "border" in allowed:
            if not border or not isinstance(fields.get("enabled"), bool):
                raise _bad_message("enabled" if border else "border")
            return Request(identity, sender_id, border=border, enabled=fields["enabled"], age=age)
        if command not in KNOWN:
            raise _bad_message("command")
        return Request(identity, sender_id, command, _read_text(fields, "seen_stop"), age=age)

    def _age(self, given: Any, now: float, what: str) -> float:
        if isinstance(given, bool) or not isinstance(given, (int, float)) or not 0.0 <= given < 1e12:
            raise Refusal("mqtt_undated")
        if given > now + MAX_AGE:
            raise Refusal("mqtt_clock", seconds=round(given - now))
        if given < max(now - MAX_AGE, self._started):
            raise Refusal("expired", command=spelled_out(what))
        return max(0.0, now - given)


def _bad_message(field: str) -> Refusal:
    return Refusal("mqtt_bad_message", field=ascii(field[:40]))


def _read(payload: bytes) -> Dict[str, Any]:
    """Reads JSON, or the word "stop"."""
    if len(payload) > MAX_BYTES:
        raise _bad_message("length")
    try:
        text = payload.decode("utf-8")
        fields = {"command": STOP} if text.strip().lower() == STOP else json.loads(text)
    except (ValueError, RecursionError):
        raise _bad_message("JSON") from None
    if not isinstance(fields, dict):
        raise _bad_message("JSON")
    return fields


def _read_text(fields: Dict[str, Any], field: str) -> str:
    value = fields.get(field, "")
    if not isinstance(value, str) or not _TEXT.fullmatch(value):
        raise _bad_message(field)
    return value
