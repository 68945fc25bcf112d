"""Service calls with timeouts, and commands: each has an id and expires, and stop waits for nothing."""

import re
import threading
from collections import namedtuple
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
import rospy

from refusals import refused
from vb_testing import assert_fields, wait_until
from vb_core.errors import CodedError
from vb_core.ros import commands, services
from vb_msgs.msg import DriverState, InteractionState, RobotStatus, RobotStatusArray
from vb_msgs.srv import CommandResponse


def test_no_message_constant_contains_a_comment():
    """In a message definition, everything after a string constant's = is its value, even a comment."""
    faulty_lines = [
        f"{path.name}: {line}"
        for path in Path(__file__).resolve().parents[2].glob("vb_msgs/*/*.[ms]*")
        if path.suffix in (".msg", ".srv")
        for line in path.read_text(encoding="utf-8").splitlines()
        if re.match(r"string +[A-Z_]+ *=.*#", line)
    ]
    assert not faulty_lines


Outcome = namedtuple("Outcome", "request context answer error")  # of a command, as its sender hears of it


class Manager:
    """Stands in for the manager: the commands in `hanging` wait for `let`. Answers `answers` in turn, then success."""

    def __init__(self, hanging):
        self.requests, self.answers, self.done = [], [], []
        self._gates = {command: threading.Event() for command in hanging}

    def call(self, _name, _service, request, *_names, **_limits):
        self.requests.append(request)
        if request.command in self._gates:
            assert self._gates[request.command].wait(60)
        answer = self.answers.pop(0) if self.answers else CommandResponse(success=True)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def asked_for(self, command):
        return next(request for request in self.requests if request.command == command)

    def let(self, command):
        self._gates[command].set()

    def wait_for(self, count):
        wait_until(lambda: len(self.done) >= count, f"{count} answers")
        return self.done[:count]


@pytest.fixture
def sender(monkeypatch):
    """Returns a function that makes a sender, its manager and its clock."""

    def make(*hanging):
        manager = Manager(hanging)
        clock = [10.0]
        monkeypatch.setattr(commands.services, "call", manager.call)
        monkeypatch.setattr(commands, "rospy", Mock(get_rostime=lambda: rospy.Time(100), Duration=rospy.Duration))
        monkeypatch.setattr(commands.time, "monotonic", lambda: clock[0])
        return commands.CommandSender("test", lambda *outcome: manager.done.append(Outcome(*outcome))), manager, clock

    return make


def no_answer(cause):
    error = CodedError("no_response", who_code="interaction_manager")
    error.__cause__ = cause
    return error


def test_every_command_has_a_unique_id_and_expires(sender, monkeypatch):
    sender()
    certain = commands.make_request("save", "test", 5.0)
    uncertain = commands.make_request("save", "test", 5.0, uncertain=True)
    assert len({certain.id, uncertain.id, ""}) == 3
    assert [request.uncertain for request in (certain, uncertain)] == [False, True]
    assert certain.expires == rospy.Time(105)
    # nothing expires before simulated time has begun
    monkeypatch.setattr(commands.rospy, "get_rostime", lambda: rospy.Time(0))
    assert commands.make_request("save", "test", 5.0).expires.is_zero()


def test_a_lost_answer_is_asked_for_again_under_its_id(sender):
    _, manager, _ = sender()
    manager.answers.append(no_answer(rospy.ServiceException("the connection was closed")))
    request = commands.make_request("undo", "test", 5.0)
    assert commands.send(request).success
    assert [sent.id for sent in manager.requests] == [request.id] * 2


SILENT = {"hangs": no_answer(TimeoutError()), "is absent": CodedError("no_service", who="x")}


@pytest.mark.parametrize("error", SILENT.values(), ids=SILENT)
def test_a_silent_service_is_not_asked_again(sender, error):
    _, manager, _ = sender()
    manager.answers.append(error)
    with refused(error.code):
        commands.send(commands.make_request("undo", "test", 5.0))
    assert len(manager.requests) == 1


def test_a_command_names_the_newest_stop_its_sender_knew(sender):
    orders, manager, clock = sender()
    for clock[0], number in ((10.0, "a"), (11.0, "a"), (12.0, "b")):
        orders._on_state(InteractionState(stop_number=number))
    for given_at in (11.5, 13.0, 9.0):
        orders.submit("resume", given_at=given_at)
    orders.submit("resume", seen_stop="shown")
    assert sorted(outcome.request.seen_stop for outcome in manager.wait_for(4)) == ["", "a", "b", "shown"]
    for number in range(100):
        orders._on_state(InteractionState(stop_number=str(number)))
    assert orders.stop_number(11.5) == ""  # no longer remembered: fail closed


