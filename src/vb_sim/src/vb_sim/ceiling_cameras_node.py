"""Node: renders the images of a world's ceiling cameras, each at its own rate, spread evenly in time.

Subscribed topics:
    /sim/lab_state (vb_msgs/LabState): everything that moves. Without a publisher, the lab is empty.
Published topics:
    /<camera>/image_raw (sensor_msgs/Image), /<camera>/camera_info (sensor_msgs/CameraInfo): stamped with the middle of
        the exposure; delivered `optics/latency_ms` later.
    /tf_static (tf2_msgs/TFMessage): map -> <camera>_optical_frame, the pose with its calibration error. The images are
        rendered from the true pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import rospy

from vb_core import names
from vb_core.parameters import Parameters, param
from vb_core.ros.messages import message_from_transform
from vb_sim.cameras.camera_calibration import calibrated_pose
from vb_sim.cameras.camera_node import CameraNode, ImageStream, SimulatedCamera, configure_and_read
from vb_sim.rendering.ceiling_view import CeilingView
from vb_sim.model_params import Optics, load_models
from vb_sim.rendering.floor_texture import render_floor
from vb_sim.rendering.mesh import world_mesh
from vb_sim.world import CeilingCamera, load_world


@dataclass(frozen=True)
class CeilingCamerasParams(Parameters):
    """The node's parameters; config/ceiling_cameras.yaml explains them."""

    world: str = param("")
    seed: int = param(1, low=0)
    cameras: list = param([])


def make_ceiling_camera(camera: CeilingCamera, view: CeilingView, optics: Optics, seed: int) -> SimulatedCamera:
    """Creates a ceiling camera with its topics."""
    frame = f"{camera.name}_optical_frame"
    mount = message_from_transform(calibrated_pose(camera, optics, seed), names.MAP_FRAME, frame, rospy.Time.now())
    images = ImageStream(f"/{camera.name}", frame, view.model, view.encoding, view.image)
    return SimulatedCamera(camera.name, camera.rate, view, [images], mount)


def build() -> CameraNode:
    """Reads the parameters and constructs the node."""
    params = configure_and_read(CeilingCamerasParams)
    world = load_world(params.world)
    models = load_models()
    cameras = [world.camera(str(name)) for name in params.cameras] or list(world.cameras)
    if not cameras:
        rospy.logwarn("world '%s' has no ceiling cameras", world.name)
    floor = render_floor(world, params.seed)
    mesh = world_mesh(world)
    simulated = []
    for camera in cameras:
        view = CeilingView(camera, world.robot_radii(), floor, mesh, models, params.seed)
        simulated.append(make_ceiling_camera(camera, view, models.optics, params.seed))
    return CameraNode(simulated, models.optics.latency_ms)
