"""Guides a person through the calibration of a ceiling camera, in a terminal; see docs/how-to/calibrate-cameras.md.

Subscribed topics:
    <image> (sensor_msgs/Image), <image>/compressed (sensor_msgs/CompressedImage): one of the two
    <camera>/camera_info (sensor_msgs/CameraInfo): next to the image
    /clicked_point (geometry_msgs/PointStamped): RViz's tool "Publish Point", fixed frame map
"""

from __future__ import annotations

import argparse
import contextlib
import datetime
import queue
import sys
import threading
import time
from functools import partial
from typing import Callable, Sequence, Tuple

import cv2
import rospy
from geometry_msgs.msg import PointStamped

from vb_core import names
from vb_core.errors import CodedError
from vb_laser_detect.calibration import pose_file
from vb_laser_detect.calibration.pose_session import PoseCalibrationSession, StillSpotFinder
from vb_laser_detect.calibration.pose_session import describe_estimate, describe_points, parse_point
from vb_laser_detect.calibration.lens import PAPERS_MM, write_board
from vb_laser_detect.calibration.pose import POINT_SIGMA
from vb_laser_detect.detection.spot_detector import SpotDetector
from vb_laser_detect.ros.calibration_commands import RunningCamera, calibrate_lens, measure_camera_delay, set_exposure

CALIBRATION_FOLDER = "~/.ros/virtual_borders/cameras"
_SPOT_TIMEOUT = 4.0  # [s] for the spot to be seen and still
print_line = partial(print, flush=True)  # the person sees each line at once
_HELP = """
Hold the spot still on a place that you know in the map, for two seconds, then
  click the place in RViz ("Publish Point"), or type its map coordinates: x y [m]
Four places are needed, six to eight are good: near the corners of what the camera sees, and some within.
  undo   takes the last place back      done   ends and writes      quit   ends without writing"""


class InputLines:
    """The person's input, line by line: what is typed, and the coordinates of points that are clicked in RViz."""

    def __init__(self) -> None:
        self._lines: "queue.Queue[str]" = queue.Queue()
        rospy.Subscriber("/clicked_point", PointStamped, self._on_click, queue_size=10)
        threading.Thread(target=self._read, daemon=True).start()

    def _on_click(self, message: PointStamped) -> None:
        frame = message.header.frame_id
        if frame.lstrip("/") == names.MAP_FRAME:
            self._lines.put(f"{message.point.x} {message.point.y}")
        else:
            print_line(f"! this point is in the frame '{frame}': set RViz' fixed frame to '{names.MAP_FRAME}'")

    def _read(self) -> None:
        for line in sys.stdin:
            self._lines.put(line.strip())
        self._lines.put("quit")

    def wait_for_line(self) -> str:
        """Waits for the next line; returns "quit" when the input or ROS ends."""
        while not rospy.is_shutdown():
            with contextlib.suppress(queue.Empty):
                return self._lines.get(timeout=0.2)
        return "quit"


