"""Runs the lab of drives.py: move_base and AMCL as configured here, borders, goals, and the robot's true motion."""

import math
import os
import tempfile
import time
from collections import Counter, deque
from pathlib import Path
from typing import Any, Dict, Tuple

import numpy as np
import rosgraph
import rospy
import yaml
from geometry_msgs.msg import Point, Pose2D, PoseWithCovarianceStamped
from move_base_msgs.msg import RecoveryStatus
from nav_msgs.msg import Path as PathMessage
from std_msgs.msg import Float64

from bench.harness import TOP
from vb_core import names
from vb_core.child_processes import free_port, start_roslaunch
from vb_core.errors import CodedError
from vb_core.geometry import chain_length
from vb_core.grid_map import distance_transform
from vb_core.ros import messages, node, services
from vb_evaluation.navigation_check.move_base_goals import GoalOutcome, GoalRunner
from vb_evaluation.system_observer import SystemObserver
from vb_msgs.msg import DriverState, LabState, ParticipantState, VirtualBorder
from vb_msgs.srv import AddBorder, AddBorderRequest, RemoveBorder, RemoveBorderRequest
from vb_sim.world import load_world
from vb_testing import wait_until

PoseInDegrees = Tuple[float, float, float]  # (x, y, yaw) [m, m, deg]
Row = Dict[str, Any]  # of the table of drives
WORLDS = TOP / "src" / "vb_sim" / "worlds"
LIMIT_S = 120.0  # [s] of simulated time for a goal, twice the time for 10 m at the slower robot's 0.2 m/s
FASTEST = 4.0  # simulated seconds per real second; more than two slow cores achieve
SLOW = 0.5  # simulated seconds per real second while a border is added in front of the robot
STILL = 0.1  # [m] of motion below which a robot counts as standing


