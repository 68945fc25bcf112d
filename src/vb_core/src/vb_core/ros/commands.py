"""Sends commands to the interaction; every input method uses this.

Each command has an id, so that sending it again does no harm, and a time after which it must not be carried out:
a person who was told "does not answer" does not expect it a minute later.
"""

from __future__ import annotations

import uuid
from typing import Any, Callable, Optional

import rospy

from vb_core import names
from vb_core.errors import CodedError
from vb_core.ros import node, services
from vb_msgs.srv import Command, CommandRequest, CommandResponse

MANAGER = "$interaction_manager"
_STOP = "stop"


def make_request(command: str, source: str, validity: float, uncertain: bool = False) -> CommandRequest:
    """Makes the request for a command, with a unique id and a time at which it expires.

    Args:
        source: the input method that sends it.
        validity: [s] from now on, ROS time.
        uncertain: whether it may have been misunderstood.
    """
    request = CommandRequest(command=command, source=source, id=uuid.uuid4().hex, uncertain=uncertain)
    now = rospy.get_rostime()
    # before simulated time has begun there is no time to expire at
    if not now.is_zero():
        request.expires = now + rospy.Duration.from_sec(validity)
    return request


def send(request: CommandRequest, service_timeout: float = 1.0, response_timeout: float = 12.0) -> CommandResponse:
    """Sends a command, and again if its answer is lost, for instance because the manager restarts.

    Raises:
        CodedError: "no_service" or "no_response", as `services.call`.
    """
    try:
        return services.call(names.COMMAND, Command, request, MANAGER, service_timeout, response_timeout)
    except CodedError as error:
        if error.code != "no_response" or isinstance(error.__cause__, TimeoutError):
            raise
    return services.call(names.COMMAND, Command, request, MANAGER, service_timeout, response_timeout)


class CommandSender:
    """Sends commands one after the other from a separate thread; `stop` waits for no other.

    Args:
        source: who sends them, for the record.
        on_answer: called from that thread with the command's `context`, and either the answer or the error.
        service_timeout, response_timeout: [s] wall time, how long the manager and its answer are waited for.
        size: how many may wait.
    """

    def __init__(
        self,
        source: str,
        on_answer: Callable[[CommandRequest, Any, Optional[CommandResponse], Optional[CodedError]], None],
        service_timeout: float = 1.0,
        response_timeout: float = 12.0,
        size: int = 10,
    ) -> None:
        self._source = source
        self._on_answer = on_answer
        self._service_timeout, self._response_timeout = service_timeout, response_timeout
        self._waiting: node.Queue = node.Queue(size)
        self._urgent: node.Queue = node.Queue(size)
        for line in (self._waiting, self._urgent):
            node.Worker(line, self._send_item)

    def put(self, command: str, context: Any = None, uncertain: bool = False) -> bool:
        """Queues a command; returns False if too many wait already and it is dropped.

        Args:
            context: handed on to `on_answer`.
        """
        request = make_request(command, self._source, self._service_timeout + self._response_timeout, uncertain)
        line = self._urgent if command == _STOP else self._waiting
        return line.put((request, context))

    def close(self) -> None:
        """Ends the threads."""
        self._waiting.close()
        self._urgent.close()

    def _send_item(self, item: Any) -> None:
        request, context = item
        try:
            answer = send(request, self._service_timeout, self._response_timeout)
        except CodedError as error:
            self._on_answer(request, context, None, error)
            return
        self._on_answer(request, context, answer, None)
