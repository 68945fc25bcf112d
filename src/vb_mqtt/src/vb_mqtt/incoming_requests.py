"""Checks messages that arrive by MQTT: each becomes a request, or a refusal with a code. No ROS, no broker.

A broker may deliver a message twice, retain it for later subscribers, or deliver it long after it was sent. Therefore a
message counts only once, and only if it contains the time at which it was sent. A `stop` is accepted at any age and in
any form, unless it was retained, because an unnecessary stop does no harm. No message raises anything but a `Refusal`.

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
MAX_AGE = 5.0  # [s] of a request; nobody expects an older one to be carried out
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
    """A valid request."""

    id: str  # several requests with the same id are carried out once
    sender_id: str = ""  # the id that the sender gave to the request; the answer repeats it
    command: str = ""  # the command's name, or "" if a border is to be switched on or off
    seen_stop: str = ""  # number of the newest stop that the sender knew of, see vb_msgs/Command
    border: str = ""  # key of the border to switch, see `entities.entity_key`
    enabled: bool = False  # whether to switch the border on
    age: float = 0.0  # [s] time since the request was sent


class Inbox:
    """Accepts each request once. Not thread safe.

    Args:
        started: [s] time of day; requests from before it are refused, since an earlier process may have accepted them.
    """

    def __init__(self, started: float) -> None:
        self._started = started
        self._accepted_ids: Deque[str] = deque(maxlen=256)  # more than the rate lets through within MAX_AGE
        self._limiter = RateLimiter(RATE, BURST)

    def accept_request(self, payload: bytes, retained: bool, now: float) -> Optional[MqttRequest]:
        """Returns the request in a message, or None if the message is empty or the request was accepted before.

        Args:
            retained: whether the broker had retained the message.
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
        if not isinstance(sender_id, str) or not _TEXT.fullmatch(sender_id):
            sender_id = ""
        digest = f"mqtt:{hashlib.blake2b(payload, digest_size=12).hexdigest()}"
        if fields.get("command") == STOP:
            # a sender may give all of its stops the same id, so only a stop with the same time too is a repeated one
            is_dated = {"id", "at"} <= set(fields)
            identity = digest if is_dated else f"mqtt:{uuid.uuid4().hex}"
            return MqttRequest(identity, sender_id, STOP)
        try:
            # messages without an id are distinguished by their contents, which include the time
            identity = f"mqtt:{sender_id}" if sender_id else digest
            request = self._check(fields, identity, sender_id, now)
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
        """Returns the request in a message's fields. Raises a Refusal if a field's name or value is wrong."""
        allowed = next((kind for kind in _KINDS if kind & set(fields)), frozenset({"command"}))
        unknown = sorted(set(fields) - allowed - {"at", "id"})
        if unknown:
            raise _bad_field(unknown[0])
        _read_text(fields, "id")
        command = _read_text(fields, "command")
        border = _read_text(fields, "border")
        age = self._measure_age(fields.get("at"), now, command or border)
        if "border" in allowed:
            if not border or not isinstance(fields.get("enabled"), bool):
                raise _bad_field("enabled" if border else "border")
            return MqttRequest(identity, sender_id, border=border, enabled=fields["enabled"], age=age)
        if command not in ACCEPTED_COMMANDS:
            raise _bad_field("command")
        return MqttRequest(identity, sender_id, command, _read_text(fields, "seen_stop"), age=age)

    def _measure_age(self, sent_at: Any, now: float, request_name: str) -> float:
        is_number = isinstance(sent_at, (int, float)) and not isinstance(sent_at, bool)
        if not is_number or not 0.0 <= sent_at < 1e12:
            raise Refusal("mqtt_undated")
        if sent_at > now + MAX_AGE:
            raise Refusal("mqtt_clock", seconds=round(sent_at - now))
        if sent_at < max(now - MAX_AGE, self._started):
            raise Refusal("expired", command=words_of_name(request_name))
        return max(0.0, now - sent_at)


def _bad_field(field: str) -> Refusal:
    return Refusal("mqtt_bad_message", field=ascii(field[:40]))


def _read(payload: bytes) -> Dict[str, Any]:
    """Reads JSON, or the word "stop"."""
    if len(payload) > MAX_BYTES:
        raise _bad_field("length")
    try:
        text = payload.decode("utf-8")
        fields = {"command": STOP} if text.strip().lower() == STOP else json.loads(text)
    except (ValueError, RecursionError):
        raise _bad_field("JSON") from None
    if not isinstance(fields, dict):
        raise _bad_field("JSON")
    return fields


def _read_text(fields: Dict[str, Any], field: str) -> str:
    value = fields.get(field, "")
    if not isinstance(value, str) or not _TEXT.fullmatch(value):
        raise _bad_field(field)
    return value
