"""Sends commands to the interaction manager; every input method uses this module.

Each command has an id, so that sending it twice does no harm. It expires some seconds after the person gave it, because
nobody expects a button pressed a minute ago to act. It names the newest stop that its sender knew at that time; a newer
stop invalidates the command.

A stop reaches the robots with or without a manager. If no manager answers, the robots report the stops that they hold.
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
from vb_core.interaction_tables import STOP
from vb_core.ros import node, services
from vb_core.ros.messages import values_from_mapping
from vb_msgs.msg import DriverState, InteractionState, RobotStatus, RobotStatusArray, Stop
from vb_msgs.srv import Command, CommandRequest, CommandResponse

MANAGER = {"who_code": "interaction_manager"}
VALIDITY = 5.0  # [s] a command is valid; if a busy manager carried it out later, it would surprise people
RESPONSE_TIMEOUT = 15.0  # [s] longer than the manager waits for other nodes, so that its answer arrives
_STOP_TIMEOUT = 5.0  # [s] after which the manager counts as hanging: people who stop a robot must not wait longer
_REPORTED_WITHIN = 1.5  # [s] robots report a new stop at once, and all stops that they hold every second
_NO_STOP = ""  # the number before the first stop
_MAX_WAITING = 10  # unanswered commands of one person


def make_request(
    command: str, source: str, validity: float, uncertain: bool = False, seen_stop: str = ""
) -> CommandRequest:
    """Makes the request for a command, with a unique id and an expiry time.

    Args:
        source: the input method that sends it.
        validity: [s] ROS time from now until it expires.
        uncertain: whether it may have been misunderstood.
        seen_stop: number of the newest stop that the person knew of, see vb_msgs/Command.
    """
    request = CommandRequest(command=command, source=source, uncertain=uncertain, seen_stop=seen_stop)
    request.id = uuid.uuid4().hex
    now = rospy.get_rostime()
    # without an expiry time while simulated time has not started
    if not now.is_zero():
        request.expires = now + rospy.Duration.from_sec(validity)
    return request


def send(
    request: CommandRequest, service_timeout: float = 1.0, response_timeout: float = RESPONSE_TIMEOUT
) -> CommandResponse:
    """Sends a command. Sends it again if the answer is lost, for instance because the manager restarts.

    Raises:
        CodedError: "no_service" or "no_response", as in `services.call`.
    """
    try:
        return services.call(names.COMMAND, Command, request, MANAGER, service_timeout, response_timeout)
    except CodedError as error:
        if error.code != "no_response" or isinstance(error.__cause__, TimeoutError):
            raise
    return services.call(names.COMMAND, Command, request, MANAGER, service_timeout, response_timeout)


class CommandSender:
    """Sends each person's commands one after the other, but a `stop` at once, and also directly to the robots.

    No command overtakes a stop: the same person's next command waits for the stop's answer. People do not wait for each
    other.

    Args:
        source: the person who gives the commands, unless `submit` names another one.
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
        self._unanswered: Dict[str, List[threading.Event]] = {}  # each person's
        # pairs of the time [s] at which a number became known, and the number
        self._stop_numbers: Deque[Tuple[float, str]] = deque([(-math.inf, _NO_STOP)], maxlen=64)
        self._held: Dict[str, Sequence[str]] = {}  # ids of the stops that each robot holds
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
        """Returns the number of the newest stop known to this node at time `when` [s] of the monotonic clock."""
        known = (number for time_known, number in reversed(list(self._stop_numbers)) if time_known <= when)
        return next(known, _NO_STOP)  # a command from before the remembered times releases no stop

    def submit(
        self,
        command: str,
        context: Any = None,
        uncertain: bool = False,
        given_at: float = math.inf,
        source: str = "",
        seen_stop: Optional[str] = None,
        identity: str = "",
        carry_out: Callable[[CommandRequest], Any] = send,
    ) -> bool:
        """Sends a command after the person's earlier ones. Drops it and returns False if too many of them still wait.

        Even a stop that is dropped has been sent to the robots. It only remains unanswered.

        Args:
            context: passed on to `on_answer`.
            given_at: [s] time on the monotonic clock when the person gave the command; at the latest, and by default, now.
            source: the person or input method that gives it; by default this sender's.
            seen_stop: number of the newest stop shown to the person; None for the newest known to this node at `given_at`.
            identity: the command's id if it already has one and may arrive twice.
            carry_out: carries out any command except a stop; returns the answer or raises a `CodedError`.
        """
        given_at = min(given_at, time.monotonic())
        source = source or self._source
        if seen_stop is None:
            seen_stop = self.stop_number(given_at)
        request = make_request(command, source, VALIDITY - (time.monotonic() - given_at), uncertain, seen_stop)
        request.id = identity or request.id
        if command == STOP:
            self._stop.publish(Stop(id=request.id, source=source))
        answered = threading.Event()
        with self._lock:
            unanswered = self._unanswered.setdefault(source, [])
            # the limit for stops is twice as high, so that other commands never keep a stop out
            limit = 2 * _MAX_WAITING if command == STOP else _MAX_WAITING
            if len(unanswered) >= limit:
                return False
            waits_for = [] if command == STOP else list(unanswered)
            unanswered.append(answered)
        node.start_thread(self._deliver, request, context, given_at, waits_for, answered, carry_out)
        return True

    def _deliver(
        self,
        request: CommandRequest,
        context: Any,
        given_at: float,
        earlier_commands: List[threading.Event],
        answered: threading.Event,
        carry_out: Callable[[CommandRequest], Any],
    ) -> None:
        """Carries out a command after the person's earlier ones, and reports the answer."""
        for earlier_command in earlier_commands:
            earlier_command.wait()
        answer, error = None, None
        try:
            if request.command != STOP and time.monotonic() - given_at > VALIDITY:
                raise CodedError("expired", command_code=f"command_{request.command}")
            answer = self._send_stop(request) if request.command == STOP else carry_out(request)
        except CodedError as caught:
            error = caught
        finally:
            answered.set()
            with self._lock:
                self._unanswered[request.source].remove(answered)
                if not self._unanswered[request.source]:
                    del self._unanswered[request.source]
        self._on_answer(request, context, answer, error)

    def _send_stop(self, stop: CommandRequest) -> CommandResponse:
        """Sends a stop. Returns the manager's answer or, if none comes, one that names the robots that hold the stop.

        Raises:
            CodedError: "stop_unconfirmed" if no robot holds it, or as in `send`.
        """
        given_at = time.monotonic()
        try:
            return send(stop, response_timeout=_STOP_TIMEOUT)
        except CodedError as error:
            if error.code not in services.UNANSWERED:
                raise
        time.sleep(max(0.0, given_at + _REPORTED_WITHIN - time.monotonic()))
        robots = sorted(name for name, stops in list(self._held.items()) if stop.id in stops)
        if not robots:
            raise CodedError("stop_unconfirmed")
        # the robots keep the stop, and report it to the manager when it runs again
        values = sentences.robot_values(*robots, key="robots")
        message = sentences.translate("stop_held", values)
        return CommandResponse(True, "stop_held", message, values_from_mapping(values))
