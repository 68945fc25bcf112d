"""Fits RViz to the map and the screen, then replaces itself with RViz.

Subscribed topics:
    /map (nav_msgs/OccupancyGrid): one message, for the map's extent
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Optional, Tuple

import rospkg
import rospy
from vb_core import names, sentences
from vb_core.errors import CodedError, ParameterError
from vb_core.parameters import Parameters, param
from vb_core.ros import parameters
from vb_core.ros.messages import NumpyOccupancyGrid, grid_from_message

from vb_feedback.display.layout import Rectangle
from vb_feedback.display.rviz_config import overlay_fonts, screen_size, write_fitted_config

_ASPECT = "/display_markers/screen_aspect"
_DEFAULT_SIZE = (1920, 1080)
_SCREEN_CHECK_PERIOD = 2.0  # [s] between two checks whether a screen has been switched on


@dataclass(frozen=True)
class SmartDisplayParams(Parameters):
    """Parameters of smart_display; config/smart_display.yaml explains them."""

    config: str = param("")
    screen: str = param("auto")
    full_screen: bool = param(True)

    def size(self) -> Tuple[int, int]:
        """Returns (width, height) [px]: the parameter's, or with "auto" the screen's.

        Raises:
            ParameterError: if the parameter is neither a size nor "auto".
        """
        if self.screen != "auto":
            sides = self.screen.lower().split("x")
            if len(sides) != 2 or not all(side.isdigit() for side in sides):
                raise ParameterError("~screen", f"must be auto or for instance 1920x1080, got '{self.screen}'")
            return int(sides[0]), int(sides[1])
        return screen_size(_query_screen() or "") or _DEFAULT_SIZE


def _query_screen() -> Optional[str]:
    """Returns xdpyinfo's output about the screen, "" if xdpyinfo cannot be run, or None if there is no screen."""
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return None
    try:
        query = subprocess.run(["xdpyinfo"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, universal_newlines=True)
    except OSError:
        return ""
    return query.stdout if query.returncode == 0 else None


def _report_missing(code: str) -> None:
    """Logs what RViz needs, and stores the code in a parameter for check_lab. The code is "" if nothing is missing."""
    if code:
        # logged first: a reader of the parameter may end this node, and rospy may hang if that interrupts its logging
        rospy.logwarn("smart_display: %s", sentences.translate(code))
    rospy.set_param("~lacking", code)


def _wait_for_screen() -> None:
    """Waits for a screen. Without a screen, RViz would exit at once, and would be restarted again and again."""
    _report_missing("no_screen" if _query_screen() is None else "")
    while _query_screen() is None and not rospy.is_shutdown():
        rospy.rostime.wallsleep(_SCREEN_CHECK_PERIOD)
    rospy.set_param("~lacking", "")


def _write_fitted_config(params: SmartDisplayParams, path: Path) -> None:
    """Waits for the map, and writes the fitted RViz configuration."""
    rospy.loginfo("smart_display: RViz starts as soon as there is a map on %s", names.PHYSICAL_MAP)
    grid = grid_from_message(rospy.wait_for_message(names.PHYSICAL_MAP, NumpyOccupancyGrid))
    aspect = rospy.get_param(_ASPECT, None)
    write_fitted_config(params.config, path, Rectangle.from_points(grid.corners()), *params.size(), aspect)


def _install_fonts(name: str) -> None:
    """Lets RViz draw more characters than its package requests. If this fails, RViz starts without them."""
    try:
        rviz = Path(rospkg.RosPack().get_path("rviz"))
        folder = overlay_fonts(rviz, Path(rospkg.get_ros_home()) / "virtual_borders" / f"{name}_letters")
    except (OSError, ValueError, rospkg.ResourceNotFound) as error:
        print(f"smart_display: RViz draws Latin letters without accents only: {error}", file=sys.stderr)
        return
    os.environ["ROS_PACKAGE_PATH"] = f"{folder}:{os.environ.get('ROS_PACKAGE_PATH', '')}"


def main() -> None:
    """Runs the program. The name from roslaunch is passed on to RViz."""
    rospy.init_node("smart_display")
    name = rospy.get_name().strip("/").replace("/", "_")
    # one file per node, which each start writes again; RViz reads it after it has replaced this process
    path = Path(rospkg.get_ros_home()) / f"{name}.rviz"
    try:
        params = parameters.read(SmartDisplayParams)
        if shutil.which("rviz") is None:
            _report_missing("no_rviz")
            return rospy.spin()
        _wait_for_screen()
        _write_fitted_config(params, path)
    except CodedError as error:
        rospy.logfatal("smart_display: %s", error)
        sys.exit(1)
    except rospy.ROSException:
        return
    rospy.signal_shutdown("RViz takes over")
    _install_fonts(name)
    screen_options = ["--fullscreen"] if params.full_screen else []
    os.execvp("rviz", ["rviz", *screen_options, "-d", str(path), *sys.argv[1:]])
