"""Sends a robot to where its own camera sees the spot (paper, Sect. 4.2, states Border and Seed)."""

from __future__ import annotations

import functools
from collections import deque
from dataclasses import dataclass
from typing import Any, Callable, Deque, Mapping

import rospy

from vb_core import names
from vb_core.errors import ParameterError
from vb_core.parameters import Parameters, param
from vb_core.robot_profile import RobotProfile
from vb_core.ros import node, parameters, robot_profile
from vb_core.ros.messages import array_from_points
from vb_core.ros.notices import NoticePublisher
from vb_core.ros.transforms import TransformLookup
from vb_core.vocabulary import state_of
from vb_msgs.msg import BorderProgress, InteractionState
from vb_robot.dispatching.dispatcher import Dispatcher
from vb_robot.dispatching.robot_client import RobotClient
from vb_robot.inputs import subscribe_map, subscribe_spots

PERIOD = 0.25  # [s] between two decisions: the spot moves 0.1 m at most in that time


@dataclass(frozen=True)
class DispatcherParams(Parameters):
    """Which robots there are."""

    robots: list = param([], doc="names of the robots, which are their namespaces; empty: one without a namespace")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not all(isinstance(name, str) and name for name in self.robots) or len(set(self.robots)) < len(self.robots):
            raise ParameterError("robots", f"expected names of robots, each once, got {self.robots!r}")


class RobotDispatcherNode:
    """Watches spot and state, and sends goals to the navigation of one robot at a time.

    Subscribed topics:
        /virtual_borders/spots (vb_msgs/LaserSpot), /virtual_borders/state (vb_msgs/InteractionState)
        /virtual_borders/progress (vb_msgs/BorderProgress)
        /virtual_borders/map, /<robot>/virtual_borders/map, /map (nav_msgs/OccupancyGrid): where a robot may be, and
            what hides the spot
        [<robot>/]camera_info (sensor_msgs/CameraInfo): what its camera sees of the floor
        /tf, /tf_static (tf2_msgs/TFMessage): where the robots and their cameras are
    Published topics:
        /virtual_borders/notices (vb_msgs/NoticeArray): when no camera sees the spot, and what follows
    Actions called:
        [<robot>/]move_base (move_base_msgs/MoveBaseAction)
    Parameters:
        ~* DispatcherParams
        robot_profile: in each robot's namespace
    """

    def __init__(self, profiles: Mapping[str, RobotProfile]) -> None:
        self._dispatcher = dispatcher = Dispatcher({name: profile.radius for name, profile in profiles.items()})
        self._timer = node.WakeTimer(PERIOD)
        self._inputs: Deque[Callable[[], None]] = deque()  # for the worker, in the order in which they came
        transforms = TransformLookup()
        self._notices = NoticePublisher()
        self._robots = [RobotClient(name, profile, transforms) for name, profile in profiles.items()]
        grids = [
            (names.PHYSICAL_MAP, dispatcher.set_physical_map),
            *((f"{name}{names.MAP_WITH_BORDERS}", known.set_map) for name, known in dispatcher.maps.items()),
        ]
        self._subscribers = [
            *(subscribe_map(topic, functools.partial(self._queue_input, take)) for topic, take in grids),
            rospy.Subscriber(names.STATE, InteractionState, self._on_state, queue_size=10),
            subscribe_spots(functools.partial(self._queue_input, dispatcher.sightings.add)),
            rospy.Subscriber(
                names.PROGRESS, BorderProgress, functools.partial(self._queue_input, self._take_progress), queue_size=1
            ),
        ]
        self._worker = node.Worker(self._timer, lambda _woken: self._decide())

    def close(self) -> None:
        """Cancels every goal: nothing would supervise it any more."""
        self._timer.close()
        self._notices.close()
        for robot in self._robots:
            robot.set_goal(None)

    # ------------------------------------------------------------- what comes in; only the worker takes it in
    def _queue_input(self, take: Callable[..., None], *what: Any) -> None:
        self._inputs.append(functools.partial(take, *what))

    def _on_state(self, message: InteractionState) -> None:
        self._queue_input(self._take_state, message)
        self._timer.set()  # when the state ends the robots have to stop at once

    def _take_state(self, message: InteractionState) -> None:
        if self._dispatcher.sightings.set_state(
            state_of(message.name), message.interaction_id, message.entered.to_sec()
        ):
            rospy.loginfo("%s: state %s", rospy.get_name(), message.name)

    def _take_progress(self, message: BorderProgress) -> None:
        self._dispatcher.set_progress(
            message.interaction_id,
            array_from_points(message.chain),
            message.closed,
            array_from_points(message.points),
            message.cameras,
        )

    # ------------------------------------------------------------- decisions
    def _decide(self) -> None:
        while self._inputs:
            self._inputs.popleft()()
        for robot in self._robots:
            self._dispatcher.maps[robot.name].view = robot.view
        wanted = self._dispatcher.sightings.should_dispatch()
        robots = {robot.name: robot.status(wanted) for robot in self._robots}
        goals = self._dispatcher.decide(rospy.Time.now().to_sec(), robots)
        for robot in self._robots:
            robot.set_goal(goals[robot.name])
        self._notices.set([self._dispatcher.notice] if self._dispatcher.notice else [])


def build() -> RobotDispatcherNode:
    """Reads the parameters and makes the node."""
    watch = parameters.read(DispatcherParams, "~")
    return RobotDispatcherNode({name: robot_profile.read(name) for name in watch.robots or [""]})
