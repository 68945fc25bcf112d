"""MQTT messages are taken once, or refused if old or retained; no message causes any other exception."""

import json

import pytest
from hypothesis import given, settings, strategies as st

from examples import ANYTHING
from vb_testing import assert_fields
from vb_core import sentences
from vb_core.errors import CodedError
from vb_mqtt.incoming_requests import BURST, ACCEPTED_COMMANDS, MAX_AGE, MAX_BYTES, RATE, Inbox, MqttRequest

NOW = 1_700_000_000.0


@pytest.fixture
def inbox():
    return Inbox(started=NOW - 60.0)


def as_json(**fields):
    return json.dumps(fields).encode()


def code_of(inbox, payload, retained=False, now=NOW):
    with pytest.raises(CodedError) as caught:
        inbox.accept_request(payload, retained, now)
    return caught.value.code


def test_a_request_has_id_age_and_seen_stop(inbox):
    request = inbox.accept_request(as_json(command="resume", at=NOW - 1.5, id="a1", seen_stop="12ab"), False, NOW)
    assert request == MqttRequest("mqtt:a1", "a1", "resume", "12ab", age=1.5)
    request = inbox.accept_request(as_json(border="border_b7", enabled=False, at=NOW), False, NOW)
    assert_fields(request, command="", border="border_b7", enabled=False)


def test_a_message_delivered_twice_is_taken_once(inbox):
    for fields in ({"command": "save", "id": "a1"}, {"command": "save"}, {"border": "border_b7", "enabled": False}):
        payload = as_json(at=NOW, **fields)
        assert inbox.accept_request(payload, False, NOW) is not None
        assert inbox.accept_request(payload, False, NOW + 1.0) is None
    # the same command given again
    assert inbox.accept_request(as_json(command="save", at=NOW + 0.5), False, NOW + 1.0) is not None


def test_retained_messages_are_refused_even_a_stop(inbox):
    for payload in (as_json(command="save", at=NOW), as_json(command="stop", at=NOW), b"stop"):
        assert code_of(inbox, payload, retained=True) == "mqtt_retained"
    assert inbox.accept_request(b"", True, NOW) is None


def test_old_future_and_undated_commands_are_refused(inbox):
    assert code_of(inbox, as_json(command="save", at=NOW - MAX_AGE - 0.01)) == "expired"
    assert code_of(inbox, as_json(command="save", at=NOW + MAX_AGE + 0.01)) == "mqtt_clock"
    assert code_of(inbox, as_json(border="border_1", enabled=True, at=NOW - 60.0)) == "expired"
    # small clock differences are tolerated
    assert inbox.accept_request(as_json(command="save", at=NOW + 1.0), False, NOW).age == 0.0
    for stamp in (None, True, "1", -1, float("nan"), float("inf"), 10**400, [NOW]):
        assert code_of(inbox, as_json(command="save", at=stamp)) == "mqtt_undated"
    assert code_of(inbox, as_json(command="save")) == "mqtt_undated"
    assert code_of(inbox, b"save") == "mqtt_bad_message"


def test_commands_from_before_the_start_are_refused():
    inbox = Inbox(started=NOW)
    assert code_of(inbox, as_json(command="save", at=NOW - 0.1), now=NOW + 1.0) == "expired"
    assert inbox.accept_request(as_json(command="save", at=NOW + 0.1), False, NOW + 1.0) is not None


def test_every_stop_is_taken_in_any_form_at_any_age(inbox):
    for payload in (b"stop", b" STOP\n", as_json(command="stop"), as_json(command="stop", at=1.0, id="x", more=[1])):
        assert inbox.accept_request(payload, False, NOW).command == "stop"
    for _ in range(1000):
        assert inbox.accept_request(b"stop", False, NOW) is not None
    # a sender that always uses the same id: its second stop must not be taken for the first
    payload = as_json(command="stop", id="kitchen")
    assert inbox.accept_request(payload, False, NOW).id != inbox.accept_request(payload, False, NOW).id
    # but one press that arrives twice is one stop
    payload = as_json(command="stop", id="a1", at=NOW)
    assert inbox.accept_request(payload, False, NOW).id == inbox.accept_request(payload, False, NOW).id


def test_too_many_commands_at_once_are_refused(inbox):
    accepted = 0
    for number in range(100):
        try:
            accepted += inbox.accept_request(as_json(command="save", at=NOW, id=str(number)), False, NOW) is not None
        except CodedError as error:
            assert error.code == "mqtt_too_fast"
    assert accepted == BURST
    later = NOW + 3.0 / RATE
    assert [inbox.accept_request(as_json(command="save", at=later, id=f"b{k}"), False, later) for k in range(3)]
    assert code_of(inbox, as_json(command="save", at=later, id="b3"), now=later) == "mqtt_too_fast"


@pytest.mark.parametrize(
    "message",
    [
        {"command": "launch", "at": NOW},
        {"command": "", "at": NOW},
        {"command": ["save"], "at": NOW},
        {"command": "save", "at": NOW, "source": "voice"},
        {"command": "save", "at": NOW, "id": 5},
        {"command": "save", "at": NOW, "id": "a b"},
        {"command": "resume", "at": NOW, "seen_stop": 7},
        {"command": "save", "border": "border_1", "enabled": True, "at": NOW},
        {"border": "border_1", "enabled": "on", "at": NOW},
        {"border": "", "enabled": True, "at": NOW},
        {"at": NOW},
        *(b"\xff\xfe", b"[" * 2000, b"{" * 2000, b'"', b"5", b"null", b"a" * (MAX_BYTES + 1)),
    ],
)
def test_malformed_messages_are_refused(inbox, message):
    assert code_of(inbox, message if isinstance(message, bytes) else as_json(**message)) == "mqtt_bad_message"


keys = st.sampled_from(["command", "border", "enabled", "at", "id", "seen_stop"]) | st.text()
fields = st.dictionaries(keys, st.sampled_from([*ACCEPTED_COMMANDS, NOW, True]) | ANYTHING)
messages = fields.map(lambda content: json.dumps(content).encode())


@settings(max_examples=400, deadline=None)
@given(st.lists(st.tuples(st.binary() | messages, st.booleans()), max_size=5))
def test_every_message_is_taken_or_refused_with_a_sentence(arriving):
    inbox = Inbox(started=NOW - 60.0)
    for payload, retained in arriving:
        try:
            request = inbox.accept_request(payload, retained, NOW)
        except CodedError as error:
            assert error.code in sentences.catalog()
            assert "(field)" not in error.message
        else:
            assert request is None or not retained
            assert request is None or request.command in ACCEPTED_COMMANDS or request.border
