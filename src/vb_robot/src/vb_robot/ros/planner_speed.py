"""Limits the speed of a robot without a driver in slow zones, by requests to its local planner.

A local planner's maximum speed is a parameter that can be set while it drives. Setting it is only a request: a planner
that hangs does not notice it, and a joystick or another program ignores it. Each planner has its own thread, so that
none delays other robots.
"""

from __future__ import annotations

import math
from typing import Dict, Mapping, Optional, Sequence

import rospy
from dynamic_reconfigure.msg import Config, DoubleParameter
from dynamic_reconfigure.srv import Reconfigure, ReconfigureRequest

from vb_core.errors import CodedError
from vb_core.ros import node, services

TIMEOUT = 2.0  # [s] without an answer after which a planner counts as not obeying


def cap_speeds(usual: Mapping[str, float], limit: float) -> Dict[str, float]:
    """Returns a planner's values capped by a limit [m/s]: maximum speeds at the limit, all others at half of it."""
    caps = {name: limit if name.startswith("max") else 0.5 * limit for name in usual}
    return {name: min(value, caps[name]) for name, value in usual.items()}


class PlannerSpeed:
    """The speed limit of one local planner.

    While there is a limit, the planner's usual values are on the parameter server, so that they are restored even if
    this node or the planner restarts. A value that a person sets while there is no limit becomes the usual value. While
    there is a limit, a higher speed that a person sets, or with which the planner restarts, is limited again.

    Args:
        server: the planner's name, for instance /move_base/DWAPlannerROS.
        names: the names of its speed parameters.

    Attributes:
        obeys: whether the planner has confirmed the last requested limit.
    """

    def __init__(self, server: str, names: Sequence[str]) -> None:
        self._server, self._names = server, names
        self._kept = f"/usual_speed{server}"
        self._limit: Optional[float] = None  # [m/s] the limit in force; None if it is not known
        self._highest: Mapping[str, float] = {}  # the maximum values under this limit
        self.obeys = False
        self._requests: node.Mailbox = node.Mailbox()
        self._worker = node.Worker(self._requests, self.apply)
        self._updates = rospy.Subscriber(f"{server}/parameter_updates", Config, self._on_update, queue_size=5)

    def request_limit(self, limit: float) -> None:
        """Requests a limit [m/s] from the planner, inf for none, without waiting for the answer."""
        self._requests.put(limit)

    def close(self) -> None:
        """Ends the requests."""
        self._requests.close()
        self._updates.unregister()

    def release(self) -> None:
        """Restores the planner's usual speed, and ends the requests."""
        self.close()
        self._worker.join(2.0 * TIMEOUT)
        try:
            self.apply(math.inf)
        except CodedError as error:
            rospy.logwarn("%s: %s", rospy.get_name(), error)

    def _on_update(self, config: Config) -> None:
        for entry in config.doubles:
            if entry.value > self._highest.get(entry.name, math.inf) + 1e-6:
                self._limit = None

    def apply(self, limit: float) -> None:
        """Sets the limit [m/s], inf for none. Does nothing if it is already in force.

        Raises:
            CodedError: "no_service", "no_response", or "planner_refused" if its speed remains higher.
        """
        if limit != self._limit:
            try:
                self._limit = None
                self._highest = {}
                self._apply(limit)
                self.obeys = True
            except CodedError:
                self.obeys = False
                raise

    def _apply(self, limit: float) -> None:
        """Sets a limit that is not in force, and stores or removes the usual values on the parameter server."""
        usual = rospy.get_param(self._kept, None)
        if usual is None:
            usual = self._set_parameters({})
            if math.isinf(limit):
                self._limit = limit
                return
            rospy.set_param(self._kept, usual)
        values = cap_speeds(usual, limit)
        if not math.isinf(limit):
            self._highest = values
        confirmed = self._set_parameters(values)
        if any(confirmed[name] > value + 1e-6 for name, value in values.items()):
            raise CodedError("planner_refused", planner=self._server, limit=f"{limit:.2f}")
        if math.isinf(limit):
            rospy.delete_param(self._kept)
        self._limit = limit

    def _set_parameters(self, values: Mapping[str, float]) -> Dict[str, float]:
        """Sets parameters of the planner, and returns its resulting values."""
        doubles = [DoubleParameter(name=name, value=value) for name, value in values.items()]
        request = ReconfigureRequest(Config(doubles=doubles))
        who = {"who": self._server}
        answer = services.call(f"{self._server}/set_parameters", Reconfigure, request, who, TIMEOUT, TIMEOUT)
        speeds = [entry for entry in answer.config.doubles if entry.name in self._names]
        return {entry.name: float(entry.value) for entry in speeds}
