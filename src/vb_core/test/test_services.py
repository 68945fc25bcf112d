"""A bounded service call: what comes back when neighbours are away, hang, or answer."""

from __future__ import annotations

import threading

import pytest
import rospy

from vb_core.errors import CodedError
from vb_core.ros import services


def fake(monkeypatch, wait, answer):
    monkeypatch.setattr(rospy, "wait_for_service", wait)
    monkeypatch.setattr(rospy, "ServiceProxy", lambda name, service: answer)


def absent(name, timeout):
    raise rospy.ROSException("timeout exceeded")


def present(name, timeout):
    return None


def test_the_answer_comes_back(monkeypatch):
    fake(monkeypatch, present, lambda request: request + 1)
    assert services.call("/s", object, 41, "somebody") == 42


def test_nothing_was_sent_to_an_absent_neighbour(monkeypatch):
    sent = []
    fake(monkeypatch, absent, sent.append)
    with pytest.raises(CodedError) as caught:
        services.call("/s", object, 1, "the integrator")
    assert caught.value.code == "no_service" and not sent
    assert "the integrator is not running" in str(caught.value)


def test_a_hanging_neighbour_is_left(monkeypatch):
    release = threading.Event()
    fake(monkeypatch, present, lambda request: release.wait(30))
    with pytest.raises(CodedError) as caught:
        services.call("/s", object, 1, "the integrator", service_timeout=0.05, response_timeout=0.1)
    release.set()
    assert caught.value.code == "no_response"


def test_a_lost_connection_is_no_answer(monkeypatch):
    def lost(request):
        raise rospy.ServiceException("transport error")

    fake(monkeypatch, present, lost)
    with pytest.raises(CodedError) as caught:
        services.call("/s", object, 1, "the integrator")
    assert caught.value.code == "no_response" and isinstance(caught.value.__cause__, rospy.ServiceException)
