"""Drives a robot out of a border that was put where it stands, apart from deciding when that is due."""
from __future__ import annotations

import threading
import traceback
from typing import Callable, Optional

import rospy
from actionlib_msgs.msg import GoalID, GoalStatus, GoalStatusArray
from geometry_msgs.msg import Twist
from sensor_msgs.msg import LaserScan

from vb_core import names
from vb_core.grid_map import GridMap
from vb_core.ros.transforms import TransformLookup
from vb_msgs.msg import InteractionState
from vb_robot.leaving import LeaveParams, Leaving, Progress, WayOut
from vb_robot.safety import SafetyParams
from vb_robot.surroundings import Surroundings

_RUNNING = (GoalStatus.PENDING, GoalStatus.ACTIVE, GoalStatus.PREEMPTING, GoalStatus.RECALLING)
_STATUS_SILENCE = 2.0  # [s] without status navigation counts as gone
_CANCEL_EACH = 1.0  # [s]


class ExitDriver:
    """Publishes cmd_vel while a robot leaves a border, and only then.

    It waits while a border is drawn or a person leads the robot: then others drive. It calls off navigation's goals
    and waits until none runs any more.

    Args:
        who: what the robot is called in sentences.
        say: tells people a sentence.
    """

    def __init__(
        self,
        base_frame: str,
        robot_radius: float,
        action: str,
        rate: float,
        use_scan: bool,
        leave: LeaveParams,
        safety: SafetyParams,
        who: str,
        say: Callable[[str], None],
        transforms: TransformLookup,
    ) -> None:
        self._radius = robot_radius
        self._rate = rate
        self._params = leave
        self._safety = safety
        self._who = who
        self._say = say
        self._lock = threading.RLock()
        self._leaving: Optional[Leaving] = None
        self._border = ""
        self._gap: Callable[[object], float] = lambda place: float("inf")
        self._way_out: Optional[WayOut] = None
        self._state = InteractionState.DEFAULT
        self._status: Optional[GoalStatusArray] = None
        self._status_at = rospy.Time(0)
        self._cancelled_at: Optional[rospy.Time] = None
        self._refused_since: Optional[rospy.Time] = None
        self._driving = False
        self._told = False  # that it leaves
        self.given_up = False  # the last leaving ended with the robot still inside
        self._timer: Optional[rospy.Timer] = None
        self._surroundings = Surroundings(base_frame, safety, use_scan, 0.5, 0.6, transforms)
        self._cmd_vel = rospy.Publisher("cmd_vel", Twist, queue_size=1)
        self._cancel = rospy.Publisher(f"{action}/cancel", GoalID, queue_size=1)
        self._scans: Optional[rospy.Subscriber] = None
        self._subscribers = [
            rospy.Subscriber(names.STATE, InteractionState, self._on_state, queue_size=10),
            rospy.Subscriber(f"{action}/status", GoalStatusArray, self._on_status, queue_size=1),
        ]

    @property
    def active(self) -> bool:
        """Whether a robot is being driven out, or about to be."""
        return self._leaving is not None

    def begin(self, border: str) -> None:
        """Begins to leave a border; `set_maps` must have been called."""
        with self._lock:
            if self._leaving is not None:
                return
            self._leaving = Leaving(self._params, self._safety)
            self.given_up = self._told = False
            self._border = border
            self._refused_since = self._cancelled_at = None
            # scans cost time: heard only while they are needed
            self._scans = rospy.Subscriber("scan", LaserScan, self._surroundings.set_scan, queue_size=1)
            self._timer = rospy.Timer(rospy.Duration(1.0 / self._rate), self._on_timer, reset=True)

    def set_maps(self, posterior: GridMap, physical: GridMap, hard_gap: Callable[[object], float]) -> None:
        """Takes new maps, also on the way.

        Args:
            hard_gap: [m] from a place to the area that may not be entered.
        """
        way_out = WayOut(posterior, physical, self._radius, self._params, self._safety.map_margin)
        self._surroundings.set_map(physical)
        with self._lock:
            self._way_out, self._gap = way_out, hard_gap
            if self._leaving is not None:
                self._leaving.forget_route()

    def close(self) -> None:
        """Leaves the robot standing."""
        self._end(None)

    # ------------------------------------------------------------- callbacks: only store
    def _on_state(self, message: InteractionState) -> None:
        with self._lock:
            self._state = message.state

    def _on_status(self, message: GoalStatusArray) -> None:
        with self._lock:
            self._status, self._status_at = message, rospy.Time.now()

    # ------------------------------------------------------------- driving
    def _on_timer(self, _event: object) -> None:
        try:
            with self._lock:
                self._tick(rospy.Time.now())
        except rospy.ROSException:
            if not rospy.is_shutdown():
                raise
        except Exception:
            rospy.logerr_throttle(5.0, f"{rospy.get_name()}: {traceback.format_exc()}")
            self._end(f"{self._who} cannot leave {self._border}: an error in the program, see the log")

    def _tick(self, now: rospy.Time) -> None:
        leaving = self._leaving
        if leaving is None or self._way_out is None:
            return
        pose = self._surroundings.pose(now)
        if pose is not None and self._gap(pose[:2]) >= self._radius + self._params.margin:
            self._end(None)
            return
        if self._state != InteractionState.DEFAULT or not self._alone(now):
            self._halt()
            leaving.pause()
            return
        progress, motion = leaving.step(now.to_sec(), pose, lambda v, w: self._surroundings.free_way(now, v, w))
        if progress is Progress.LOST_WAY and pose is not None:
            route = self._way_out.route(pose[:2])
            if route is None:
                self._end(f"{self._who} cannot leave {self._border}: no way leads to allowed floor")
                return
            leaving.set_route(route)
            # one that only makes its margin wider is no news
            if not self._told and self._gap(pose[:2]) < self._radius:
                self._told = True
                self._say(f"{self._who} leaves {self._border} by itself")
        elif progress is Progress.GIVEN_UP:
            self._end(f"{self._who} gives up leaving {self._border}: {motion.reason}")
            return
        self._driving = True
        command = Twist()
        command.linear.x, command.angular.z = motion.v, motion.w
        self._cmd_vel.publish(command)

    def _alone(self, now: rospy.Time) -> bool:
        """Whether navigation does not drive; if it does, its goals are called off."""
        status = self._status
        if status is None or not -0.5 <= (now - self._status_at).to_sec() <= _STATUS_SILENCE:
            return True
        if not any(entry.status in _RUNNING for entry in status.status_list):
            self._refused_since = self._cancelled_at = None
            return True
        if self._refused_since is None:
            self._refused_since = now
            self._say(f"navigation's goal is called off: {self._who} leaves {self._border} first")
        elif (now - self._refused_since).to_sec() > self._params.patience:
            self._end(f"{self._who} gives up leaving {self._border}: navigation does not let go of its goal")
            return False
        if self._cancelled_at is None or abs((now - self._cancelled_at).to_sec()) >= _CANCEL_EACH:
            self._cancelled_at = now
            self._cancel.publish(GoalID())
        return False

    def _halt(self) -> None:
        self._told = False
        if self._driving:
            self._driving = False
            self._cmd_vel.publish(Twist())

    def _end(self, sentence: Optional[str]) -> None:
        with self._lock:
            self._halt()
            self._leaving = None
            self.given_up = sentence is not None
            if self._timer is not None:
                self._timer.shutdown()
                self._timer = None
            if self._scans is not None:
                self._scans.unregister()
                self._scans = None
        if sentence is not None:
            self._say(sentence)
