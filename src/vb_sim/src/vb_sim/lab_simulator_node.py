"""Node: publishes simulated time and the ground truth of the lab."""

from __future__ import annotations

import math
import threading
import time
import warnings
from dataclasses import dataclass
from typing import List

import numpy as np
import rospy
import tf2_ros
from geometry_msgs.msg import Pose2D, PoseWithCovarianceStamped, TransformStamped, Twist
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Float64, Header
from tf2_msgs.msg import TFMessage

from vb_core import geometry, names
from vb_core.errors import ParameterError
from vb_core.parameters import Parameters, param
from vb_core.ros import messages, parameters
from vb_msgs.msg import LabState, ParticipantState
from vb_sim.model_params import load_models
from vb_sim.world import Robot, load_world
from vb_sim.simulated_lab import SimulatedLab, Lockstep

MIN_PACE, MAX_PACE = 0.1, 20.0  # simulated seconds per real second
RATE = 50.0  # [1/s] steps of simulated time; an integral multiple of the cameras' 25 frames/s
POSE_STEPS = 2  # steps between two odom and tf messages: 25 Hz, one per camera frame
SCAN_STEPS = 5  # steps between two scans: 10 Hz, as from small scanners
AMCL_STEPS = 25  # steps between two amcl_pose: 2 Hz, about AMCL's rate while driving
TRANSFORM_TOLERANCE = 0.1  # [s] how far ahead map -> odom is stamped, as by AMCL's default
PARTICIPANT_SILENCE = 0.5  # [s] of silence after which the participant is assumed to stand still with the laser off
# steps in which navigation, driver and AMCL each publish once; 0.1 s is the period of move_base's controller
CONTROL_STEPS = 5


@dataclass(frozen=True)
class LabSimulatorParams(Parameters):
    """The node's parameters. The models' are in config/models.yaml."""

    world: str = param("")
    seed: int = param(1, "", low=0)
    localizes: bool = param(True)
    lockstep: bool = param(False)


class RobotConnection:
    """The publishers of one robot. If it has a namespace, that precedes the names of its frames and topics."""

    def __init__(self, robot: Robot) -> None:
        prefix = f"{robot.namespace.strip('/')}/".lstrip("/")
        self.topic = topic = f"/{prefix}"
        self.odom_frame, self.base_frame = prefix + "odom", prefix + "base_link"
        self.laser_frame = prefix + "base_laser_link"
        self.odom = rospy.Publisher(topic + "odom", Odometry, queue_size=5)
        self.amcl = rospy.Publisher(topic + "amcl_pose", PoseWithCovarianceStamped, queue_size=1, latch=True)
        self.scan = rospy.Publisher(topic + "scan", LaserScan, queue_size=2)


