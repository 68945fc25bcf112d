"""Enforces slow zones without the driver, by requests to a robot's own navigation.

A local planner's highest speed is a parameter that can be set while it drives. That is only a request: a planner that
hangs, a joystick or another program that commands the wheels ignores it. Each planner is called in its own thread, so
that one that hangs does not delay other robots.
"""

from __future__ import annotations

import math
from typing import Dict, Mapping, Optional

import rospy
from dynamic_reconfigure.msg import Config, DoubleParameter
from dynamic_reconfigure.srv import Reconfigure, ReconfigureRequest

from vb_core.errors import CodedError
from vb_core.ros import node, services

TIMEOUT = 2.0  # [s] after which a planner that has not answered counts as not obeying


def limited(usual_values: Mapping[str, float], limit: float) -> Dict[str, float]:
    """Returns a planner's values capped by a limit [m/s]: highest speeds by the limit, other values by half of it."""
    return {name: min(value, limit if name.startswith("max") else 0.5 * limit) for name, value in usual_values.items()}


class PlannerSpeed:
    """The speed limit of one local planner.

    While it is limited, its usual values are kept on the parameter server, so that they are restored even if this node
    or the planner restarts meanwhile. A value that a person sets without a limit in force becomes the usual one; while
    a limit is in force, a higher speed that somebody sets, or that a restarted planner has, is limited again.

    Args:
        server: the planner's name, for instance /move_base/DWAPlannerROS; names: those of its speed parameters.

    Attributes:
        obeys: whether the planner has confirmed the newest limit that was requested.
    """

    def __init__(self, server: str, names) -> None:
        self._server, self._names = server, tuple(names)
        self._backup_parameter = f"/usual_speed{server}"
        self._applied_limit: Optional[float] = None  # the limit in force; None if not known
        self._allowed_values: Mapping[str, float] = {}  # the values that it allows
        self.obeys = False
        self._requests: node.Mailbox = node.Mailbox()
        self._worker = node.Worker(self._requests, self.apply)
        self._updates = rospy.Subscriber(f"{server}/parameter_updates", Config, self._on_update, queue_size=5)

    def request_limit(self, limit: float) -> None:
        """Requests a limit [m/s] from the planner, inf for none, without waiting for the answer."""
        self._requests.put(limit)

    def close(self) -> None:
        """Stops sending requests."""
        self._requests.close()
        self._updates.unregister()

    def release(self) -> None:
        """Restores the planner's usual speed, and stops sending requests."""
        self.close()
        self._worker.join(2.0 * TIMEOUT)
        try:
            self.apply(math.inf)
        except CodedError as error:
            rospy.logwarn("%s: %s", rospy.get_name(), error)

    def _on_update(self, config: Config) -> None:
        if any(entry.value > self._allowed_values.get(entry.name, math.inf) + 1e-6 for entry in config.doubles):
            self._applied_limit = None

    def apply(self, limit: float) -> None:
        """Sets the limit [m/s], inf for none; does nothing if it is already in force.

        Raises:
            CodedError: "no_service", "no_response", or "planner_refused" if it keeps a higher speed.
        """
        if limit != self._applied_limit:
            try:
                self._applied_limit, self._allowed_values = None, {}
                self._apply(limit)
                self.obeys = True
            except CodedError:
                self.obeys = False
                raise

    def _apply(self, limit: float) -> None:
        usual_values = rospy.get_param(self._backup_parameter, None)
        if usual_values is None:
            usual_values = self._set_parameters({})
            if math.isinf(limit):
                self._applied_limit = limit
                return
            rospy.set_param(self._backup_parameter, usual_values)
        requested_values = limited(usual_values, limit)
        if not math.isinf(limit):
            self._allowed_values = requested_values
        actual_values = self._set_parameters(requested_values)
        if any(actual_values[name] > value + 1e-6 for name, value in requested_values.items()):
            raise CodedError("planner_refused", planner=self._server, limit=f"{limit:.2f}")
        if math.isinf(limit):
            rospy.delete_param(self._backup_parameter)
        self._applied_limit = limit

    def _set_parameters(self, values: Mapping[str, float]) -> Dict[str, float]:
        """Sets parameters of the planner; returns the planner's values afterwards."""
        config = Config(doubles=[DoubleParameter(name=name, value=value) for name, value in values.items()])
        request = ReconfigureRequest(config)
        answer = services.call(f"{self._server}/set_parameters", Reconfigure, request, self._server, TIMEOUT, TIMEOUT)
        return {entry.name: float(entry.value) for entry in answer.config.doubles if entry.name in self._names}
