"""Checks messages that arrive by MQTT: each becomes a request, or a refusal with a code. No ROS, no broker.

A broker may deliver a message twice, retain it for later subscribers, or deliver it long after it was written. So a
message counts once, and only if it carries the time at which it was given. Only `stop` is accepted at any age and in
any form, unless it was retained: a stop too many does no harm. Whatever arrives, only a `Refusal` is raised.

>>> inbox = Inbox(started=90.0)
>>> inbox.accept_request(b'{"command": "save", "at": 99.5}', retained=False, now=100.0).age
0.5
>>> inbox.accept_request(b'{"command": "save", "at": 99.5}', retained=False, now=101.0)    # delivered twice
>>> inbox.accept_request(b"stop", retained=False, now=102.0).command
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
from vb_core.interaction_tables import COMMANDS, STOP, YES_ANSWERS
from vb_core.rate_limiter import RateLimiter
from vb_core.sentences import words_of_name

ACCEPTED_COMMANDS = (*COMMANDS, *YES_ANSWERS)
MAX_AGE = 5.0  # [s] nobody expects an older request to be carried out
MAX_BYTES = 2048
RATE = 2.0  # [1/s] requests let through on average
BURST = 10.0  # requests let through at once
_TEXT = re.compile(r"[0-9A-Za-z_.-]{0,64}")
_KINDS = (frozenset({"command", "seen_stop"}), frozenset({"border", "enabled"}))  # fields, besides `at` and `id`


class Refusal(CodedError):
    """The refusal of a message."""

    sender_id = ""  # the sender's own id for the message, if it has one


@dataclass(frozen=True)
class MqttRequest:
    """A valid request.

    Attributes:
        id: requests with the same one are carried out once.
        sender_id: the sender's own id for it, which the answer repeats.
        command: the command's name; "": a border is to be switched.
        seen_stop: number of the newest stop that the sender was shown, see vb_msgs/Command.
        border: key of the border to switch, see `entities.entity_key`.
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
        started: [s] time of day; an earlier process may have carried out requests given before.
    """

    def __init__(self, started: float) -> None:
        self._started = started
        self._accepted_ids: Deque[str] = deque(maxlen=256)  # more than the rate lets through within MAX_AGE
        self._limiter = RateLimiter(RATE, BURST)

    def accept_request(self, payload: bytes, retained: bool, now: float) -> Optional[MqttRequest]:
        """Returns the request in a message, or None if it was accepted before, or the message is empty.

        Args:
            retained: whether the broker had retained it.
            now: [s] time of day.

        Raises:
            Refusal: "mqtt_retained", "mqtt_bad_message", "mqtt_undated", "expired", "mqtt_clock", "mqtt_too_fast".
        """
        if not payload:
            return None  # an empty message deletes a retained one
        if retained:
            raise Refusal("mqtt_retained")
        fields = _read(payload)
        sender_id = fields.get("id", "")
        sender_id = sender_id if isinstance(sender_id, str) and _TEXT.fullmatch(sender_id) else ""
        digest = f"mqtt:{hashlib.blake2b(payload, digest_size=12).hexdigest()}"
        if fields.get("command") == STOP:
            # a sender must be obeyed even if it gives each of its stops the same id
            return MqttRequest(digest if {"id", "at"} <= set(fields) else f"mqtt:{uuid.uuid4().hex}", sender_id, STOP)
        try:
            # messages without an id are told apart by their contents, which include the time
            request = self._check(fields, f"mqtt:{sender_id}" if sender_id else digest, sender_id, now)
            if request.id in self._accepted_ids:
                return None
            if not self._limiter.allows("", now):
                raise Refusal("mqtt_too_fast")
        except Refusal as refusal:
            refusal.sender_id = sender_id
            raise
        self._accepted_ids.append(request.id)
        return request

    def _check(self, fields: Dict[str, Any], identity: str, sender_id: str, now: float) -> MqttRequest:
        """Returns the request in a message's fields, whose names and values must be right, or raises a Refusal."""
        allowed = next((kind for kind in _KINDS if kind & set(fields)), frozenset({"command"}))
        unknown = sorted(set(fields) - allowed - {"at", "id"})
        if unknown:
            raise _bad(unknown[0])
        _text(fields, "id")
        command, border = _text(fields, "command"), _text(fields, "border")
        age = self._age(fields.get("at"), now, command or border)
        if "border" in allowed:
            if not border or not isinstance(fields.get("enabled"), bool):
                raise _bad("enabled" if border else "border")
            return MqttRequest(identity, sender_id, border=border, enabled=fields["enabled"], age=age)
        if command not in ACCEPTED_COMMANDS:
            raise _bad("command")
        return MqttRequest(identity, sender_id, command, _text(fields, "seen_stop"), age=age)

    def _age(self, sent_at: Any, now: float, request_name: str) -> float:
        if isinstance(sent_at, bool) or not isinstance(sent_at, (int, float)) or not 0.0 <= sent_at < 1e12:
            raise Refusal("mqtt_undated")
        if sent_at > now + MAX_AGE:
            raise Refusal("mqtt_clock", seconds=round(sent_at - now))
        if sent_at < max(now - MAX_AGE, self._started):
            raise Refusal("expired", command=words_of_name(request_name))
        return max(0.0, now - sent_at)


def _bad(field: str) -> Refusal:
    return Refusal("mqtt_bad_message", field=ascii(field[:40]))


def _read(payload: bytes) -> Dict[str, Any]:
    """Reads JSON, or the word "stop"."""
    if len(payload) > MAX_BYTES:
        raise _bad("length")
    try:
        text = payload.decode("utf-8")
        fields = {"command": STOP} if text.strip().lower() == STOP else json.loads(text)
    except (ValueError, RecursionError):
        raise _bad("JSON") from None
    if not isinstance(fields, dict):
        raise _bad("JSON")
    return fields


def _text(fields: Dict[str, Any], field: str) -> str:
    value = fields.get(field, "")
    if not isinstance(value, str) or not _TEXT.fullmatch(value):
        raise _bad(field)
    return value
