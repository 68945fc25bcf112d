"""A bounded service call: what comes back when neighbours are away, hang, or answer."""

from __future__ import annotations

import threading

import rospy

from refusals import refused
from vb_core.ros import services


def fake(monkeypatch, wait, answer):
    monkeypatch.setattr(rospy, "wait_for_service", wait)
    monkeypatch.setattr(rospy, "ServiceProxy", lambda name, service: answer)


def raising(error):
    def work(*_, **__):
        raise error

    return work


def present(name, timeout):
    return None


def test_the_answer_comes_back(monkeypatch):
    fake(monkeypatch, present, lambda request: request + 1)
    assert services.call("/s", object, 41, "somebody") == 42


def test_nothing_was_sent_to_an_absent_neighbour(monkeypatch):
    sent = []
    fake(monkeypatch, raising(rospy.ROSException("timeout exceeded")), sent.append)
    with refused("no_service") as caught:
        services.call("/s", object, 1, "the integrator")
    assert not sent and "the integrator is not running" in str(caught.value)


def test_a_hanging_neighbour_is_given_up(monkeypatch):
    release = threading.Event()
    fake(monkeypatch, present, lambda request: release.wait(30))
    with refused("no_response"):
        services.call("/s", object, 1, "the integrator", service_timeout=0.05, response_timeout=0.1)
    release.set()


def test_a_lost_connection_counts_as_no_response(monkeypatch):
    fake(monkeypatch, present, raising(rospy.ServiceException("transport error")))
    with refused("no_response") as caught:
        services.call("/s", object, 1, "the integrator")
    assert isinstance(caught.value.__cause__, rospy.ServiceException)
