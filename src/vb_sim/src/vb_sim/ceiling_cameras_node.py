"""Node: the ceiling cameras of a world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Optional, Sequence

import cv2
import numpy as np
import rospy
import tf2_ros
from sensor_msgs.msg import CameraInfo, Image

from vb_core import names
from vb_core.parameters import Parameters, param
from vb_core.ros.cameras import info_from_camera
from vb_core.ros import node, parameters
from vb_core.ros.messages import message_from_transform
from vb_sim.cameras.camera_calibration import calibrated_pose
from vb_sim.cameras.camera_node import CameraNode
from vb_sim.cameras.ceiling_view import CeilingView
from vb_sim.room.floor_texture import render_floor
from vb_sim.lab_history import Snapshot
from vb_sim.lab_messages import array_image
from vb_sim.room.mesh import world_mesh
from vb_sim.room.camera_models import CameraModels, load_camera_models
from vb_sim.room.world import CeilingCamera, World, load_world


class CeilingCamerasNode(CameraNode):
    """Renders what a world's ceiling cameras see.

    Subscribed topics:
        /sim/lab_state (vb_msgs/LabState): what moves. While it has no publisher, the lab is empty.
    Published topics, for each camera, at its own rate, the cameras' frames spread evenly:
        /<camera>/image_raw (sensor_msgs/Image), /<camera>/camera_info (sensor_msgs/CameraInfo): stamp
            is the middle of the exposure; delivered `optics/latency_ms` later.
        /tf_static (tf2_msgs/TFMessage): map -> <camera>_optical_frame, the pose with its calibration error. Images are
            rendered from the true pose.

    Args:
        world: the world.
        models: figures of optics and noise.
        cameras: which of the world's cameras to publish.
        seed: of floor, noise and calibration errors.
        views: of the cameras, if drawn already.
    """

    def __init__(
        self,
        world: World,
        models: CameraModels,
        cameras: List[CeilingCamera],
        seed: int,
        views: Optional[Sequence[CeilingView]] = None,
    ) -> None:
        optics = models.optics
        super().__init__([camera.rate for camera in cameras], optics.latency_ms)
        self._cameras = cameras
        if views is None:
            floor, mesh = render_floor(world, seed), world_mesh(world)
            views = [CeilingView(camera, world.robot_radii(), floor, mesh, models, seed) for camera in cameras]
        self._views = list(views)
        self._frames = [f"{camera.name}_optical_frame" for camera in cameras]
        self._images = [rospy.Publisher(f"/{camera.name}/image_raw", Image, queue_size=2) for camera in cameras]
        self._infos = [rospy.Publisher(f"/{camera.name}/camera_info", CameraInfo, queue_size=2) for camera in cameras]
        self._info_messages = [
            info_from_camera(view.model, rospy.Time(), frame) for view, frame in zip(self._views, self._frames)
        ]
        self._broadcaster = tf2_ros.StaticTransformBroadcaster()
        self._broadcaster.sendTransform(
            [
                message_from_transform(calibrated_pose(camera, optics, seed), names.MAP_FRAME, frame, rospy.Time.now())
                for camera, frame in zip(cameras, self._frames)
            ]
        )
        self._start()

    def _publish(self, index: int, stamp_s: float) -> None:
        stamp = rospy.Time.from_sec(stamp_s)
        if self._infos[index].get_num_connections() > 0:
            info = self._info_messages[index]
            info.header.stamp = stamp
            self._infos[index].publish(info)
        if self._images[index].get_num_connections() == 0:
            return
        image = self._image(index, self._history.at(stamp_s))
        if image is not None:
            self._images[index].publish(array_image(image, self._views[index].encoding, stamp, self._frames[index]))

    def _image(self, index: int, snapshot: Snapshot) -> Optional[np.ndarray]:
        """Renders what a camera sees; None: nothing is sent."""
        return self._views[index].frame(snapshot)


@dataclass(frozen=True)
class CeilingCamerasParams(Parameters):
    """The node's own parameters; config/ceiling_cameras.yaml says what they mean."""

    world: str = param("")
    seed: int = param(1, low=0)
    cameras: list = param([])


def build() -> CeilingCamerasNode:
    """Reads the parameters and makes the node."""
    cv2.setNumThreads(1)
    node.disable_heap_trimming()
    parameters.read_required("~world")
    params = parameters.read(CeilingCamerasParams)
    world = load_world(params.world)
    cameras = [world.camera(str(name)) for name in params.cameras] if params.cameras else list(world.cameras)
    if not cameras:
        rospy.logwarn("world '%s' has no ceiling cameras", world.name)
    return CeilingCamerasNode(world, load_camera_models(), cameras, params.seed)