class LabSimulatorNode:
    """Moves the robots, and publishes the ground truth of the lab and the clock.

    /clock runs in real time, or as fast as /sim/pace says, but slower on a slow computer. /use_sim_time must be set. A
    robot's topics are in its namespace; the first robot usually has none.

    Subscribed topics:
        <robot>/cmd_vel (geometry_msgs/Twist)
        <robot>/cmd_vel/navigation (geometry_msgs/Twist), /tf (tf2_msgs/TFMessage): of the first robot, with ~lockstep
        /sim/participant (vb_msgs/ParticipantState)
        /sim/pace (std_msgs/Float64): maximum of simulated seconds per real second, 1 by default; for drives without
            people and cameras
    Published topics:
        /clock (rosgraph_msgs/Clock): 50 Hz
        /sim/lab_state (vb_msgs/LabState): 50 Hz, ground truth
        <robot>/odom (nav_msgs/Odometry), /tf (tf2_msgs/TFMessage): map -> odom -> base_link, 25 Hz
        <robot>/scan (sensor_msgs/LaserScan): 10 Hz, only while it has subscribers
        <robot>/amcl_pose (geometry_msgs/PoseWithCovarianceStamped, latched): 2 Hz
        /tf_static (tf2_msgs/TFMessage): base_link -> base_laser_link
    Parameters:
        config/lab_simulator.yaml
    """

    def __init__(self, lab: SimulatedLab, params: LabSimulatorParams) -> None:
        self._lab = lab
        self._params = params
        self._lock = threading.Lock()
        self._step_ns = int(round(1e9 / RATE))
        # a whole number of steps, so that camera frames coincide with steps if the camera's rate divides RATE
        self._now_ns = time.time_ns() // self._step_ns * self._step_ns
        self._count = 0
        lab.step(0.0, self._now_ns * 1e-9)
        self._participant = ParticipantState()
        self._participant_time = -math.inf
        self._clock = make_clock_publisher()
        # each topic has a short queue, so that a slow or hung subscriber does not stop the lab
        self._lab_state = rospy.Publisher(names.LAB_STATE, LabState, queue_size=1)
        self._tf = rospy.Publisher("/tf", TFMessage, queue_size=10)
        self._robots = [RobotConnection(robot) for robot in lab.world.robots]
        expected = ("navigation", "driver") if params.localizes else ("navigation", "driver", "localisation")
        self._lockstep = Lockstep(expected) if params.lockstep else None
        self._static_tf = tf2_ros.StaticTransformBroadcaster()
        self._static_tf.sendTransform([self._laser_mount(connection) for connection in self._robots])
        for index, connection in enumerate(self._robots):
            topic = connection.topic + "cmd_vel"
            rospy.Subscriber(topic, Twist, self._on_cmd_vel, index, queue_size=1, tcp_nodelay=True)
        if self._lockstep is not None:
            topic = self._robots[0].topic + "cmd_vel/navigation"
            arrive = self._lockstep.arrive
            rospy.Subscriber(topic, Twist, lambda _: arrive("navigation"), queue_size=1, tcp_nodelay=True)
            rospy.Subscriber("/tf", rospy.AnyMsg, self._on_transform, queue_size=20, tcp_nodelay=True)
        rospy.Subscriber(names.PARTICIPANT, ParticipantState, self._on_participant, queue_size=1, tcp_nodelay=True)
        self._pace = 1.0  # maximum of simulated seconds per real second
        rospy.Subscriber(names.PACE, Float64, self._on_pace, queue_size=1)
        threading.Thread(target=self._run, daemon=True).start()

    # ------------------------------------------------------------ callbacks
    def _on_cmd_vel(self, message: Twist, index: int) -> None:
        with self._lock:
            self._lab.robots[index].command(message.linear.x, message.angular.z, self._lab.now)
        if self._lockstep is not None and index == 0:
            self._lockstep.arrive("driver")

    def _on_transform(self, message: rospy.AnyMsg) -> None:
        # besides this node, only AMCL publishes transforms, once for each scan
        if message._connection_header["callerid"] != rospy.get_name():
            self._lockstep.arrive("localisation")

    def _on_participant(self, message: ParticipantState) -> None:
        with self._lock:
            self._participant = message
            self._participant_time = self._lab.now
            person = message.person
            self._lab.person = (person.x, person.y, person.theta) if message.person_present else None

    def _on_pace(self, message: Float64) -> None:
        if not MIN_PACE <= message.data <= MAX_PACE:
            expected = f"expected {MIN_PACE:g} to {MAX_PACE:g}"
            rospy.logwarn("%s: a pace of %s ignored, %s", rospy.get_name(), message.data, expected)
        else:
            self._pace = message.data

    # ------------------------------------------------------------ time
    def _run(self) -> None:
        due = time.monotonic()
        try:
            while not rospy.is_shutdown():
                self._step()
                if self._lockstep is not None and self._count % CONTROL_STEPS == 0:
                    self._lockstep.wait()
                period = self._step_ns * 1e-9 / self._pace
                now = time.monotonic()
                # catches up by at most one step, because cameras and controllers would miss a burst of steps
                due = max(due + period, now - period)
                time.sleep(max(due - now, 0.0))
        except rospy.ROSException:
            if not rospy.is_shutdown():
                raise

    def _step(self) -> None:
        self._now_ns += self._step_ns
        now = rospy.Time(self._now_ns // 10**9, self._now_ns % 10**9)
        with self._lock:
            self._lab.step(self._step_ns * 1e-9, self._now_ns * 1e-9)
            state = self._state_message(now)
        self._clock.publish(Clock(now))
        self._lab_state.publish(state)
        if self._count % POSE_STEPS == 0:
            self._publish_poses(now)
        if self._count % SCAN_STEPS == 1:
            self._publish_scans(now)
        if self._params.localizes and self._count % AMCL_STEPS == 0:
            self._publish_amcl(now)
        self._count += 1

    # ------------------------------------------------------------ messages
    def _state_message(self, now: rospy.Time) -> LabState:
        participant = self._participant
        if self._lab.now - self._participant_time > PARTICIPANT_SILENCE:
            participant = ParticipantState(person_present=participant.person_present, person=participant.person)
        state = LabState(header=Header(0, now, names.MAP_FRAME))
        state.robots = [robot.namespace.strip("/") for robot in self._lab.world.robots]
        state.robot_poses = [Pose2D(*body.pose) for body in self._lab.robots]
        state.laser_on, state.laser = participant.laser_on, participant.laser
        state.laser_color = participant.laser_color or "red"
        state.person_present, state.person = participant.person_present, participant.person
        state.participant_doing = participant.doing
        return state

    def _publish_poses(self, now: rospy.Time) -> None:
        transforms: List[TransformStamped] = []
        # like AMCL, stamps the correction ahead, so that lookups at the present time need not wait for it
        ahead = now + rospy.Duration(TRANSFORM_TOLERANCE)
        for body, connection in zip(self._lab.robots, self._robots):
            with self._lock:
                odometry, velocity, correction = body.odometry, body.velocity, body.map_to_odom()
            base = geometry.transform_from_pose2d(*odometry)
            odom, base_frame = connection.odom_frame, connection.base_frame
            if self._params.localizes:
                transforms.append(messages.message_from_transform(correction, names.MAP_FRAME, odom, ahead))
            transforms.append(messages.message_from_transform(base, odom, base_frame, now))
            if connection.odom.get_num_connections():
                message = Odometry(header=Header(0, now, odom), child_frame_id=base_frame)
                message.pose.pose = messages.message_from_pose2d(*odometry)
                message.twist.twist.linear.x, message.twist.twist.angular.z = velocity
                connection.odom.publish(message)
        self._tf.publish(TFMessage(transforms))

    def _publish_amcl(self, now: rospy.Time) -> None:
        model = self._lab.models.localisation
        for body, connection in zip(self._lab.robots, self._robots):
            with self._lock:
                estimate = body.estimated_pose()
            message = PoseWithCovarianceStamped(header=Header(0, now, names.MAP_FRAME))
            message.pose.pose = messages.message_from_pose2d(*estimate)
            sigmas = [model.position_sigma, model.position_sigma, 0.0, 0.0, 0.0, model.yaw_sigma]
            message.pose.covariance = np.diag(np.square(sigmas)).ravel().tolist()
            connection.amcl.publish(message)

    def _publish_scans(self, now: rospy.Time) -> None:
        model = self._lab.models.scan
        for index, connection in enumerate(self._robots):
            if not connection.scan.get_num_connections():
                continue
            with self._lock:
                angles, ranges = self._lab.scan(index)
            message = LaserScan(header=Header(0, now, connection.laser_frame))
            message.angle_min, message.angle_max = float(angles[0]), float(angles[-1])
            message.angle_increment = float(angles[1] - angles[0])
            message.scan_time = SCAN_STEPS / RATE
            message.range_min, message.range_max = model.range_min, model.range_max
            message.ranges = ranges.tolist()
            connection.scan.publish(message)

    def _laser_mount(self, connection: RobotConnection) -> TransformStamped:
        mount = geometry.make_transform(np.eye(3), (0.0, 0.0, self._lab.models.scan.height))
        return messages.message_from_transform(mount, connection.base_frame, connection.laser_frame, rospy.Time(0))


def make_clock_publisher() -> rospy.Publisher:
    """Creates the publisher of /clock, which sends at once, without a queue and thread per subscriber.

    All 25 nodes subscribe. Waking a thread for each 50 times a second would take half of this node's time. A hung
    subscriber does not block it, because its socket's buffer holds more than 40 minutes of unread messages.
    """
    with warnings.catch_warnings():
        # rospy warns of a missing queue, which is intended here
        warnings.simplefilter("ignore", SyntaxWarning)
        return rospy.Publisher("/clock", Clock, queue_size=None)


def build() -> LabSimulatorNode:
    """Reads the parameters and constructs the node."""
    params = parameters.read(LabSimulatorParams)
    if not rospy.get_param("/use_sim_time", False):
        raise ParameterError("/use_sim_time", "must be true, because the lab's time is simulated")
    lab = SimulatedLab(load_world(params.world), load_models(), params.seed)
    return LabSimulatorNode(lab, params)
