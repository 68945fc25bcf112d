"""Node: watches what is connected to robots, says why a goal is refused, sends robots to goals and to the spot."""

from __future__ import annotations

import functools
import math
import threading
from dataclasses import dataclass
from typing import Any, Dict, List, Optional, Tuple

import numpy as np
import rosgraph
import rospy

from vb_core import capabilities, names
from vb_core.errors import ParameterError
from vb_core.grid_map import GridMap
from vb_core.interaction_tables import state_by_name
from vb_core.notices import Notice, Severity
from vb_core.parameters import Parameters, param
from vb_core.ros import node, parameters, robot_profile
from vb_core.ros.master import read_graph
from vb_core.ros.messages import array_from_points, values_from_mapping
from vb_core.ros.notices import NoticePublisher
from vb_core.ros.robot_status import connections_from_message
from vb_core.ros.transforms import TransformLookup
from vb_core.stop_latch import HeldStops, new_id
from vb_core.zones import zone_by_number
from vb_msgs.msg import BorderProgress, DetectorStatus, DriverState, InteractionState, RobotStatusArray, Stop
from vb_msgs.msg import VirtualBorderArray
from vb_msgs.srv import SendRobot, SendRobotResponse
from vb_robot.dispatching.dispatcher import Dispatcher
from vb_robot.dispatching.viewpoint import DrawingState
from vb_robot.driving.workspace import lowest_speed_limit
from vb_robot.monitoring.navigation_connections import resolve_name
from vb_robot.ros.dispatched_robot import DispatchedRobot
from vb_robot.ros.subscriptions import keep_out_borders_for, subscribe_map, subscribe_spots
from vb_robot.ros.watched_robot import WatchedRobot
from vb_robot.spot_sightings import Sighting

CHECK_PERIOD = 0.2  # [s] between checks of poses and speed limits
DISPATCH_PERIOD = 0.25  # [s] between decisions of the dispatcher; the spot moves 0.1 m at most in that time
GRAPH_PERIOD = 2.0  # [s] between checks of the ROS graph, in wall time
STATUS_PERIOD = 1.0  # [s] between repetitions of the robots' status
SETTLING_TIME = 10.0  # [s] for which a fault must last before a notice says so, because a lab starts node by node
SLOW_DOWN_DISTANCE = 0.5  # [m] before a slow zone, where its limit is set; a planner can brake from 1 m/s within that
CANCEL_PERIOD = 0.5  # [s] between cancellations of goals that are sent again and again


@dataclass(frozen=True)
class RobotMonitorParams(Parameters):
    """The node's parameters."""

    robots: tuple = param((), doc="names of the robots, which are their namespaces; none: one without a namespace")
    frames: tuple = param((), doc="their base frames, in the same order; none: base_link, or NAME/base_link")
    interaction: bool = param(True, doc="whether an interaction manager belongs to this lab")
    dispatch: bool = param(False, doc="whether to send a robot to where its own camera sees the spot")
    obey: bool = param(False, doc="whether robots without a driver obey stop and slow zones, through navigation")

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(set(self.robots)) < len(self.robots):
            raise ParameterError("robots", f"expected each once, got {list(self.robots)}")
        if self.frames and len(self.frames) != len(self.robots or ("",)):
            raise ParameterError("frames", f"expected one for each robot, got {list(self.frames)}")


