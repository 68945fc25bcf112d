"""Sends a robot to where its own camera sees the spot (paper, Sect. 4.2, states Border and Seed)."""
from __future__ import annotations

import threading
import traceback
from dataclasses import dataclass, replace
from typing import Optional, Tuple

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped

from vb_core import geometry, names
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.parameters import Parameters, param
from vb_core.ros import parameters
from vb_core.ros.messages import OccupancyGridArray, array_from_points, grid_from_message, pose_from_2d
from vb_core.ros.transforms import TransformLookup
from vb_msgs.msg import BorderProgress, InteractionState, LaserSpot
from vb_robot import sightings
from vb_robot.dispatch import DispatchParams, DispatchPolicy, Kind, Situation
from vb_robot.navigation_client import NavigationClient
from vb_robot.terrain import Terrain, TerrainParams
from vb_robot.view import FloorView, ViewParams
from vb_robot.viewpoint import Drawing, Pose, Viewpoint, ViewpointParams, keeps_off, rank_viewpoints, shows_spot

_GROUPS = ("dispatch", "viewpoint", "view", "terrain")


@dataclass(frozen=True)
class DispatcherParams(Parameters):
    """The node's own parameters."""

    base_frame: str = param("base_link", doc="of the robot; with its prefix if it has one")
    action: str = param("move_base", doc="relative to the node's namespace")
    period: float = param(0.25, "s", low=0.05, high=5.0, doc="between two decisions")
    way_check: float = param(0.5, "s", low=0.0, doc="between two looks at the way to the present goal")
    lost_speed: float = param(0.3, "m/s", low=0.0, high=2.0, doc="a spot that nobody sees has moved on like this")
    lost_distance: float = param(0.5, "m", low=0.0, high=2.0, doc="but not farther than this")
    server_silence: float = param(2.0, "s", above=0.0, doc="without status the action server counts as gone")
    mobile_cameras: tuple = param(("robot",), doc="names of cameras on robots")


