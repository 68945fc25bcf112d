"""Node: renders the images of one robot's colour and depth camera, from the robot's true pose.

Subscribed topics:
    /sim/lab_state (vb_msgs/LabState): everything that moves, including this robot. Without a publisher, the robot
        does not move and the lab is empty.
Published topics:
    camera/rgb/image_raw (sensor_msgs/Image, 640 x 480 rgb8), camera/rgb/camera_info (sensor_msgs/CameraInfo)
    camera/depth_registered/image_raw (sensor_msgs/Image, 160 x 120 16UC1 [mm], 0 if unknown): with every
        second colour image, with the same stamp.
    camera/depth_registered/camera_info (sensor_msgs/CameraInfo): likewise.
    /tf_static (tf2_msgs/TFMessage): <prefix>base_link -> <prefix>camera_optical_frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import rospy

from vb_core.parameters import Parameters, param
from vb_core.ros.messages import message_from_transform
from vb_sim.cameras.camera_node import CameraNode, ImageStream, SimulatedCamera, configure_and_read
from vb_sim.rendering.robot_view import RobotView
from vb_sim.model_params import load_models
from vb_sim.rendering.floor_texture import render_floor
from vb_sim.rendering.mesh import world_mesh
from vb_sim.world import Robot, load_world

CAMERA_RATE = 25.0  # [1/s] of colour images; assumed
_DEPTH_EVERY = 2  # colour images for each depth image, to save time


@dataclass(frozen=True)
class RobotCameraParams(Parameters):
    """The node's parameters; config/robot_camera.yaml explains them."""

    world: str = param("")
    seed: int = param(1, low=0)
    robot: str = param("")
    tf_prefix: str = param("")


def make_robot_camera(robot: Robot, view: RobotView, tf_prefix: str) -> SimulatedCamera:
    """Creates a robot's camera with its topics, in the node's namespace.

    Args:
        tf_prefix: prefix of the frames' names, for instance "robot2/".
    """
    frame = f"{tf_prefix}camera_optical_frame"
    mount = message_from_transform(robot.camera_mount(), f"{tf_prefix}base_link", frame, rospy.Time.now())
    # depth is published first, so that nodes have a colour image's depth when the colour image arrives
    depth = ImageStream("camera/depth_registered", frame, view.depth_model, "16UC1", view.depth, _DEPTH_EVERY)
    color = ImageStream("camera/rgb", frame, view.model, view.encoding, view.image)
    return SimulatedCamera(robot.name, CAMERA_RATE, view, [depth, color], mount)


def build() -> CameraNode:
    """Reads the parameters and constructs the node."""
    params = configure_and_read(RobotCameraParams)
    world = load_world(params.world)
    models = load_models()
    robot = world.robot(params.robot) if params.robot else world.robots[0]
    # the seed is that of the ceiling cameras, so that all cameras see the same floor
    floor = render_floor(world, params.seed)
    view = RobotView(robot, world.robot_radii(), floor, world_mesh(world), models, params.seed)
    camera = make_robot_camera(robot, view, params.tf_prefix)
    return CameraNode([camera], models.optics.latency_ms)