def test_a_commands_age_counts_from_when_it_was_given(sender):
    orders, manager, clock = sender()
    clock[0] = 100.0
    orders.submit("save", given_at=98.0)
    orders.submit("define_border", given_at=94.0, source="other")
    outcomes = {outcome.request.command: outcome for outcome in manager.wait_for(2)}
    assert outcomes["save"].request.expires == rospy.Time(103)
    assert outcomes["save"].answer.success
    assert outcomes["define_border"].answer is None
    assert outcomes["define_border"].error.code == "expired"
    assert [request.command for request in manager.requests] == ["save"]


def test_stop_waits_for_nothing_and_nothing_overtakes_it(sender):
    orders, manager, _ = sender("save", "stop")
    for number, command in enumerate(("save", "stop", "resume")):
        assert orders.submit(command, number)
    orders.submit("cancel", source="somebody else")
    # neither the hanging save nor the hanging stop holds up other people's commands
    assert [outcome.request.command for outcome in manager.wait_for(1)] == ["cancel"]
    manager.let("stop")
    assert_fields(manager.wait_for(2)[1], request=manager.asked_for("stop"), context=1)
    manager.let("save")
    assert {outcome.request.command for outcome in manager.wait_for(4)[2:]} == {"save", "resume"}
    assert manager.requests[-1].command == "resume"


def test_robots_answer_a_stop_without_a_manager(sender, monkeypatch):
    orders, manager, _ = sender("cancel")

    def report(_seconds):  # while the sender waits for the robots
        stop = manager.asked_for("stop").id
        orders._on_robot(DriverState(robot="cleo", stops=["an older one", stop]))
        orders._on_robot(DriverState(robot="bob", stops=["an older one"]))
        statuses = [RobotStatus(robot="ada", stops=[stop]), RobotStatus(robot="cleo", driver=True)]
        orders._on_robots(RobotStatusArray(robots=statuses))

    absent = CodedError("no_service", who_code="interaction_manager")
    manager.answers += [absent, absent]
    monkeypatch.setattr(commands.time, "sleep", report)
    orders.submit("stop")
    (held,) = manager.wait_for(1)
    assert_fields(held.answer, success=True, code="stop_held")
    assert held.error is None
    assert [value.value for value in held.answer.values] == ["ada, cleo"]
    orders.submit("stop")
    unconfirmed = manager.wait_for(2)[1]
    assert unconfirmed.answer is None
    assert unconfirmed.error.code == "stop_unconfirmed"


def test_commands_to_other_nodes_wait_their_turn_too(sender):
    orders, manager, _ = sender("stop")
    orders.submit("stop")
    orders.submit("switch_border", carry_out=lambda request: [*manager.requests, request.command])
    orders.submit("resume")
    manager.let("stop")
    answers = {outcome.request.command: outcome.answer for outcome in manager.wait_for(3)}
    assert answers["switch_border"] == [manager.asked_for("stop"), "switch_border"]
    assert [request.command for request in manager.requests] == ["stop", "resume"]


def test_a_full_queue_of_one_person_holds_up_nobody_else(sender):
    orders, manager, _ = sender("save")
    assert [orders.submit("save") for _ in range(11)] == [True] * 10 + [False]
    assert [orders.submit("undo", source="somebody else"), orders.submit("stop")] == [True, True]
    assert {outcome.request.command for outcome in manager.wait_for(2)} == {"undo", "stop"}
    manager.let("save")
    assert len(manager.wait_for(12)) == 12
    assert orders._unanswered == {}


# ------------------------------------------------------------------ services
@pytest.fixture
def neighbour(monkeypatch):
    """A stand-in for a service: tests set what happens when it is waited for (`wait`) and called (`ask`)."""
    stand_in = SimpleNamespace(wait=Mock(), ask=Mock())
    monkeypatch.setattr(rospy, "wait_for_service", stand_in.wait)
    monkeypatch.setattr(rospy, "ServiceProxy", lambda name, service: stand_in.ask)
    return stand_in


def test_the_answer_comes_back(neighbour):
    neighbour.ask.side_effect = lambda request: request + 1
    assert services.call("/s", object, 41, {"who": "somebody"}) == 42


def test_nothing_was_sent_to_an_absent_neighbour(neighbour):
    neighbour.wait.side_effect = rospy.ROSException("timeout exceeded")
    with refused("no_service") as caught:
        services.call("/s", object, 1, {"who": "the integrator"})
    assert "the integrator is not running" in str(caught.value)
    neighbour.ask.assert_not_called()


def test_a_hanging_neighbour_is_given_up(neighbour):
    release = threading.Event()
    neighbour.ask.side_effect = lambda request: release.wait(30)
    with refused("no_response"):
        services.call("/s", object, 1, {"who": "the integrator"}, service_timeout=0.05, response_timeout=0.1)
    release.set()


def test_a_lost_connection_counts_as_no_response(neighbour):
    neighbour.ask.side_effect = rospy.ServiceException("transport error")
    with refused("no_response") as caught:
        services.call("/s", object, 1, {"who": "the integrator"})
    assert isinstance(caught.value.__cause__, rospy.ServiceException)
