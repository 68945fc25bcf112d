"""Lets the robot follow the spot: while a person leads it (Guide), and while one draws with it alone."""
from __future__ import annotations

import traceback
from dataclasses import dataclass
from typing import Optional

import numpy as np
import rospy
from actionlib_msgs.msg import GoalID
from geometry_msgs.msg import Twist
from sensor_msgs.msg import LaserScan

from vb_core import names
from vb_core.errors import CodedError, ParameterError
from vb_core.parameters import Parameters, param
from vb_core.ros import parameters
from vb_core.ros.messages import OccupancyGridArray, grid_from_message
from vb_core.ros.transforms import TransformLookup
from vb_msgs.msg import BorderProgress, InteractionState, LaserSpot
from vb_robot.guiding import FOLLOW, Frames, Guiding, GuidingParams
from vb_robot.safety import SafetyParams
from vb_robot.servoing import Servo, ServoParams
from vb_robot.sightings import Sighting
from vb_robot.surroundings import Surroundings
from vb_robot.view import FloorView, ViewParams

SLOW_LOCALISATION = 0.15  # [s] for an older spot localisation's newest answer is taken: that is near enough
_GROUPS = ("servo", "safety", "view", "follow_in_border")


@dataclass(frozen=True)
class GuideParams(Parameters):
    """What only the node needs, beside `GuidingParams`."""

    base_frame: str = param("base_link")
    odom_frame: str = param("odom")
    rate: float = param(20.0, "1/s", low=10.0, high=20.0)
    use_scan: bool = param(True, doc="without a fresh scan the robot only turns")
    scan_timeout: float = param(0.5, "s", above=0.0, high=5.0)
    pose_timeout: float = param(0.6, "s", above=0.0, high=5.0, doc="localisation older than this is none")
    action: str = param("move_base", doc="navigation, called off when the guiding begins")