class RobotMonitorNode:
    """Watches robots with navigation of their own, whatever else is connected. With ~dispatch, sends one to the spot.

    Subscribed topics:
        /map, /virtual_borders/map, /<robot>/virtual_borders/map, /virtual_borders/speed_limits (nav_msgs/OccupancyGrid)
        [<robot>/]robot_driver/keep_out (nav_msgs/OccupancyGrid): if its navigation plans on it
        /virtual_borders/borders (vb_msgs/VirtualBorderArray): names, and for which robot each is
        /virtual_borders/drivers (vb_msgs/DriverState), /virtual_borders/detectors (vb_msgs/DetectorStatus)
        /virtual_borders/state (vb_msgs/InteractionState), /virtual_borders/stop (vb_msgs/Stop)
        /virtual_borders/spots (vb_msgs/LaserSpot), /virtual_borders/progress (vb_msgs/BorderProgress): with ~dispatch
        [<robot>/]camera_info (sensor_msgs/CameraInfo): what its camera sees of the floor, with ~dispatch
        [<robot>/]move_base/goal (move_base_msgs/MoveBaseActionGoal)
        [<robot>/]move_base/status (actionlib_msgs/GoalStatusArray)
        <planner>/plan (nav_msgs/Path): of the global planner
        <planner>/parameter_updates (dynamic_reconfigure/Config): of the local planner, whether its limit still holds
        /tf, /tf_static (tf2_msgs/TFMessage)
    Published topics:
        /virtual_borders/robots (vb_msgs/RobotStatusArray, latched)
        /virtual_borders/notices (vb_msgs/NoticeArray)
        [<robot>/]move_base/goal (move_base_msgs/MoveBaseActionGoal): for send_robot, and to see the spot
        [<robot>/]move_base/cancel (actionlib_msgs/GoalID)
    Services:
        /virtual_borders/send_robot (vb_msgs/SendRobot)
    Services called:
        <planner>/set_parameters (dynamic_reconfigure/Reconfigure): of the local planner, with ~obey
    Parameters:
        ~* RobotMonitorParams
        robot_profile: in each robot's namespace, with ~dispatch
        <move_base>/*: read only
    """

    def __init__(self, params: RobotMonitorParams) -> None:
        self._params = params
        node.wait_for_clock()
        self._lock = threading.RLock()
        self._stops = HeldStops()  # in memory only, because the manager keeps stops, and its state repeats them
        self._speed_limits: Optional[GridMap] = None
        self._has_slow_zones: Optional[bool] = None  # arrives with the borders, before the map of limits; None before
        self._cameras: Dict[str, None] = {}
        self._capabilities = capabilities.derive_capabilities(capabilities.Connections())
        self._faulty_since: Dict[Any, float] = {}
        self._logged: Tuple[Any, ...] = ()
        self._started = self._published_at = rospy.get_time()
        self._cancelled_at = -math.inf
        self._published: Any = None
        transforms = TransformLookup()
        self._goals_to_check = node.Queue()
        robots = params.robots or ("",)
        profiles = {name: robot_profile.read(name) for name in robots} if params.dispatch else {}
        bases = [profiles[name].frames.base if name in profiles else "base_link" for name in robots]
        usual_frames = [resolve_name(name, base)[1:] for name, base in zip(robots, bases)]
        check = self._goals_to_check.put
        self._robots: Dict[str, WatchedRobot] = {}
        for name, frame in zip(robots, params.frames or usual_frames):
            self._robots[name] = WatchedRobot(name, frame, transforms, check)
        self._dispatcher = Dispatcher({name: profile.radius for name, profile in profiles.items()})
        self._dispatched = {
            name: DispatchedRobot(self._robots[name], profile, transforms) for name, profile in profiles.items()
        }
        self._dispatch_lock = threading.Lock()  # guards the dispatcher
        self._dispatch_timer = node.WakeTimer(DISPATCH_PERIOD)
        self._notices = NoticePublisher()
        self._status = rospy.Publisher(names.ROBOTS, RobotStatusArray, queue_size=1, latch=True)
        self._subscribe()
        node.Worker(self._goals_to_check, self._check_goal)
        self._timer, self._graph_timer = node.WakeTimer(CHECK_PERIOD), node.WakeTimer(GRAPH_PERIOD)
        node.Worker(self._graph_timer, lambda _woken: self._update_wirings())
        node.Worker(self._timer, lambda _woken: self._check_robots())
        if params.dispatch:
            node.Worker(self._dispatch_timer, lambda _woken: self._dispatch())
        rospy.Service(names.SEND_ROBOT, SendRobot, self._on_send_robot)

    def _subscribe(self) -> None:
        everyone = list(self._robots.values())
        subscribe_map(names.PHYSICAL_MAP, functools.partial(self._on_map, "physical", everyone))
        subscribe_map(names.MAP_WITH_BORDERS, functools.partial(self._on_map, "borders", everyone))
        for robot in everyone:
            keep_out = resolve_name(robot.name, names.MAP_WITH_MARGIN)
            subscribe_map(keep_out, functools.partial(self._on_map, "keep_out", [robot]))
            if robot.name:
                robot_borders = resolve_name(robot.name, names.MAP_WITH_BORDERS[1:])
                subscribe_map(robot_borders, functools.partial(self._on_map, "robot_borders", [robot]))
        subscribe_map(names.SPEED_LIMITS, self._on_speed_limits)
        rospy.Subscriber(names.BORDERS, VirtualBorderArray, self._on_borders, queue_size=1)
        rospy.Subscriber(names.DRIVERS, DriverState, self._on_driver, queue_size=20)
        rospy.Subscriber(names.DETECTORS, DetectorStatus, self._on_detector, queue_size=20)
        rospy.Subscriber(names.STATE, InteractionState, self._on_state, queue_size=5)
        rospy.Subscriber(names.STOP, Stop, self._on_stop, queue_size=5, tcp_nodelay=True)
        if self._params.dispatch:
            subscribe_spots(self._on_spot)
            rospy.Subscriber(names.PROGRESS, BorderProgress, self._on_progress, queue_size=1)

    def close(self) -> None:
        """Restores the planners' usual speeds, and cancels dispatched robots' goals, as nobody would watch them."""
        for queue in (self._timer, self._graph_timer, self._goals_to_check, self._dispatch_timer):
            queue.close()
        for dispatched in self._dispatched.values():
            dispatched.set_goal(None)
        for robot in self._robots.values():
            speed = robot.speed
            if self._params.obey and speed is not None:
                speed.release()

    # ------------------------------------------------------------- callbacks
    def _on_map(self, layer: str, robots: List[WatchedRobot], grid: GridMap) -> None:
        with self._lock:
            for robot in robots:
                robot.set_map(layer, grid)

    def _on_speed_limits(self, grid: GridMap) -> None:
        self._speed_limits = grid

    def _on_borders(self, message: VirtualBorderArray) -> None:
        in_force = [zone_by_number(border.zone) for border in message.borders if border.in_force]
        self._has_slow_zones = any(zone.limits_speed for zone in in_force)
        with self._lock:
            for robot in self._robots.values():
                robot.set_borders(keep_out_borders_for(robot.name, message))

    def _on_driver(self, message: DriverState) -> None:
        if message.robot in self._robots:
            self._robots[message.robot].update_driver(message, rospy.get_time())

    def _on_detector(self, message: DetectorStatus) -> None:
        self._cameras[message.camera] = None

    def _on_state(self, message: InteractionState) -> None:
        self._stops.update_from_latch(message.stopped, message.stops)
        self._cancel_goals_while_stopped()
        with self._dispatch_lock:
            state = state_by_name(message.name)
            self._dispatcher.sightings.set_state(state, message.interaction_id, message.entered.to_sec())
        self._dispatch_timer.notify()  # the robots must stop at once when the state ends

    def _on_stop(self, message: Stop) -> None:
        self._stops.add(message.id or new_id())
        self._cancel_goals_while_stopped()

    # ------------------------------------------------------------- stops and speed limits, through navigation
    def _cancel_goals_while_stopped(self) -> None:
        """Repeatedly cancels the goals of robots without a driver while a stop is in force."""
        now = rospy.get_time()
        was_cancelled = 0.0 <= now - self._cancelled_at < CANCEL_PERIOD
        if self._params.obey and self._stops.stopped and not was_cancelled:
            self._cancelled_at = now
            for robot in self._robots.values():
                if not robot.is_driven():
                    robot.cancel_goals()

    def _speed_limit_at(self, robot: WatchedRobot) -> Optional[float]:
        """Returns the speed limit [m/s] at a robot. It is inf if there is none, and None while it is not known."""
        if robot.pose is None or self._has_slow_zones is None:
            return None
        if not self._has_slow_zones:
            return math.inf
        if self._speed_limits is None:
            return None
        reach = SLOW_DOWN_DISTANCE + (robot.wiring.radius or 0.0)
        return lowest_speed_limit(self._speed_limits, robot.pose[:2], reach)

    # ------------------------------------------------------------- dispatching
    def _on_spot(self, sighting: Sighting) -> None:
        with self._dispatch_lock:
            self._dispatcher.sightings.add(sighting)

    def _on_progress(self, message: BorderProgress) -> None:
        chain, points = array_from_points(message.chain), array_from_points(message.points)
        seed = array_from_points([message.seed])[0] if message.has_seed else None
        spot = points[-1] if len(points) else None
        drawing = DrawingState(spot, chain, closed=message.closed, seed=seed)
        with self._dispatch_lock:
            self._dispatcher.set_progress(message.interaction_id, drawing, message.cameras)

    def _dispatch(self) -> None:
        with self._dispatch_lock:
            robot_wanted = self._dispatcher.sightings.should_dispatch()
            statuses = {name: robot.status(robot_wanted) for name, robot in self._dispatched.items()}
            for name, robot in self._dispatched.items():
                self._dispatcher.maps[name].update(robot.view, *self._robots[name].driving_maps())
            for name, goal in self._dispatcher.decide(rospy.get_time(), statuses).items():
                self._dispatched[name].set_goal(goal)

    # ------------------------------------------------------------- goals
    def _check_goal(self, robot: WatchedRobot) -> None:
        goal = robot.goal
        if self._params.obey and self._stops.stopped and not robot.is_driven():
            robot.cancel_goals()
            refusal: Optional[Notice] = robot.notice("goal_while_stopped", Severity.WARNING)
        else:
            with self._lock:
                refusal = robot.check_goal(goal)
        if goal == robot.goal:
            robot.refusal = refusal
        self._publish_status()

    def _on_send_robot(self, request: Any) -> SendRobotResponse:
        """Sends a robot to a goal, or ends its drive, if that is possible. Otherwise the answer says why not."""
        robot = self._robots.get(request.robot)
        if robot is None:
            return _answer(False, Notice("robot_unknown", values={"who": request.robot}))
        if request.halt:
            robot.cancel_goals()
            return _answer(True, robot.notice("robot_drive_ended", Severity.INFO))
        goal = (request.goal.x, request.goal.y)
        if self._stops.stopped:
            refusal: Optional[Notice] = robot.notice("goal_while_stopped", Severity.WARNING)
        elif robot.name not in self._capabilities.sendable_robots or not np.isfinite(goal).all():
            refusal = robot.notice("robot_cannot_be_sent", Severity.WARNING)
        else:
            with self._lock:
                refusal = robot.check_goal(goal)
        if refusal is not None:
            return _answer(False, refusal)
        robot.send_to(goal)
        return _answer(True, robot.notice("robot_sent", Severity.INFO))

    # ------------------------------------------------------------- periodic checks
    def _update_wirings(self) -> None:
        try:
            graph = read_graph()
            for robot in self._robots.values():
                robot.update_wiring(graph)
        except (rosgraph.MasterException, OSError) as error:
            rospy.logwarn_throttle(10.0, f"{rospy.get_name()}: {error}")

    def _check_robots(self) -> None:
        for robot in self._robots.values():
            robot.update_pose()
            speed = robot.speed
            limit = self._speed_limit_at(robot)
            # while it is not known whether a planner's limit may be lifted, the planner keeps it
            if self._params.obey and speed is not None and limit is not None:
                speed.request_limit(limit)
        self._cancel_goals_while_stopped()
        self._publish_status()

    def _publish_status(self) -> None:
        """Publishes the notices, and what is connected, at once if that changes."""
        with self._lock:
            now = rospy.get_time()
            stops = self._stops.ids if self._params.obey else None
            robots = [robot.status(stops) for robot in self._robots.values()]
            message = RobotStatusArray(interaction=self._params.interaction, cameras=list(self._cameras), robots=robots)
            changed = (message.robots, message.cameras) != self._published
            is_due = not 0.0 <= now - self._published_at < STATUS_PERIOD
            if changed or is_due:
                self._published = (message.robots, message.cameras)
                self._published_at = now
                message.header.stamp = rospy.Time.from_sec(now)
                self._status.publish(message)
            self._capabilities = capabilities.derive_capabilities(connections_from_message(message))
            notices = self._find_lasting(self._capabilities.problems(), now)
            self._log(now)
            notices.extend(notice for robot in self._robots.values() for notice in robot.notices(now))
            dispatcher_notice = self._dispatcher.notice  # read once, because another thread may set it
            if dispatcher_notice is not None:
                notices.append(dispatcher_notice)
            self._notices.set(notices)

    def _find_lasting(self, faults: List[Notice], now: float) -> List[Notice]:
        """Returns the faults that have lasted for SETTLING_TIME."""
        keys = [(fault.code, fault.robot) for fault in faults]
        self._faulty_since = {key: min(self._faulty_since.get(key, now), now) for key in keys}
        lasting = {key for key, since in self._faulty_since.items() if now - since >= SETTLING_TIME}
        return [fault for fault, key in zip(faults, keys) if key in lasting]

    def _log(self, now: float) -> None:
        """Logs what is connected once the lab has started, and later its changes. Faults are notices instead."""
        lines = self._capabilities.robot_notices
        last_change = max([self._started, *self._faulty_since.values()])
        is_settling = now - last_change < SETTLING_TIME
        if is_settling or lines == self._logged:
            return
        for line in lines:
            if line not in self._logged and line.severity is Severity.INFO:
                rospy.loginfo("%s: %s", rospy.get_name(), line.sentence())
        self._logged = lines


def _answer(success: bool, notice: Notice) -> SendRobotResponse:
    return SendRobotResponse(success, notice.code, notice.sentence(), values_from_mapping(notice.values))


def build() -> RobotMonitorNode:
    """Reads the parameters and makes the node."""
    return RobotMonitorNode(parameters.read(RobotMonitorParams, "~"))
