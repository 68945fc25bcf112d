"""Sends commands to the interaction manager; every input method uses this.

Each command has an id, so that sending it again does no harm, and an expiry time, counted from when the person gave it:
nobody expects a button pressed a minute ago to act. It names the newest stop that its sender knew of when it was given:
a newer stop makes it void.

A stop reaches the robots with or without a manager. If no manager answers, the robots do: each reports the stops that
it holds.
"""

from __future__ import annotations

import math
import threading
import time
import uuid
from collections import deque
from typing import Any, Callable, Deque, Dict, List, Optional, Sequence, Tuple, Union

import rospy

from vb_core import names, sentences
from vb_core.errors import CodedError
from vb_core.ros import node, services
from vb_core.ros.messages import values_from_mapping
from vb_core.vocabulary import STOP
from vb_msgs.msg import DriverState, InteractionState, RobotStatus, RobotStatusArray, Stop
from vb_msgs.srv import Command, CommandRequest, CommandResponse

MANAGER = "$interaction_manager"
VALIDITY = 5.0  # [s] from when a command was given: after a longer wait for a busy manager it would surprise people
RESPONSE_TIMEOUT = 15.0  # [s] longer than the manager waits for other nodes, so that its answer arrives
_STOP_TIMEOUT = 5.0  # [s] a manager that has not answered a stop by then hangs: whoever stops a robot must not wait
_REPORTED_WITHIN = 1.5  # [s] robots report the stops that they hold at once, and again every second
_MAX_WAITING = 10  # commands of one person


def make_request(
    command: str, source: str, validity: float, uncertain: bool = False, seen_stop: str = ""
) -> CommandRequest:
    """Makes the request for a command, with a unique id and an expiry time.

    Args:
        source: the input method that sends it.
        validity: [s] from now on, ROS time.
        uncertain: whether it may have been misunderstood.
        seen_stop: number of the newest stop that the person knew of, see vb_msgs/Command.
    """
    request = CommandRequest(
        command=command, source=source, id=uuid.uuid4().hex, uncertain=uncertain, seen_stop=seen_stop
    )
    now = rospy.get_rostime()
    # before simulated time has begun there is no time to expire at
    if not now.is_zero():
        request.expires = now + rospy.Duration.from_sec(validity)
    return request


