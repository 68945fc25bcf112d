"""One robot that robot_monitor watches: its navigation, driver, goal and pose. Nothing here blocks."""

from __future__ import annotations

import itertools
import math
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

import numpy as np
import rospy
from actionlib_msgs.msg import GoalID, GoalStatusArray
from geometry_msgs.msg import Point
from move_base_msgs.msg import MoveBaseActionGoal
from nav_msgs.msg import Path

from vb_core import names
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.notices import Notice, Severity
from vb_core.geometry import Pose
from vb_core.ros import robot_profile
from vb_core.ros.messages import array_from_points, message_from_pose2d, points_from_array, pose2d_from_message
from vb_core.ros.transforms import TransformLookup
from vb_msgs.msg import DriverState, RobotStatus
from vb_robot.driving.command_gate import OTHER_PUBLISHER
from vb_robot.monitoring.goal_checker import GoalChecker, KnownBorder, border_values, is_inside_border
from vb_robot.monitoring.navigation_connections import PLANNERS, NavigationWiring
from vb_robot.monitoring.navigation_connections import find_move_base, find_wiring, resolve_name
from vb_robot.ros.goal_statuses import RUNNING_GOAL_STATUSES
from vb_robot.ros.planner_speed import PlannerSpeed

DRIVER_SILENCE = 3.0  # [s] after which a driver counts as gone; it reports twice a second
NAVIGATION_SILENCE = 2.0  # [s] after which navigation counts as gone; it sends its status five times a second
POSE_SILENCE = 3.0  # [s] without a message from localisation, after which the pose counts as unknown
MIN_REPORTED = 10.0  # [s] for which a refusal is reported, or longer if navigation still works on its goal
PATH_POINTS = 100  # approximate number of a path's points that are published
DEFAULT_RADIUS = 0.18  # [m] of a robot whose radius neither costmap nor profile gives


