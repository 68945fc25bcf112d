"""Calls other nodes' services with a time limit."""

from __future__ import annotations

import queue
import threading
from typing import Any, Mapping, Type

import rospy

from vb_core.errors import CodedError

INTEGRATOR = {"who_code": "map_integrator"}  # how an error's sentence names the node
UNANSWERED = ("no_service", "no_response")  # codes for a service that does not answer; others come from the service


def call(
    name: str,
    service: Type,
    request: Any,
    answering_node: Mapping[str, str],
    service_timeout: float = 1.0,
    response_timeout: float = 5.0,
) -> Any:
    """Calls a service. Returns its response, or raises an error, within a known time.

    rospy itself waits without limit for a process that accepts the connection and hangs. The limits are in wall time on
    purpose, since simulated time may stand still.

    Args:
        service: the service's class, for instance vb_msgs.srv.AddBorder.
        answering_node: {who} in the error's sentence: {"who": "AMCL"}, or {"who_code": "map_integrator"} to translate it.
        service_timeout: [s] how long to wait for the service to appear.
        response_timeout: [s] how long to wait for its response after that.

    Raises:
        CodedError: "no_service" if no node offers it, so that nothing was sent. "no_response" if the request was sent
            but no response came, so that it may or may not have been carried out.
    """
    answers: "queue.Queue" = queue.Queue()
    is_sent = threading.Event()

    def call_service() -> None:
        try:
            rospy.wait_for_service(name, timeout=service_timeout)
            is_sent.set()
            answers.put((rospy.ServiceProxy(name, service)(request), None))
        except Exception as error:  # the caller's thread reports anything that the transport raises
            answers.put((None, error))

    threading.Thread(target=call_service, daemon=True).start()
    try:
        response, error = answers.get(timeout=service_timeout + response_timeout)
    except queue.Empty:
        error = TimeoutError(f"no response within {response_timeout:g} s")
    if error is not None:
        code = "no_response" if is_sent.is_set() else "no_service"
        raise CodedError(code, **answering_node) from error
    return response
