"""Lets the robot follow the spot: while a person leads it (Guide), and while one draws with it alone."""
from __future__ import annotations

import threading
import traceback
from collections import deque
from dataclasses import dataclass
from typing import Deque, Optional, Tuple

import numpy as np
import rospy
from actionlib_msgs.msg import GoalID
from geometry_msgs.msg import Twist
from sensor_msgs.msg import LaserScan

from vb_core import geometry, names
from vb_core.errors import CodedError, ParameterError
from vb_core.parameters import Parameters, param
from vb_core.ros import parameters
from vb_core.ros.messages import OccupancyGridArray, grid_from_message
from vb_core.ros.transforms import TransformLookup
from vb_msgs.msg import BorderProgress, InteractionState, LaserSpot
from vb_robot import sightings
from vb_robot.safety import SafetyParams
from vb_robot.servoing import Servo, ServoParams
from vb_robot.surroundings import Surroundings
from vb_robot.view import FloorView, ViewParams

_GROUPS = ("servo", "safety", "view", "follow_in_border")


@dataclass(frozen=True)
class GuideParams(Parameters):
    """The node's own parameters."""

    camera: str = param("robot", doc="name of this robot's camera in the spots")
    base_frame: str = param("base_link")
    odom_frame: str = param("odom")
    rate: float = param(20.0, "1/s", low=10.0, high=20.0)
    auto_wait: float = param(1.0, "s", low=0.0, high=10.0, doc="for a stationary camera to see the spot too")
    use_scan: bool = param(True, doc="without a fresh scan the robot only turns")
    scan_timeout: float = param(0.5, "s", above=0.0, high=5.0)
    pose_timeout: float = param(0.6, "s", above=0.0, high=5.0, doc="localisation older than this is none")
    action: str = param("move_base", doc="navigation, called off when the guiding begins")
    mobile_cameras: tuple = param(("robot",), doc="names of cameras on robots")


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
        ~follow_in_border ("auto", true, false), ~* GuideParams, ~servo/* ServoParams, ~safety/* SafetyParams,
        ~view/* ViewParams

    It guides in Guide always. In Border and Seed it does with follow_in_border true, and with "auto" if no stationary
    camera has seen the spot in this interaction: the system is then the paper's baseline, the robot alone. As soon
    as a stationary camera sees the spot the robot is robot_dispatcher's. Of several robots only the one follows whose
    camera has seen the spot longest.
    """

    def __init__(
        self, params: GuideParams, follow_in_border: str, servo: ServoParams, safety: SafetyParams, view: ViewParams
    ) -> None:
        self._params = params
        self._follow = follow_in_border
        self._servo = Servo(servo, safety, FloorView(view))
        self._lock = threading.Lock()
        self._sightings = sightings.Sightings(mobile_cameras=(*params.mobile_cameras, params.camera))
        self._pending: Deque[Tuple[rospy.Time, Tuple[float, float]]] = deque(maxlen=10)
        self._spot: Optional[Tuple[rospy.Time, np.ndarray]] = None  # (2,) [m] in the odom frame
        self._active = False
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
        if self._active:
            self._cmd_vel.publish(Twist())

    # ------------------------------------------------------------- callbacks: only store
    def _on_map(self, message: OccupancyGridArray) -> None:
        try:
            self._surroundings.set_map(grid_from_message(message))
        except CodedError as error:
            rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: map refused: {error}")

    def _on_state(self, message: InteractionState) -> None:
        with self._lock:
            if self._sightings.set_state(message.state, message.interaction_id, message.entered.to_sec()):
                self._pending.clear()

    def _on_spot(self, message: LaserSpot) -> None:
        position = (message.position.x, message.position.y)
        if message.header.frame_id != names.MAP_FRAME or not np.isfinite(position).all():
            rospy.logwarn_throttle(
                5.0, f"{rospy.get_name()}: spot refused: frame '{message.header.frame_id}', position {position}; "
                f"expected finite values in '{names.MAP_FRAME}'")
            return
        stamp = message.header.stamp
        with self._lock:
            self._sightings.add(sightings.Sighting(stamp.to_sec(), position, message.camera, message.mobile))
            if message.mobile and message.camera == self._params.camera:
                self._pending.append((stamp, position))

    def _on_progress(self, message: BorderProgress) -> None:
        with self._lock:
            if message.interaction_id == self._sightings.key[0]:
                self._sightings.contributed(message.cameras)

    # ------------------------------------------------------------- control
    def _on_timer(self, _event: object) -> None:
        try:
            self._tick()
        except rospy.ROSException:
            if not rospy.is_shutdown():
                raise
        except Exception:
            # whatever goes wrong here, the robot must not keep its last command, and the next tick may go well
            self._servo.reset()
            self._cmd_vel.publish(Twist())
            rospy.logerr_throttle(5.0, f"{rospy.get_name()}: {traceback.format_exc()}")

    def _tick(self) -> None:
        now = rospy.Time.now()
        dt = (now - self._last_tick).to_sec()
        self._last_tick = now
        active = self._wanted(now)
        if not active:
            if self._active:
                self._active = False
                self._servo.reset()
                self._cmd_vel.publish(Twist())
                rospy.loginfo("%s: ends", rospy.get_name())
            return
        if not self._active:
            self._active = True
            self._servo.reset()
            self._spot = None
            # two drivers at one wheel: the person leads now
            self._cancel.publish(GoalID())
            rospy.loginfo("%s: follows the spot", rospy.get_name())
        spot, age = self._spot_in_base(now)
        motion = self._servo.step(dt if dt > 0 else 0.0, spot, age, lambda v, w: self._surroundings.free_way(now, v, w))
        command = Twist()
        command.linear.x, command.angular.z = motion.v, motion.w
        self._cmd_vel.publish(command)
        if motion.reason != self._reason:
            self._reason = motion.reason
            rospy.logdebug("%s: %s", rospy.get_name(), motion.reason)

    def _wanted(self, now: rospy.Time) -> bool:
        with self._lock:
            known = self._sightings
            known.forget_after(now.to_sec())
            if known.leader(now.to_sec()) not in (None, self._params.camera):
                return False
            if known.state == sightings.GUIDE:
                return True
            if known.state not in (sightings.BORDER, sightings.SEED) or self._follow == "false":
                return False
            if self._follow == "true":
                return True
            if known.stationary_seen or known.first_mobile is None:
                return False
            return now.to_sec() - known.first_mobile >= self._params.auto_wait

    def _spot_in_base(self, now: rospy.Time) -> Tuple[Optional[np.ndarray], float]:
        """((2,) [m] where the spot is in the base frame now, its age [s]).

        The spot is kept in the odom frame: there it stays where it is on the floor while the robot moves, and a
        jump of the localisation does not move it.
        """
        params = self._params
        with self._lock:
            waiting = list(self._pending)
        for stamp, position in reversed(waiting):
            T = self._lookup(params.odom_frame, names.MAP_FRAME, stamp)
            if T is None and (now - stamp).to_sec() > 0.15:
                # localisation is slow: its newest answer is near enough
                T = self._lookup(params.odom_frame, names.MAP_FRAME, rospy.Time(0), warn=True)
            if T is not None:
                self._spot = (stamp, geometry.apply(T, np.array([*position, 0.0]))[:2])
                with self._lock:
                    while self._pending and self._pending[0][0] <= stamp:
                        self._pending.popleft()
                break
        if self._spot is None:
            return None, 0.0
        T = self._lookup(params.base_frame, params.odom_frame, rospy.Time(0), warn=True)
        if T is None:
            return None, 0.0
        stamp, place = self._spot
        # a clock that differs by a little must not make the spot come from the future
        age = (now - stamp).to_sec()
        return geometry.apply(T, np.array([*place, 0.0]))[:2], max(age, 0.0) if age > -0.1 else age

    def _lookup(self, target: str, source: str, stamp: rospy.Time, warn: bool = False) -> Optional[np.ndarray]:
        return self._surroundings.lookup(target, source, stamp, warn)


def build() -> RobotGuideNode:
    """Reads the parameters and makes the node."""
    follow = rospy.get_param("~follow_in_border", "auto")
    # YAML makes a bool of true and false
    word = str(follow).lower()
    if word not in ("auto", "true", "false"):
        name = rospy.resolve_name("~follow_in_border")
        raise ParameterError(name, f"must be one of auto, true, false, got {follow!r}")
    return RobotGuideNode(
        parameters.read(GuideParams, "~", ignore=_GROUPS),
        word,
        parameters.read(ServoParams, "~servo"),
        parameters.read(SafetyParams, "~safety"),
        parameters.read(ViewParams, "~view"),
    )
