#!/usr/bin/env python3
"""Draws the pictures of the tutorial on one's own lab, from the simulated one.

    python3 bench/lab/tutorial_pictures.py [exposure | rviz] [--out docs/images]

`exposure.jpg`: a part of what a ceiling camera sees at the right exposure and at twice that, each with the share of
its image that is at the white level, as `check_lab` reports it. `rviz_publish_point.png`: RViz as the operator calibrates
with it, with the tool chosen; it needs neither ROS running nor a display.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import os
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
import rosgraph
import rospy
import tf2_ros
from cv_bridge import CvBridge
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import Image

from vb_core import names
from vb_core.ros.messages import message_from_grid, message_from_transform
from vb_evaluation.demonstration.screenshots import TIMEOUT, still_picture
from vb_evaluation.observer import wait_until
from vb_evaluation.processes import Child, free_port, start_screen
from vb_laser_detect.detection.exposure import saturated_share
from vb_laser_detect.detection.projection import pixels_of
from vb_sim.cameras.ceiling_view import CeilingView
from vb_sim.lab_history import Snapshot
from vb_sim.room import floor_plan
from vb_sim.room.camera_models import load_camera_models
from vb_sim.room.floor_texture import render_floor
from vb_sim.room.mesh import world_mesh
from vb_sim.room.world import load_world

TOP = Path(__file__).resolve().parents[2]
SPOT = (4.25, 3.0)  # [m] on the wooden floor
AROUND_PX = 260
SCREEN = (1800, 1000)  # as large as the configuration's window
TOOL, CORNER, ORANGE = ((556, 24), (656, 58)), (834, 303), (0, 140, 255)  # where it has its tool, and a door's edge


def render(world, name: str, factor: float):
    """Renders a ceiling camera with the spot, at a multiple of the right exposure; returns the image and its view."""
    models, camera = load_camera_models(str(TOP / "src/vb_sim/config/models.yaml")), world.camera(name)
    optics = dataclasses.replace(models.optics, exposure_ms=factor * models.optics.reference_exposure_ms)
    models, floor, mesh = dataclasses.replace(models, optics=optics), render_floor(world, 1), world_mesh(world)
    view = CeilingView(camera, world.robot_radii(), floor, mesh, models, 1)
    return view.frame(Snapshot(0.0, laser=SPOT)).copy(), view


def color_of(image: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(image, cv2.COLOR_BayerBG2BGR) if image.ndim == 2 else image


def draw_exposures(world, out: Path) -> None:
    """Renders one camera at two exposures, with the spot in the middle."""
    shown = []
    for factor in (1.0, 2.0):
        image, view = render(world, "green", factor)
        u, v = (round(value) for value in pixels_of(view.model, view.pose, np.array([[*SPOT, 0.0]]))[0])
        part = color_of(image)[v - AROUND_PX // 2 : v + AROUND_PX // 2, u - AROUND_PX : u + AROUND_PX]
        print(f"exposure x {factor:g}: {100 * saturated_share(image):.1f} % at the white level")
        shown.append(cv2.resize(part, None, fx=1.5, fy=1.5, interpolation=cv2.INTER_CUBIC))
    cv2.imwrite(str(out / "exposure.jpg"), np.hstack(shown), [cv2.IMWRITE_JPEG_QUALITY, 88])


def photograph_rviz(world, out: Path) -> None:
    """Starts RViz with the operator's configuration and the lab's map on a virtual screen, and takes its picture."""
    os.environ.update(LIBGL_ALWAYS_SOFTWARE="1", QT_X11_NO_MITSHM="1")
    port = free_port()
    os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{port}"
    with contextlib.ExitStack() as stack, tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.environ["ROS_LOG_DIR"] = f"{folder}/log"
        stack.callback(Child(["rosmaster", "--core", "-p", str(port)], folder / "master.txt").stop)
        wait_until(rosgraph.is_master_online, TIMEOUT)
        rospy.init_node("tutorial_pictures", disable_signals=True, log_level=rospy.ERROR)
        stack.callback(rospy.signal_shutdown, "the picture is taken")
        frames = tf2_ros.StaticTransformBroadcaster()
        frames.sendTransform(message_from_transform(np.eye(4), names.MAP_FRAME, "floor", rospy.Time.now()))
        publisher = rospy.Publisher(names.MAP_WITH_BORDERS, OccupancyGrid, queue_size=1, latch=True)
        publisher.publish(message_from_grid(floor_plan.physical_map(world), rospy.Time.now()))
        for camera in world.cameras:
            image = color_of(render(world, camera.name, 1.0)[0])
            message = CvBridge().cv2_to_imgmsg(cv2.resize(image, None, fx=0.5, fy=0.5), "bgr8")
            topic = f"/spot_detector_{camera.name}/debug_image"
            rospy.Publisher(topic, Image, queue_size=1, latch=True).publish(message)
        screen, os.environ["DISPLAY"] = start_screen(folder / "xvfb.txt", *SCREEN)
        stack.callback(screen.stop)
        shown = Child(["rosrun", "rviz", "rviz", "-d", str(TOP / "rviz/engineer.rviz")], folder / "rviz.txt")
        stack.callback(shown.stop)
        wait_until(lambda: publisher.get_num_connections() > 0, TIMEOUT)
        picture = still_picture(os.environ["DISPLAY"], folder / "screen.png", [])
    cv2.rectangle(picture, *TOOL, ORANGE, 4)
    cv2.circle(picture, CORNER, 22, ORANGE, 4)
    cv2.imwrite(
        str(out / "rviz_publish_point.png"), cv2.resize(picture, None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA)
    )


PICTURES = {"exposure": draw_exposures, "rviz": photograph_rviz}


def main() -> int:
    """Draws the chosen pictures, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pictures", nargs="*", choices=[[], *PICTURES], default=[])
    parser.add_argument("--out", type=Path, default=TOP / "docs" / "images")
    given = parser.parse_args()
    world = load_world(str(TOP / "src/vb_sim/worlds/lab.yaml"))
    for name in given.pictures or PICTURES:
        PICTURES[name](world, given.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