class RobotGuideNode:
    """Visual servoing on the spot seen by the robot's own camera.

    Subscribes:
        /virtual_borders/spots (vb_msgs/LaserSpot), /virtual_borders/state (vb_msgs/InteractionState),
        /virtual_borders/progress (vb_msgs/BorderProgress): which cameras have contributed, after a restart
        /virtual_borders/map (nav_msgs/OccupancyGrid): cells that the footprint never enters
        scan (sensor_msgs/LaserScan)
    Publishes:
        cmd_vel (geometry_msgs/Twist): only while it guides, and one zero when that ends
        move_base/cancel (actionlib_msgs/GoalID): once when the guiding begins
    Parameters:
        ~follow_in_border ("auto", true, false), ~* GuideParams and GuidingParams, ~servo/* ServoParams,
        ~safety/* SafetyParams, ~view/* ViewParams

    It guides in Guide, and in Border and Seed if people draw with the robot alone, see `Guiding`. As soon as a
    stationary camera sees the spot the robot is robot_dispatcher's.
    """

    def __init__(self, params: GuideParams, guiding: Guiding, safety: SafetyParams) -> None:
        self._params = params
        self._guiding = guiding
        self._last_tick = rospy.Time(0)
        self._reason = ""
        self._surroundings = Surroundings(
            params.base_frame, safety, params.use_scan, params.scan_timeout, params.pose_timeout, TransformLookup()
        )
        self._cmd_vel = rospy.Publisher("cmd_vel", Twist, queue_size=1)
        self._cancel = rospy.Publisher(f"{params.action}/cancel", GoalID, queue_size=1)
        self._subscribers = [
            rospy.Subscriber(names.VIRTUAL_MAP, OccupancyGridArray, self._on_map, queue_size=1),
            rospy.Subscriber("scan", LaserScan, self._surroundings.set_scan, queue_size=1),
            rospy.Subscriber(names.STATE, InteractionState, self._on_state, queue_size=10),
            rospy.Subscriber(names.SPOTS, LaserSpot, self._on_spot, queue_size=100),
            rospy.Subscriber(names.PROGRESS, BorderProgress, self._on_progress, queue_size=1),
        ]
        self._timer = rospy.Timer(rospy.Duration(1.0 / params.rate), self._on_timer, reset=True)

    def close(self) -> None:
        """Leaves the robot standing."""
        self._timer.shutdown()
        if self._guiding.active:
            self._cmd_vel.publish(Twist())

    # ------------------------------------------------------------- callbacks: only store
    def _on_map(self, message: OccupancyGridArray) -> None:
        try:
            self._surroundings.set_map(grid_from_message(message))
        except CodedError as error:
            rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: map refused: {error}")

    def _on_state(self, message: InteractionState) -> None:
        self._guiding.set_state(message.state, message.interaction_id, message.entered.to_sec())

    def _on_spot(self, message: LaserSpot) -> None:
        position = (message.position.x, message.position.y)
        if message.header.frame_id != names.MAP_FRAME or not np.isfinite(position).all():
            rospy.logwarn_throttle(
                5.0, f"{rospy.get_name()}: spot refused: frame '{message.header.frame_id}', position {position}; "
                f"expected finite values in '{names.MAP_FRAME}'")
            return
        self._guiding.add(Sighting(message.header.stamp.to_sec(), position, message.camera, message.mobile))

    def _on_progress(self, message: BorderProgress) -> None:
        self._guiding.contributed(message.interaction_id, message.cameras)

    # ------------------------------------------------------------- control
    def _on_timer(self, _event: object) -> None:
        try:
            self._tick()
        except rospy.ROSException:
            if not rospy.is_shutdown():
                raise
        except Exception:
            # whatever goes wrong here, the robot must not keep its last command, and the next tick may go well
            self._guiding.reset()
            self._cmd_vel.publish(Twist())
            rospy.logerr_throttle(5.0, f"{rospy.get_name()}: {traceback.format_exc()}")

    def _tick(self) -> None:
        now = rospy.Time.now()
        dt = (now - self._last_tick).to_sec()
        self._last_tick = now
        was = self._guiding.active
        frames = Frames(lambda stamp: self._odom_from_map(now, stamp), self._base_from_odom)
        motion = self._guiding.step(
            now.to_sec(), max(dt, 0.0), frames, lambda v, w: self._surroundings.free_way(now, v, w))
        if self._guiding.active and not was:
            # two drivers at one wheel: the person leads now
            self._cancel.publish(GoalID())
            rospy.loginfo("%s: follows the spot", rospy.get_name())
        if motion is None:
            return
        command = Twist()
        command.linear.x, command.angular.z = motion.v, motion.w
        self._cmd_vel.publish(command)
        if was and not self._guiding.active:
            rospy.loginfo("%s: ends", rospy.get_name())
        if motion.reason != self._reason:
            self._reason = motion.reason
            rospy.logdebug("%s: %s", rospy.get_name(), motion.reason)

    def _odom_from_map(self, now: rospy.Time, stamp: float) -> Optional[np.ndarray]:
        lookup, frame = self._surroundings.lookup, self._params.odom_frame
        T = lookup(frame, names.MAP_FRAME, rospy.Time.from_sec(stamp))
        if T is None and now.to_sec() - stamp > SLOW_LOCALISATION:
            T = lookup(frame, names.MAP_FRAME, rospy.Time(0), warn=True)
        return T

    def _base_from_odom(self) -> Optional[np.ndarray]:
        return self._surroundings.lookup(self._params.base_frame, self._params.odom_frame, rospy.Time(0), warn=True)


def build() -> RobotGuideNode:
    """Reads the parameters and makes the node."""
    follow = rospy.get_param("~follow_in_border", "auto")
    # YAML makes a bool of true and false
    word = str(follow).lower()
    if word not in FOLLOW:
        name = rospy.resolve_name("~follow_in_border")
        raise ParameterError(name, f"must be one of {', '.join(FOLLOW)}, got {follow!r}")
    own, shared = (tuple(cls.__dataclass_fields__) for cls in (GuideParams, GuidingParams))
    params = parameters.read(GuideParams, "~", ignore=(*_GROUPS, *shared))
    guiding = parameters.read(GuidingParams, "~", ignore=(*_GROUPS, *own))
    safety = parameters.read(SafetyParams, "~safety")
    servo = Servo(parameters.read(ServoParams, "~servo"), safety, FloorView(parameters.read(ViewParams, "~view")))
    return RobotGuideNode(params, Guiding(guiding, word, servo), safety)