class SpotCalibration:
    """The dialogue with a person who holds the spot still at known places of the map."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self._arguments = arguments
        self._inputs = InputLines()
        self._spot_finder = StillSpotFinder()
        self._lock = threading.Lock()
        self._camera = RunningCamera(arguments.camera, own_source=False)
        # a held spot must not be taken for a lamp while the person finds the place in RViz, nor for paper if it lies still
        detector_params = self._camera.detector_params.replace(max_dwell_time=3600.0)
        self._detector = SpotDetector(detector_params, may_rest=True)
        self._lens = self._camera.read_lens()
        self._session = PoseCalibrationSession(self._lens, arguments.point_sigma)
        threading.Thread(target=self._watch, daemon=True).start()

    def _watch(self) -> None:
        """Searches each image for the spot, so that `_wait_for_still_spot` knows where it has been."""
        while not rospy.is_shutdown():
            try:
                stamp, picture = self._camera.next_image()
                spots = self._detector.detect(picture, stamp).spots
            except CodedError as error:
                rospy.logwarn_throttle(5.0, str(error))
                continue
            with self._lock:
                self._spot_finder.add(stamp, [(spot.u, spot.v) for spot in spots if spot.stamp == stamp])

    def run(self) -> int:
        """Talks to the person until they are done; returns the exit status."""
        print_line(_HELP)
        while True:
            line = self._inputs.wait_for_line()
            try:
                if line == "quit":
                    print_line("nothing was written")
                    return 1
                if line == "done":
                    return self._finish()
                if line == "undo":
                    print_line("  taken back" if self._session.undo() else "  there is nothing to take back")
                elif line:
                    place = parse_point(line)
                    if place is None:
                        print_line(_HELP)
                        continue
                    self._add_place(place)
                if line:
                    print_line("  " + self._session.describe_progress())
            except CodedError as error:
                print_line(f"! {error}")

    def _add_place(self, point: Sequence[float]) -> None:
        """Adds the place (x, y) [m] where the spot is held now."""
        u, v = self._wait_for_still_spot()
        self._session.add((u, v), point)
        print_line(f"  ({point[0]:.3f}, {point[1]:.3f}) m is at ({u:.1f}, {v:.1f}) px")

    def _wait_for_still_spot(self) -> Tuple[float, float]:
        """Waits until the spot has been still for long enough; returns its position (u, v) [px]."""
        end = time.monotonic() + _SPOT_TIMEOUT
        while True:
            try:
                with self._lock:
                    return self._spot_finder.median_position()
            except CodedError:
                if time.monotonic() > end or rospy.is_shutdown():
                    raise
            rospy.rostime.wallsleep(0.1)

    def _finish(self) -> int:
        """Estimates the pose and writes it; returns the exit status."""
        observed = self._session.observed
        estimate = self._session.solve()
        report = describe_estimate(estimate, observed)
        print_line("\n" + "\n".join("  " + line for line in report))
        name = self._arguments.camera
        frame = self._camera.frame or f"{name}_optical_frame"
        focal = float(self._lens.matrix[0, 0])
        pose = pose_file.CameraPose(name, names.MAP_FRAME, frame, estimate.T_map_camera, focal)
        # where the running lab looks for it
        folder = str(rospy.get_param("/camera_poses/calibration_dir", "")) or CALIBRATION_FOLDER
        path = pose_file.calibration_path(folder, name)
        title = f"{self._arguments.command}, {datetime.datetime.now().isoformat(' ', 'minutes')}"
        pose_file.write_pose(path, pose, [title, *report, *describe_points(estimate, observed)])
        print_line(f"wrote {path}; a running lab.launch takes it within seconds")
        return 0


def _print_board(arguments: argparse.Namespace) -> int:
    print_line("\n".join(write_board(arguments.paper, arguments.file)))
    return 0


def _parser() -> argparse.ArgumentParser:
    """Makes the parser; each command's function is its argument `run`."""
    description = "Sets up a ceiling camera, and finds its pose in the map."
    parser = argparse.ArgumentParser("calibrate_camera", description=description)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    commands.required = True

    def add(name: str, run: Callable[[argparse.Namespace], int], help: str) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=help)
        command.set_defaults(run=run)
        if run is not _print_board:
            command.add_argument("camera", help="its name; image topic and frame are those of its running detector")
        return command

    printed = add("print_board", _print_board, "write the board for lenses as PDF or PNG, at true size")
    printed.add_argument("file")
    help = "its pose, from laser spots on known places"
    spots = add("spots", lambda arguments: SpotCalibration(arguments).run(), help)
    accuracy = "[m] how exactly the places are known; default: %(default)s, as clicked in RViz"
    spots.add_argument("--point_sigma", type=float, default=POINT_SIGMA, help=accuracy)
    lens = add("lens", calibrate_lens, "the lens, from the printed board, of a camera that its detector reads itself")
    papers = f"of the board: {', '.join(PAPERS_MM)}; default: %(default)s"
    for command in (printed, lens):
        command.add_argument("--paper", default="A3", help=papers)
    lens.add_argument("--square", type=float, help="[m] side of a square as measured, if the print is not exact")
    add("delay", measure_camera_delay, "how late the camera's images are, by this window's blinking")
    add("exposure", set_exposure, "an exposure time at which the floor is grey and the spot is white")
    return parser


def main() -> int:
    """Runs the command; see --help."""
    arguments = _parser().parse_args(rospy.myargv()[1:])
    cv2.setNumThreads(1)
    try:
        if arguments.run is not _print_board:  # which is the only command that needs no ROS master
            # Ctrl-C interrupts the command, not the node, so that the camera's settings are restored first
            rospy.init_node("calibrate_camera", anonymous=True, disable_signals=True)
        return arguments.run(arguments)
    except CodedError as error:
        print(f"calibrate_camera: {error}", file=sys.stderr)
        return 1
    except (KeyboardInterrupt, rospy.ROSInterruptException):
        return 1