def send(
    request: CommandRequest, service_timeout: float = 1.0, response_timeout: float = RESPONSE_TIMEOUT
) -> CommandResponse:
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
    """Sends people's commands: each person's one after the other, but `stop` at once, and directly to the robots too.

    Nothing overtakes a stop: the same person's next command waits for its answer. People do not wait for each other.

    Args:
        source: who gives the commands, for the record, unless `put` names somebody else.
        on_answer: called from another thread with the command, its `context`, and either the answer or the error.
    """

    def __init__(
        self,
        source: str,
        on_answer: Callable[[CommandRequest, Any, Optional[CommandResponse], Optional[CodedError]], None],
    ) -> None:
        self._source = source
        self._on_answer = on_answer
        self._lock = threading.Lock()
        self._unanswered: Dict[str, List[threading.Event]] = {}  # by person
        # each with the time [s] at which it became known
        self._stop_numbers: Deque[Tuple[float, str]] = deque([(-math.inf, "")], maxlen=64)
        self._held: Dict[str, Sequence[str]] = {}  # ids of the stops that each robot holds
        self._stop: Optional[rospy.Publisher] = None

    def connect(self) -> None:
        """Connects to the interaction's state and the robots, once the node is registered."""
        self._stop = rospy.Publisher(names.STOP, Stop, queue_size=5)
        rospy.Subscriber(names.STATE, InteractionState, self._on_state, queue_size=1, tcp_nodelay=True)
        rospy.Subscriber(names.DRIVERS, DriverState, self._on_robot, queue_size=20)
        rospy.Subscriber(names.ROBOTS, RobotStatusArray, self._on_robots, queue_size=1)

    def _on_state(self, message: InteractionState) -> None:
        if message.stop_number != self._stop_numbers[-1][1]:
            self._stop_numbers.append((time.monotonic(), message.stop_number))

    def _on_robots(self, message: RobotStatusArray) -> None:
        for robot in message.robots:
            if not robot.driver:
                self._on_robot(robot)

    def _on_robot(self, message: Union[DriverState, RobotStatus]) -> None:
        self._held[message.robot] = message.stops

    def stop_number(self, when: float) -> str:
        """Returns the number of the newest stop that was known here at a time [s] of the monotonic clock."""
        return next(number for since, number in reversed(list(self._stop_numbers)) if since <= when)

    def put(
        self,
        command: str,
        context: Any = None,
        uncertain: bool = False,
        given: float = math.inf,
        source: str = "",
        seen_stop: Optional[str] = None,
        identity: str = "",
        carry_out: Callable[[CommandRequest], Any] = send,
    ) -> bool:
        """Sends a command when its turn comes; returns False, and drops it, if too many of this person's wait.

        Args:
            context: handed on to `on_answer`.
            given: [s] of the monotonic clock, when the person gave it; by default, and at the latest, now.
            source: the person who gives it.
            seen_stop: number of the newest stop that the person was shown; None: the newest known here at `given`.
            identity: id of this command, if it has one already and may arrive twice.
            carry_out: carries out any command but a stop; returns the answer or raises a `CodedError`.
        """
        given, source = min(given, time.monotonic()), source or self._source
        if seen_stop is None:
            seen_stop = self.stop_number(given)
        request = make_request(command, source, VALIDITY - (time.monotonic() - given), uncertain, seen_stop)
        request.id = identity or request.id
        if command == STOP and self._stop is not None:
            self._stop.publish(Stop(id=request.id, source=source))
        answered = threading.Event()
        with self._lock:
            before = self._unanswered.setdefault(source, [])
            # other commands leave room for as many stops
            if len(before) >= (2 * _MAX_WAITING if command == STOP else _MAX_WAITING):
                return False
            waits_for = [] if command == STOP else list(before)
            before.append(answered)
        node.start_thread(self._deliver, request, context, given, waits_for, answered, carry_out)
        return True

    def _deliver(
        self,
        request: CommandRequest,
        context: Any,
        given: float,
        waits_for: List[threading.Event],
        answered: threading.Event,
        carry_out: Callable[[CommandRequest], Any],
    ) -> None:
        for earlier in waits_for:
            earlier.wait()
        answer, error = None, None
        try:
            if request.command != STOP and time.monotonic() - given > VALIDITY:
                raise CodedError("expired", command=f"$command_{request.command}")
            answer = carry_out(request) if request.command != STOP else self._send_stop(request)
        except CodedError as fault:
            error = fault
        finally:
            answered.set()
            with self._lock:
                self._unanswered[request.source].remove(answered)
                if not self._unanswered[request.source]:
                    del self._unanswered[request.source]
        self._on_answer(request, context, answer, error)

    def _send_stop(self, stop: CommandRequest) -> CommandResponse:
        """Sends a stop; returns the manager's answer or, if no manager responds, which robots hold the stop.

        Raises:
            CodedError: "stop_unconfirmed" if no robot holds it, or as `send`.
        """
        given = time.monotonic()
        try:
            return send(stop, response_timeout=_STOP_TIMEOUT)
        except CodedError as error:
            if error.code not in services.UNANSWERED:
                raise
        time.sleep(max(0.0, given + _REPORTED_WITHIN - time.monotonic()))
        robots = sorted(name for name, stops in list(self._held.items()) if stop.id in stops)
        if not robots:
            raise CodedError("stop_unconfirmed")
        # the robots keep the stop, and report it to the manager once that is running
        code, values = "stop_held", {"robots": ", ".join(map(sentences.robot_value, robots))}
        return CommandResponse(True, code, sentences.translate(code, values), values_from_mapping(values))