class RobotDispatcherNode:
    """Watches spot and state, and gives goals to navigation.

    Subscribes:
        /virtual_borders/spots (vb_msgs/LaserSpot), /virtual_borders/state (vb_msgs/InteractionState),
        /virtual_borders/progress (vb_msgs/BorderProgress),
        /virtual_borders/map, /map (nav_msgs/OccupancyGrid): where the robot may stand, what hides the spot
    Publishes:
        ~viewpoint (geometry_msgs/PoseStamped, latched): where the robot was sent last
    Action client:
        move_base (move_base_msgs/MoveBaseAction)
    Parameters:
        ~* DispatcherParams, ~dispatch/* DispatchParams, ~viewpoint/* ViewpointParams, ~view/* ViewParams,
        ~terrain/* TerrainParams

    A goal is given only after a stationary camera saw the spot in this interaction: with none of them the person
    leads the robot (see robot_guide_node). From then on every camera's spots tell where the spot is.
    """

    def __init__(
        self,
        params: DispatcherParams,
        dispatch: DispatchParams,
        viewpoint: ViewpointParams,
        view: ViewParams,
        terrain: TerrainParams,
    ) -> None:
        self._params = params
        self._dispatch = dispatch
        self._viewpoint = viewpoint
        self._terrain_params = terrain
        self._view = FloorView(view)
        self._policy = DispatchPolicy(dispatch)
        self._lock = threading.Lock()
        self._sightings = sightings.Sightings(mobile_cameras=params.mobile_cameras)
        self._progress: Optional[BorderProgress] = None
        self._map: Optional[GridMap] = None
        self._physical: Optional[GridMap] = None
        self._terrain: Optional[Terrain] = None
        self._judged: Optional[Viewpoint] = None  # whose way was looked at last, when, and what came out
        self._judged_at = 0.0
        self._way_safe = True
        self._refused_spots = 0
        self._last_reason = ""
        self._transforms = TransformLookup()
        self._navigation = NavigationClient(params.action, params.server_silence)
        self._viewpoint_publisher = rospy.Publisher("~viewpoint", PoseStamped, queue_size=1, latch=True)
        self._subscribers = [
            rospy.Subscriber(names.VIRTUAL_MAP, OccupancyGridArray, self._on_map, queue_size=1),
            rospy.Subscriber(names.PHYSICAL_MAP, OccupancyGridArray, self._on_physical_map, queue_size=1),
            rospy.Subscriber(names.STATE, InteractionState, self._on_state, queue_size=10),
            rospy.Subscriber(names.SPOTS, LaserSpot, self._on_spot, queue_size=100),
            rospy.Subscriber(names.PROGRESS, BorderProgress, self._on_progress, queue_size=1),
        ]
        self._timer = rospy.Timer(rospy.Duration(params.period), self._on_timer, reset=True)

    def close(self) -> None:
        """Calls off the goal: nobody would watch over it any more."""
        self._timer.shutdown()
        self._navigation.cancel()

    # ------------------------------------------------------------- callbacks: only store
    def _on_map(self, message: OccupancyGridArray) -> None:
        self._store_map(message, "_map")

    def _on_physical_map(self, message: OccupancyGridArray) -> None:
        self._store_map(message, "_physical")

    def _store_map(self, message: OccupancyGridArray, where: str) -> None:
        try:
            grid = grid_from_message(message)
        except CodedError as error:
            rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: map refused: {error}")
            return
        with self._lock:
            setattr(self, where, grid)
            self._terrain = None

    def _on_state(self, message: InteractionState) -> None:
        with self._lock:
            if self._sightings.set_state(message.state, message.interaction_id, message.entered.to_sec()):
                rospy.loginfo("%s: state %s", rospy.get_name(), message.name)

    def _on_spot(self, message: LaserSpot) -> None:
        position = (message.position.x, message.position.y)
        if message.header.frame_id != names.MAP_FRAME or not np.isfinite(position).all():
            self._refused_spots += 1
            rospy.logwarn_throttle(
                5.0, f"{rospy.get_name()}: spot refused: frame '{message.header.frame_id}', position {position}; "
                f"expected finite values in '{names.MAP_FRAME}' ({self._refused_spots} so far)")
            return
        sighting = sightings.Sighting(message.header.stamp.to_sec(), position, message.camera, message.mobile)
        with self._lock:
            self._sightings.add(sighting)

    def _on_progress(self, message: BorderProgress) -> None:
        with self._lock:
            self._progress = message

    # ------------------------------------------------------------- decisions
    def _on_timer(self, _event: object) -> None:
        try:
            self._decide()
        except CodedError as error:
            rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: {error}")
        except rospy.ROSException:
            if not rospy.is_shutdown():
                raise
        except Exception:
            # a timer whose callback fails would never call again, and nobody would notice
            rospy.logerr_throttle(5.0, f"{rospy.get_name()}: {traceback.format_exc()}")

    def _decide(self) -> None:
        now = rospy.Time.now().to_sec()
        server = self._navigation.alive()
        drawing, gone_on, wanted, key = self._gather(now)
        robot = self._robot_pose() if wanted else None
        if server and self._navigation.cancel_leftovers():
            rospy.logwarn("%s: called off a goal that was left from before a restart", rospy.get_name())
        terrain = self._prepared_terrain() if wanted else None
        if drawing is not None and terrain is not None and drawing.direction is not None and gone_on > 0.0:
            drawing = replace(drawing, spot=_thought_on(terrain, drawing.spot, drawing.direction, gone_on))
        spot = (float(drawing.spot[0]), float(drawing.spot[1])) if drawing is not None and terrain is not None else None
        goal = self._policy.goal

        def fit(pose: Pose) -> bool:
            assert terrain is not None and drawing is not None
            if goal is not None and pose == goal.pose and not terrain.stands_free(np.array([pose[:2]]))[0]:
                return False
            return shows_spot(terrain, self._view, pose, drawing, self._viewpoint)

        def rank():
            assert terrain is not None and drawing is not None and robot is not None
            return rank_viewpoints(terrain, self._view, robot, drawing, self._viewpoint)

        def safe(viewpoint: Viewpoint) -> bool:
            assert terrain is not None and drawing is not None and robot is not None
            if viewpoint.risky and not drawing.seeding:
                return True
            # the search is too dear for every decision
            if viewpoint is not self._judged or not 0.0 <= now - self._judged_at < self._params.way_check:
                self._judged, self._judged_at = viewpoint, now
                self._way_safe = keeps_off(terrain, robot, viewpoint.pose, drawing, self._viewpoint)
            return self._way_safe

        situation = Situation(now, wanted, key, spot, robot, server, self._navigation.status())
        decision = self._policy.step(situation, fit, rank, safe)
        if decision.kind is Kind.CANCEL:
            self._navigation.cancel()
        elif decision.kind is Kind.SEND and decision.viewpoint is not None:
            self._send(decision.viewpoint.pose)
        if decision.reason != self._last_reason:
            self._last_reason = decision.reason
            rospy.loginfo("%s: %s: %s", rospy.get_name(), decision.kind.value, decision.reason)

    def _gather(self, now: float) -> Tuple[Optional[Drawing], float, bool, Tuple[str, int]]:
        """(what is being drawn, how far its spot has gone on unseen [m], whether a robot is wanted, the key)."""
        with self._lock:
            known, progress = self._sightings, self._progress
            known.forget_after(now)
            key = known.key
            if progress is not None and progress.interaction_id != key[0]:
                progress = None
            if progress is not None:
                known.contributed(progress.cameras)
            wanted = known.state in (sightings.BORDER, sightings.SEED) and known.stationary_seen
            target = known.target(self._dispatch.min_sightings) if wanted else None
            direction = known.direction() if target is not None else None
            watched = known.watched(now)
            gone_on = known.gone_on(now, self._params.lost_speed, self._params.lost_distance)
        if target is None:
            return None, 0.0, wanted, key
        chain, closed, ordered = np.zeros((0, 2)), False, True
        if progress is not None:
            chain, closed = array_from_points(progress.chain), bool(progress.closed)
            if len(chain) < 2:
                chain, closed, ordered = array_from_points(progress.points), False, False
        drawing = Drawing(target, chain, direction, closed, key[1] == sightings.SEED, ordered, watched)
        return drawing, gone_on, wanted, key

    def _robot_pose(self) -> Optional[Pose]:
        try:
            T = self._transforms.lookup(names.MAP_FRAME, self._params.base_frame, rospy.Time(0), timeout_s=0.0)
        except CodedError as error:
            rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: the robot is not localised: {error}")
            return None
        return geometry.transform_pose2d(T)

    def _prepared_terrain(self) -> Optional[Terrain]:
        with self._lock:
            terrain, grid, physical = self._terrain, self._map, self._physical
        if terrain is not None or grid is None:
            return terrain
        terrain = Terrain(grid, self._terrain_params, physical)
        with self._lock:
            # a map that came meanwhile makes the next call prepare again
            if self._map is grid and self._physical is physical:
                self._terrain = terrain
        return terrain

    def _send(self, pose: Pose) -> None:
        self._navigation.send(pose)
        message = PoseStamped()
        message.header.stamp = rospy.Time.now()
        message.header.frame_id = names.MAP_FRAME
        message.pose = pose_from_2d(*pose)
        self._viewpoint_publisher.publish(message)
        rospy.loginfo("%s: sent to x %.2f m, y %.2f m, yaw %.2f rad", rospy.get_name(), *pose)


def _thought_on(terrain: Terrain, spot: np.ndarray, direction: np.ndarray, distance: float) -> np.ndarray:
    """(2,) [m] a spot (2,) moved on along a unit vector (2,), but not into a wall."""
    room = float(np.linalg.norm(terrain.ray_end(spot, direction) - spot)) - 0.05
    return spot + min(distance, max(0.0, room)) * direction


def build() -> RobotDispatcherNode:
    """Reads the parameters and makes the node."""
    return RobotDispatcherNode(
        parameters.read(DispatcherParams, "~", ignore=_GROUPS),
        parameters.read(DispatchParams, "~dispatch"),
        parameters.read(ViewpointParams, "~viewpoint"),
        parameters.read(ViewParams, "~view"),
        parameters.read(TerrainParams, "~terrain"),
    )
