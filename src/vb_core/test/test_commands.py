"""Giving commands: each has an id and an end, a lost answer is asked for once more, and stop waits for nothing."""

import re
import threading
from pathlib import Path

import pytest
import rospy

from vb_core.errors import CodedError
from vb_core.ros import commands
from vb_msgs.srv import CommandResponse


def test_no_comment_is_part_of_a_constant():
    """In messages all that follows a string constant's = is its value."""
    found = [
        f"{path.name}: {line}"
        for path in Path(__file__).resolve().parents[2].glob("vb_msgs/*/*.[ms]*")
        if path.suffix in (".msg", ".srv")
        for line in path.read_text(encoding="utf-8").splitlines()
        if re.match(r"string +[A-Z_]+ *=.*#", line)
    ]
    assert not found


@pytest.fixture
def answers(monkeypatch):
    """Puts answers (or errors) in the place of the manager; gives them and what was asked."""
    asked, given = [], []

    def call(_name, _service, request, *_limits):
        asked.append(request)
        answer = given.pop(0) if given else CommandResponse(success=True, code="stopped")
        if isinstance(answer, Exception):
            raise answer
        return answer

    monkeypatch.setattr(commands.services, "call", call)
    monkeypatch.setattr(commands.rospy, "get_rostime", lambda: rospy.Time(100))
    return asked, given


def no_answer(cause):
    error = CodedError("no_response", who="$interaction_manager")
    error.__cause__ = cause
    return error


def test_every_command_has_an_id_of_its_own_and_an_end(answers):
    first, second = (
        commands.make_request("save", "test", 5.0),
        commands.make_request("save", "test", 5.0, uncertain=True),
    )
    assert first.id and second.id and first.id != second.id
    assert first.expires == rospy.Time(105) and (first.uncertain, second.uncertain) == (False, True)


def test_before_simulated_time_has_begun_nothing_expires(answers, monkeypatch):
    monkeypatch.setattr(commands.rospy, "get_rostime", lambda: rospy.Time(0))
    assert commands.make_request("save", "test", 5.0).expires.is_zero()


def test_a_lost_answer_is_asked_for_once_more_under_the_same_id(answers):
    asked, given = answers
    given.append(no_answer(rospy.ServiceException("the connection was closed")))
    assert commands.send(commands.make_request("undo", "test", 5.0)).success
    assert len(asked) == 2 and asked[0].id == asked[1].id


@pytest.mark.parametrize("error", [no_answer(TimeoutError("hangs")), CodedError("no_service", who="x")])
def test_a_service_that_hangs_or_is_absent_is_not_asked_again(answers, error):
    asked, given = answers
    given.append(error)
    with pytest.raises(CodedError):
        commands.send(commands.make_request("undo", "test", 5.0))
    assert len(asked) == 1


def test_stop_waits_for_no_other_command(monkeypatch):
    hold, done = threading.Event(), []
    finished = {name: threading.Event() for name in ("save", "stop")}

    def call(_name, _service, request, *_limits):
        if request.command == "save":
            hold.wait(60)
        return CommandResponse(success=True)

    def on_answer(request, beside, answer, error):
        done.append((request.command, beside, answer.success, error))
        finished[request.command].set()

    monkeypatch.setattr(commands.services, "call", call)
    monkeypatch.setattr(commands.rospy, "get_rostime", lambda: rospy.Time(100))
    orders = commands.CommandSender("test", on_answer)
    assert orders.put("save", 1) and orders.put("stop", 2)
    assert finished["stop"].wait(60) and done == [("stop", 2, True, None)]
    hold.set()
    assert finished["save"].wait(60) and done[1] == ("save", 1, True, None)
    orders.close()
