"""Node: a robot's colour and depth camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

import cv2
import rospy
import tf2_ros
from sensor_msgs.msg import CameraInfo, Image

from vb_core.parameters import Parameters, param
from vb_core.ros.cameras import info_from_camera
from vb_core.ros import node, parameters
from vb_core.ros.messages import message_from_transform
from vb_sim.cameras.camera_node import CameraNode
from vb_sim.room.floor_texture import render_floor
from vb_sim.lab_history import Snapshot
from vb_sim.lab_messages import array_image
from vb_sim.room.mesh import world_mesh
from vb_sim.room.camera_models import CameraModels, load_camera_models
from vb_sim.cameras.robot_view import RobotView
from vb_sim.room.world import Robot, World, load_world


class RobotCameraNode(CameraNode):
    """Renders what the camera of one robot sees, from the robot's true pose.

    Subscribed topics:
        /sim/lab_state (vb_msgs/LabState): what moves, this robot included. While it has no publisher, the
            robot stays where it was and the lab is empty.
    Published topics:
        camera/rgb/image_raw (sensor_msgs/Image, 640 x 480 rgb8), camera/rgb/camera_info (sensor_msgs/CameraInfo)
        camera/depth_registered/image_raw (sensor_msgs/Image, 160 x 120 16UC1 [mm], 0 = none): with every
            `robot_camera/depth_every`-th colour image, same stamp.
        camera/depth_registered/camera_info (sensor_msgs/CameraInfo): likewise.
        /tf_static (tf2_msgs/TFMessage): <prefix>base_link -> <prefix>camera_optical_frame.

    Args:
        world: the world.
        models: figures of optics and noise.
        robot: whose camera.
        seed: of floor and noise.
        tf_prefix: put before the names of the frames, for instance "robot2/".
        view: of the camera, if drawn already.
    """

    def __init__(
        self,
        world: World,
        models: CameraModels,
        robot: Robot,
        seed: int,
        tf_prefix: str,
        view: Optional[RobotView] = None,
    ) -> None:
        super().__init__([robot.camera_rate], models.optics.latency_ms)
        self._robot = robot
        self._every = models.robot_camera.depth_every
        self._frames_taken = 0
        # the same seed as the ceiling cameras': all of them look at the same floor
        self._view = view or RobotView(
            robot, world.robot_radii(), render_floor(world, seed), world_mesh(world), models, seed
        )
        frame = f"{tf_prefix}camera_optical_frame"
        self._frame = frame
        self._color = rospy.Publisher("camera/rgb/image_raw", Image, queue_size=2)
        self._color_info = rospy.Publisher("camera/rgb/camera_info", CameraInfo, queue_size=2)
        self._depth = rospy.Publisher("camera/depth_registered/image_raw", Image, queue_size=2)
        self._depth_info = rospy.Publisher("camera/depth_registered/camera_info", CameraInfo, queue_size=2)
        self._color_info_message = info_from_camera(self._view.color_model, rospy.Time(), frame)
        self._depth_info_message = info_from_camera(self._view.depth_model, rospy.Time(), frame)
        self._broadcaster = tf2_ros.StaticTransformBroadcaster()
        self._broadcaster.sendTransform(
            message_from_transform(robot.camera_mount(), f"{tf_prefix}base_link", frame, rospy.Time.now())
        )
        self._start()

    def _publish(self, _index: int, stamp_s: float) -> None:
        stamp = rospy.Time.from_sec(stamp_s)
        with_depth = self._frames_taken % self._every == 0
        self._frames_taken += 1
        snapshot = self._history.at(stamp_s)
        wanted = self._wanted(snapshot)
        for publisher, message, due in (
            (self._color_info, self._color_info_message, True),
            (self._depth_info, self._depth_info_message, with_depth),
        ):
            if due and publisher.get_num_connections() > 0:
                message.header.stamp = stamp
                publisher.publish(message)
        if not wanted:
            return
        # depth first: a node that looks up the depth of a colour image then has it already
        if with_depth and self._depth.get_num_connections() > 0:
            self._depth.publish(array_image(self._view.depth(snapshot), "16UC1", stamp, self._frame))
        if self._color.get_num_connections() > 0:
            self._color.publish(array_image(self._view.color(snapshot), "rgb8", stamp, self._frame))

    def _wanted(self, snapshot: Snapshot) -> bool:
        """Returns whether an image of this moment is sent."""
        return True


@dataclass(frozen=True)
class RobotCameraParams(Parameters):
    """The node's own parameters; config/robot_camera.yaml says what they mean."""

    world: str = param("")
    seed: int = param(1, low=0)
    robot: str = param("")
    tf_prefix: str = param("")


def build() -> RobotCameraNode:
    """Reads the parameters and makes the node."""
    cv2.setNumThreads(1)
    node.disable_heap_trimming()
    parameters.read_required("~world")
    params = parameters.read(RobotCameraParams)
    world = load_world(params.world)
    robot = world.robot(params.robot) if params.robot else world.robots[0]
    models = load_camera_models()
    return RobotCameraNode(world, models, robot, params.seed, params.tf_prefix)