class Lab:
    """The running lab: borders, goals, and the robot's true motion."""

    def __init__(self, robot: str, start: PoseInDegrees, seed: int) -> None:
        state = Path(tempfile.mkdtemp(prefix="drives_"))
        base = WORLDS / {"turtlebot3_burger": "burger.yaml"}.get(robot, "lab.yaml")
        robots = yaml.safe_load(base.read_text())["robots"]
        robots[0]["start"] = [float(value) for value in start]
        path = state / "world.yaml"
        path.write_text(yaml.safe_dump({"name": base.stem, "like": str(WORLDS / "lab.yaml"), "robots": robots}))
        self.world = load_world(str(path))
        self.radius = self.world.robots[0].radius
        port, launch = free_port(), TOP / "bench" / "robots" / "drives.launch"
        os.environ.update({"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_LOG_DIR": str(state / "log")})
        arguments = {"world": path, "state": state, "robot_type": robot, "amcl": True, "seed": seed}
        arguments.update(zip(("x", "y", "yaw"), self.world.robots[0].start_pose()))
        self.child = start_roslaunch([launch], state / "roslaunch.txt", port, **arguments)
        wait_until(rosgraph.is_master_online, "the master")
        # waits for the parameters, because this node would use wall time without /use_sim_time
        wait_until(lambda: rosgraph.Master("/robot_drives").hasParam("/use_sim_time"), "roslaunch's parameters")
        rospy.init_node("robot_drives", anonymous=True, disable_signals=True, log_level=rospy.ERROR)
        self.observer = SystemObserver()
        self._pace = rospy.Publisher(names.PACE, Float64, queue_size=1, latch=True)
        self.set_slow(False)
        self.runner = GoalRunner()
        observer = self.observer
        wait_until(lambda: observer.posterior is not None and observer.lab is not None, f"maps, see {state}")
        self._truth = deque(maxlen=500)
        self._begin_measuring()
        self.plan = np.zeros((0, 2))
        self._participant = rospy.Publisher(names.PARTICIPANT, ParticipantState, queue_size=1, latch=True)
        self._subscribers = [
            rospy.Subscriber("/move_base/NavfnROS/plan", PathMessage, self._on_plan),
            rospy.Subscriber("/move_base/recovery_status", RecoveryStatus, self._on_recovery),
            rospy.Subscriber(names.LAB_STATE, LabState, self._on_lab),
            rospy.Subscriber("/amcl_pose", PoseWithCovarianceStamped, self._on_amcl),
            rospy.Subscriber(names.DRIVERS, DriverState, self._on_driver),
        ]

    def _begin_measuring(self) -> None:
        self._codes = Counter()
        self._recoveries = 0
        self._max_pose_error = 0.0
        self._stand = (rospy.get_time(), *self.pose()[:2])  # its start [s] and position [m]
        self._longest_stand = 0.0  # [s]

    def _on_lab(self, message) -> None:
        pose, now = message.robot_poses[0], message.header.stamp.to_sec()
        self._truth.append((now, pose.x, pose.y))
        if math.dist(self._stand[1:], (pose.x, pose.y)) > STILL:
            self._stand = now, pose.x, pose.y
        self._longest_stand = max(self._longest_stand, now - self._stand[0])

    def _on_plan(self, message) -> None:
        if len(message.poses) > 1:
            self.plan = messages.array_from_points([entry.pose.position for entry in message.poses])

    def _on_recovery(self, _message) -> None:
        self._recoveries += 1

    def _on_amcl(self, message) -> None:
        stamp, position = message.header.stamp.to_sec(), message.pose.pose.position
        truth = min(list(self._truth), key=lambda entry: abs(entry[0] - stamp), default=None)
        if truth is not None and abs(truth[0] - stamp) < 0.05:
            self._max_pose_error = max(self._max_pose_error, math.dist((position.x, position.y), truth[1:]))

    def _on_driver(self, message) -> None:
        self._codes[message.code] += 1

    def set_slow(self, slow: bool) -> None:
        """Lets simulated time run slowly, or as fast as possible."""
        self._pace.publish(SLOW if slow else FASTEST)

    def drive(self, goal: PoseInDegrees) -> Tuple[GoalOutcome, Row]:
        """Sends the robot to a goal; returns the outcome, and the values that every drive's row has."""
        start = time.monotonic()
        self._begin_measuring()
        driven = self.runner.drive((goal[0], goal[1], math.radians(goal[2])), LIMIT_S)
        return driven, {
            "goal": goal,
            "outcome": driven.outcome,
            "false_reports": driven.false_reports,
            "length_m": round(chain_length(driven.path), 2),
            "seconds": round(driven.seconds, 1),
            "wall_s": round(time.monotonic() - start, 1),
            "localized_m": round(self._max_pose_error, 3),
            "late": sum(n for code, n in self._codes.items() if code.endswith("_lost") or code == "clock_stopped"),
            "uncertain": self._codes["pose_uncertain"],
            "recoveries": self._recoveries,
            "still_s": round(self._longest_stand, 1),
            "entered_m": round(self.entered(driven.path), 3),
        }

    def pose(self) -> Tuple[float, float, float]:
        pose = self.observer.lab.robot_poses[0]
        return pose.x, pose.y, pose.theta

    def put_box(self, place) -> None:
        """Puts a round obstacle that is not on any map at a point (2,) [m]; None removes it."""
        x, y = (0.0, 0.0) if place is None else place
        state = ParticipantState(laser=Point(), person_present=place is not None, person=Pose2D(x, y, 0.0), doing="box")
        state.header.stamp = rospy.Time.now()
        self._participant.publish(state)

    def add(self, points, seed, closed) -> str:
        kind = VirtualBorder.POLYGON if closed else VirtualBorder.SEPARATING_CURVE
        *positions, seed_point = messages.points_from_array(np.array([*points, seed]))
        border = VirtualBorder(name="drive", kind=kind, occupancy=1.0, enabled=True, points=positions, seed=seed_point)
        previous = self.observer.posterior
        request = AddBorderRequest(border=border, source="bench")
        reply = services.call(names.ADD_BORDER, AddBorder, request, {"who": "map_integrator"})
        if not reply.success:
            raise CodedError(reply.code, reply.message)
        node.wait_until(lambda: self.observer.posterior is not previous, 10.0)
        return reply.id

    def remove(self, border: str) -> None:
        previous = self.observer.posterior
        services.call(names.REMOVE_BORDER, RemoveBorder, RemoveBorderRequest(id=border), {"who": "map_integrator"})
        node.wait_until(lambda: self.observer.posterior is not previous, 10.0)

    def entered(self, path) -> float:
        """Returns how far [m] the footprint entered the restricted area, minus 1.5 cells; 0 or less is permitted."""
        prior, posterior = self.observer.prior, self.observer.posterior
        restricted = posterior.data > np.maximum(prior.data, 0)
        if not len(path) or not restricted.any():
            return -math.inf
        cells = prior.world_to_cell(path)
        gap = distance_transform(restricted)[cells[:, 0], cells[:, 1]] * prior.resolution
        return float(self.radius - gap.min() - 1.5 * prior.resolution)