class WatchedRobot:
    """Collects what is connected to one robot, and sends it to goals through its navigation.

    Args:
        name: the robot's namespace; "" for the only robot.
        frame: its base frame.
        request_check: called with this robot when its goal must be checked.

    Attributes:
        goal: (x, y) [m] where it was last sent, map frame; None before.
        goal_statuses: the statuses of its navigation's goals, by id, from the newest message.
        refusal: the notice that says why its present goal is refused; None if it is not.
        speed: the speed limit of its local planner; None if that cannot be limited.
    """

    def __init__(
        self, name: str, frame: str, transforms: TransformLookup, request_check: Callable[[WatchedRobot], None]
    ) -> None:
        self.name, self.frame = name, frame
        self.wiring = NavigationWiring()
        self.pose: Optional[Pose] = None
        self.goal: Optional[Tuple[float, float]] = None
        self.goal_statuses: Dict[str, int] = {}
        self.refusal: Optional[Notice] = None
        self.speed: Optional[PlannerSpeed] = None
        self._goal_at = self._status_at = self._driver_heard_at = -math.inf
        self._in_control = False
        self._path = np.zeros((0, 2))
        self._maps: Dict[str, GridMap] = {}  # the newest ones, by layer
        self._borders: Sequence[KnownBorder] = ()
        self._goal_checker: Optional[GoalChecker] = None
        self._checked_radius: Optional[float] = None  # [m] for which the checker was made
        self._transforms, self._request_check = transforms, request_check
        self._ids = itertools.count()
        self._goals = rospy.Publisher(resolve_name(name, "move_base/goal"), MoveBaseActionGoal, queue_size=2)
        self._cancel = rospy.Publisher(resolve_name(name, "move_base/cancel"), GoalID, queue_size=2)
        self._path_subscriber: Optional[rospy.Subscriber] = None
        rospy.Subscriber(resolve_name(name, "move_base/goal"), MoveBaseActionGoal, self._on_goal, queue_size=5)
        rospy.Subscriber(resolve_name(name, "move_base/status"), GoalStatusArray, self._on_status, queue_size=1)

    # ------------------------------------------------------------- inputs
    def update_driver(self, message: DriverState, now: float) -> None:
        """Stores the driver's report, which arrived at time `now` [s]."""
        self._driver_heard_at = now
        self._in_control = message.code != OTHER_PUBLISHER

    def set_map(self, layer: str, grid: GridMap) -> None:
        """Stores a map: "physical", with all "borders", with only "robot_borders", or the driver's "keep_out"."""
        self._maps[layer] = grid
        self._request_another_check()

    def set_borders(self, borders: Sequence[KnownBorder]) -> None:
        """Stores the borders that are in force for this robot, from which refusals take their names."""
        self._borders = borders
        self._request_another_check()

    def _request_another_check(self) -> None:
        """Requests another check of the present goal, because a border may now be in its way."""
        if self.goal is not None and self._is_reported(rospy.get_time()):
            self._request_check(self)

    def _has_goal(self) -> bool:
        return any(status in RUNNING_GOAL_STATUSES for status in self.goal_statuses.values())

    def _is_reported(self, now: float) -> bool:
        return self._has_goal() or now - self._goal_at < MIN_REPORTED

    def update_wiring(self, graph: Any) -> None:
        """Updates the wiring from the ROS graph and the parameters of the robot's navigation."""
        node = find_move_base(graph, self.name)
        parameters = rospy.get_param(node, {}) if node else {}
        wiring = find_wiring(graph, self.name, parameters if isinstance(parameters, dict) else {})
        if (wiring.move_base, wiring.planner) != (self.wiring.move_base, self.wiring.planner):
            if self.speed is not None:
                self.speed.close()
            limits = PLANNERS.get(wiring.planner)
            self.speed = PlannerSpeed(f"{wiring.move_base}/{wiring.planner}", limits) if limits else None
        if wiring.path != self.wiring.path:
            if self._path_subscriber is not None:
                self._path_subscriber.unregister()
            self._path_subscriber = rospy.Subscriber(wiring.path, Path, self._on_path) if wiring.path else None
        self.wiring = wiring

    def update_pose(self) -> Optional[Pose]:
        """Looks up the robot's pose, stores it and returns it."""
        self.pose = self._transforms.pose_on_map(self.frame, POSE_SILENCE)
        return self.pose

    def is_driven(self) -> bool:
        """Returns whether the robot has a driver that is in control."""
        return self._has_driver() and self._in_control

    def _has_driver(self) -> bool:
        return 0.0 <= rospy.get_time() - self._driver_heard_at < DRIVER_SILENCE

    def _on_goal(self, message: MoveBaseActionGoal) -> None:
        goal = message.goal.target_pose
        x, y, _ = pose2d_from_message(goal.pose)
        try:
            frame = goal.header.frame_id.lstrip("/")
            position = self._transforms.lookup(names.MAP_FRAME, frame, rospy.Time(0)) @ [x, y, 0.0, 1.0]
        except CodedError:
            return  # navigation cannot transform it either
        self.goal = (float(position[0]), float(position[1]))
        self._path = np.zeros((0, 2))
        self.refusal = None
        self._goal_at = rospy.get_time()
        self._request_check(self)

    def _on_status(self, message: GoalStatusArray) -> None:
        self.goal_statuses = {entry.goal_id.id: entry.status for entry in message.status_list}
        self._status_at = rospy.get_time()

    def is_navigating(self) -> bool:
        """Returns whether the robot's navigation is connected, and has sent its status recently."""
        is_recent = 0.0 <= rospy.get_time() - self._status_at < NAVIGATION_SILENCE
        return is_recent and self._goals.get_num_connections() > 1  # one of them is the monitor itself

    def _on_path(self, message: Path) -> None:
        if message.header.frame_id.lstrip("/") == names.MAP_FRAME:
            points = array_from_points([entry.pose.position for entry in message.poses]).reshape(-1, 2)
            self._path = points[:: max(1, len(points) // PATH_POINTS)]

    # ------------------------------------------------------------- status and notices
    def status(self, stops: Optional[Sequence[str]]) -> RobotStatus:
        """Returns what is connected. `stops` are the stops that cancel the robot's goals; None if stops never do."""
        wiring = self.wiring
        obeys_stop = stops is not None and bool(wiring.move_base)
        goal = self.goal if self._has_goal() else None
        return RobotStatus(
            robot=self.name,
            frame=self.frame,
            move_base=wiring.move_base,
            maps=wiring.maps,
            missing_maps=wiring.missing_maps,
            unheard=wiring.unheard,
            plans_round_borders=wiring.plans_round_borders,
            driver=self.is_driven(),
            obeys_stop=obeys_stop,
            stops=stops if obeys_stop else (),
            obeys_speed=self.speed is not None and self.speed.obeys,
            localized=self.pose is not None,
            has_goal=goal is not None,
            goal=Point(*goal, 0.0) if goal else Point(),
            path=points_from_array(self._path) if goal else [],
        )

    def driving_maps(self) -> Tuple[Optional[GridMap], Optional[GridMap]]:
        """Returns the map with the borders for this robot, and the map without borders. A map not known yet is None.

        A robot with a name waits for its own map, because the common one also has the borders of other robots.
        """
        borders = "robot_borders" if self.name else "borders"
        return self._maps.get(borders), self._maps.get("physical")

    def _checked_map(self) -> Optional[GridMap]:
        """Returns the map on which goals and poses are checked: the robot's own, or the common one if there is none."""
        return self._maps.get("robot_borders", self._maps.get("borders"))

    def goal_checker(self) -> Optional[GoalChecker]:
        """Returns the checker of this robot's goals on the newest maps, or None until matching maps arrive."""
        grid = self._checked_map()
        physical = self._maps.get("physical")
        radius = self.wiring.radius
        plans_on_margin = any(topic.endswith(names.MAP_WITH_MARGIN) for topic in self.wiring.maps)
        if grid is not None and plans_on_margin:
            grid = self._maps.get("keep_out", grid)
        if grid is None or physical is None or not physical.same_geometry(grid):
            return None
        checker = self._goal_checker
        is_current = checker is not None and radius == self._checked_radius and checker.borders is self._borders
        if not is_current or checker.map_with_borders is not grid or checker.physical is not physical:
            inscribed_radius = radius or robot_profile.read_radius(self.name, DEFAULT_RADIUS)
            self._goal_checker = GoalChecker(grid, physical, inscribed_radius, self._borders)
            self._checked_radius = radius
        return self._goal_checker

    def check_goal(self, goal) -> Optional[Notice]:
        """Returns a notice that says why a goal (2,) [m] will be refused, or None if nothing is known against it."""
        checker = self.goal_checker()
        if checker is None:
            return None
        position = self.pose[:2] if self.pose else None
        refusal = checker.check(position, np.asarray(goal))
        if refusal is None:
            return None
        code, border = refusal
        return self.notice(code, Severity.WARNING, **border_values(border))

    def notices(self, now: float) -> List[Notice]:
        """Returns the notices about the robot's goal and position at time `now` [s]."""
        notices = []
        if self.refusal is not None and self._is_reported(now):
            notices.append(self.refusal)
        checker, pose = self.goal_checker(), self.pose
        if checker is not None and pose is not None and (self.wiring.move_base or self._has_driver()):
            # checked on the map without margins, as the map on which the robot plans may have them
            if is_inside_border(self._checked_map(), self._maps["physical"], pose[:2]):
                border = border_values(checker.name_at(pose[:2]))
                notices.append(self.notice("robot_caught_in_border", Severity.WARNING, **border))
        return notices

    def notice(self, code: str, severity: Severity, **values: str) -> Notice:
        """Makes a notice about this robot."""
        return Notice.of_robot(self.name, code, severity, **values)

    # ------------------------------------------------------------- requests to navigation
    def send_to(self, position) -> None:
        """Sends the robot to a position (2,) [m], with the yaw of the direction from its present position."""
        x, y = position
        yaw = math.atan2(y - self.pose[1], x - self.pose[0]) if self.pose else 0.0
        self.send_goal((x, y, yaw))

    def send_goal(self, pose: Pose, mark: str = "-") -> str:
        """Sends the robot to a pose. Returns the goal's id, which contains the mark."""
        now = rospy.Time.now()
        identity = f"{rospy.get_name()}{mark}{next(self._ids)}-{now.to_nsec()}"
        message = MoveBaseActionGoal(goal_id=GoalID(now, identity))
        message.header.stamp = message.goal.target_pose.header.stamp = now
        message.goal.target_pose.header.frame_id = names.MAP_FRAME
        message.goal.target_pose.pose = message_from_pose2d(*pose)
        self._goals.publish(message)
        rospy.loginfo("%s: %s is sent to x %.2f m, y %.2f m, yaw %.2f rad", rospy.get_name(), self.frame, *pose)
        return identity

    def cancel_goals(self, identity: str = "") -> None:
        """Cancels one goal of the robot's navigation, or all if no id is given."""
        self._cancel.publish(GoalID(id=identity))
