"""Guides a person through the calibration of a ceiling camera, in a terminal; see docs/how-to/calibrate-cameras.md.

Subscribed topics:
    <image> (sensor_msgs/Image), <image>/compressed (sensor_msgs/CompressedImage): one of the two
    <camera>/camera_info (sensor_msgs/CameraInfo): next to the image
    /clicked_point (geometry_msgs/PointStamped): RViz's tool "Publish Point", fixed frame map
    /virtual_borders/detectors (vb_msgs/DetectorStatus): which frame each ceiling camera has
    /virtual_borders/spots (vb_msgs/LaserSpot): where the cameras see the laser, to compare them
"""

from __future__ import annotations

import argparse
import contextlib
import datetime
import queue
import sys
import threading
import time
from pathlib import Path
from typing import Any, Dict, List, Optional, Tuple

import cv2
import numpy as np
import rospy
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from vb_core import names, sentences
from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError
from vb_core.ros import node
from vb_core.ros.cameras import camera_from_info
from vb_laser_detect.calibration import calibration_file
from vb_laser_detect.calibration.pose import PoseEstimationParams
from vb_laser_detect.calibration.board import (
    BoardParams,
    BoardView,
    corners_on_map,
    find_board,
    merge_views,
    write_board,
)
from vb_laser_detect.calibration.calibration_session import CalibrationSession, HeldSpot, describe, parse_numbers
from vb_laser_detect.calibration.consistency import Sighting, compare_cameras, find_suspect
from vb_laser_detect.detector import DetectorParams, SpotDetector
from vb_laser_detect.detection.image_format import PixelReader, to_gray
from vb_laser_detect.camera_geometry import decode, is_rectified, sibling_topic
from vb_msgs.msg import DetectorStatus, LaserSpot

FOLDER = "~/.ros/virtual_borders/cameras"
_BOARD_IMAGES = 10
_BOARD_TIMEOUT = 10.0  # [s] for the next image
_REPORTS_TIMEOUT = 2.5  # [s] within which each detector has told its camera's frame twice
_CONNECTION_TIMEOUT = 15.0  # [s] for all detectors that the master knows
_FIRST_SPOT_TIMEOUT = rospy.Duration(60.0)
_SPOT_TIMEOUT = 4.0  # [s] for the spot to be seen and still


def print_line(text: str) -> None:
    """Prints a line for the person, unbuffered."""
    print(text, flush=True)


def detector_params_of(camera: str) -> DetectorParams:
    """Returns the parameters of a camera's running detector, else those of any stationary camera."""
    values = rospy.get_param(f"/spot_detector_{camera}/detector", {})
    return DetectorParams.from_mapping(values, "detector") if values else DetectorParams.stationary()


class CameraInput:
    """One camera's images and model.

    Subscribed topics:
        <image> (sensor_msgs/Image) or <image>/compressed (sensor_msgs/CompressedImage), <camera_info>

    Attributes:
        frame_id: that the images name.
    """

    def __init__(self, image: str, info: str, compressed: bool, handle: Any) -> None:
        self._handle, self._info, self._rectified = handle, info, is_rectified(image)
        self._first = threading.Event()
        self.frame_id, self._shape = "", (0, 0)
        kind, self._topic = (CompressedImage, image + "/compressed") if compressed else (Image, image)
        rospy.Subscriber(self._topic, kind, self._take, queue_size=1, buff_size=2**24)

    def _take(self, message: Any) -> None:
        try:
            image, encoding = decode(message)
            self.frame_id, self._shape = message.header.frame_id, image.shape
            self._first.set()
            self._handle(image, encoding, message.header.stamp.to_sec())
        except CodedError as error:
            rospy.logwarn_throttle(5.0, str(error))

    def wait(self, timeout: float) -> CameraModel:
        """Waits for images and camera_info; returns the camera's model.

        Raises:
            CodedError: "no_images" if they do not come; "bad_camera_info" if they do not match, or the lens
                is not calibrated.
        """
        try:
            camera = camera_from_info(rospy.wait_for_message(self._info, CameraInfo, timeout), self._rectified)
        except rospy.ROSException:
            raise CodedError("no_images", topics=self._info) from None
        if not self._first.wait(timeout):
            raise CodedError("no_images", topics=self._topic)
        height, width = self._shape[:2]
        if (camera.width, camera.height) != (width, height):
            info = f"camera_info is for {camera.width} x {camera.height} px"
            raise CodedError("bad_camera_info", f"{info}, the images have {width} x {height} px")
        return camera


def collect_detector_frames() -> Dict[str, str]:
    """Listens for the frame of each ceiling camera that a detector runs for.

    Subscribed topics:
        /virtual_borders/detectors (vb_msgs/DetectorStatus)
    """
    frames: Dict[str, str] = {}

    def hear(message: DetectorStatus) -> None:
        if not message.mobile:
            frames[message.camera] = message.frame_id

    subscriber = rospy.Subscriber(names.DETECTORS, DetectorStatus, hear, queue_size=20)
    if not node.wait_for_publishers([subscriber], _CONNECTION_TIMEOUT):
        print_line("! not all running detectors answer: the frames of their cameras are not compared")
    rospy.rostime.wallsleep(_REPORTS_TIMEOUT)
    subscriber.unregister()
    return frames


class Inputs:
    """The person's input: lines typed and points clicked in RViz, in order.

    Subscribed topics:
        /clicked_point (geometry_msgs/PointStamped): RViz' tool "Publish Point", fixed frame map.
    """

    def __init__(self) -> None:
        self._events: "queue.Queue[Tuple[str, Any]]" = queue.Queue()
        rospy.Subscriber("/clicked_point", PointStamped, self._on_click, queue_size=10)
        threading.Thread(target=self._read, daemon=True).start()

    def _on_click(self, message: PointStamped) -> None:
        if message.header.frame_id.lstrip("/") != names.MAP_FRAME:
            frame = message.header.frame_id
            print_line(f"! this point is in the frame '{frame}': set RViz' fixed frame to '{names.MAP_FRAME}'")
            return
        self._events.put(("click", (message.point.x, message.point.y)))

    def _read(self) -> None:
        for line in sys.stdin:
            self._events.put(("line", line.strip()))
        self._events.put(("line", "quit"))

    def next(self) -> Tuple[str, Any]:
        """Waits for the next input; returns ("line", text) or ("click", (x, y)), and ("line", "quit") when ROS ends."""
        while not rospy.is_shutdown():
            try:
                return self._events.get(timeout=0.2)
            except queue.Empty:
                continue
        return "line", "quit"


class CalibrationDialog:
    """The dialogue that both calibration methods share; `help` introduces it, a place is given by so many `numbers`."""

    help, numbers = "", 2

    def __init__(self, arguments: argparse.Namespace, params: PoseEstimationParams) -> None:
        self._arguments = arguments
        self._inputs = Inputs()
        # what the lab's files say of this camera need not be said again
        running = rospy.get_param(f"/spot_detector_{arguments.camera}", {})
        image = arguments.image or "/" + (running.get("image") or f"{arguments.camera}/image_raw").lstrip("/")
        info = arguments.camera_info or sibling_topic(image, "camera_info")
        compressed = arguments.compressed or running.get("image_transport") == "compressed"
        self._input = CameraInput(image, info, compressed, self.on_image)
        self.camera = self._input.wait(arguments.timeout)
        self._frame = (
            arguments.frame or running.get("frame") or self._input.frame_id or f"{arguments.camera}_optical_frame"
        )
        # before the person does any work
        for frames in (calibration_file.read_frames(arguments.folder), collect_detector_frames()):
            calibration_file.require_own_frame(arguments.camera, self._frame, frames)
        self.session = CalibrationSession(self.camera, params)

    def on_image(self, image: np.ndarray, encoding: str, stamp: float) -> None:
        """Handles each image, in a separate thread."""

    def add_place(self, values: List[float]) -> None:
        """Adds map points that were typed or clicked."""

    def run(self) -> int:
        """Talks to the person until they are done; returns the exit status."""
        print_line(self.help)
        clicked: List[float] = []
        while True:
            kind, value = self._inputs.next()
            try:
                if kind == "click":
                    clicked += value
                    if len(clicked) < self.numbers:
                        print_line(f"  P1 at {value[0]:.3f} {value[1]:.3f}; now click P2")
                        continue
                    values, clicked = clicked, []
                    self.add_place(values)
                elif value == "quit":
                    print_line("nothing was written")
                    return 1
                elif value == "undo":
                    clicked = []
                    print_line("  taken back" if self.session.undo() else "  there is nothing to take back")
                elif value == "done":
                    return self._finish()
                elif value:
                    numbers = parse_numbers(value, self.numbers)
                    if numbers is None:
                        print_line(self.help)
                        continue
                    clicked = []
                    self.add_place(numbers)
                if value != "":
                    print_line("  " + self.session.describe_progress())
            except CodedError as error:
                clicked = []
                print_line(f"! {error}")

    def _finish(self) -> int:
        estimate, observed = self.session.solve(), self.session.observed
        print_line("")
        for line in describe(estimate, observed):
            print_line("  " + line)
        a = self._arguments
        pose = calibration_file.CameraPose(
            a.camera, names.MAP_FRAME, self._frame, estimate.T_map_camera, float(self.camera.matrix[0, 0])
        )
        path = calibration_file.calibration_path(a.folder, a.camera)
        date = datetime.datetime.now().isoformat(" ", "minutes")
        calibration_file.save(path, calibration_file.make_document(pose, estimate, observed, a.command, date))
        looked_for = str(rospy.get_param("/camera_poses/calibration_dir", ""))
        if looked_for and Path(looked_for).expanduser().resolve() != path.parent.resolve():
            print_line(
                f"wrote {path}; the running lab.launch looks in {looked_for}: start it with calibration:={a.folder}"
            )
        else:
            print_line(f"wrote {path}; {'the running' if looked_for else 'a'} lab.launch takes it within seconds")
        return 0


class SpotCalibrationDialog(CalibrationDialog):
    """Laser spots that are held still at known places of the map."""

    help = """
Hold the spot still on a place that you know in the map, for two seconds, then
  click the place in RViz ("Publish Point"), or type its map coordinates: x y [m]
Four places are needed, six to eight are good: near the corners of what the camera sees, and some within.
  undo   takes the last place back      done   ends and writes      quit   ends without writing"""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self._held, self._lock = HeldSpot(), threading.Lock()
        # a held spot must not become background while the person finds the place in RViz
        self._detector = SpotDetector(detector_params_of(arguments.camera).replace(max_dwell_time=3600.0))
        self._reader = PixelReader()
        super().__init__(arguments, PoseEstimationParams(point_sigma=arguments.point_sigma))

    def on_image(self, image: np.ndarray, encoding: str, stamp: float) -> None:
        """Searches an image for the spot, and checks whether it is held still."""
        self._detector.encoding = encoding
        spots = self._detector.detect(self._reader.read(image, encoding), stamp)
        with self._lock:
            self._held.add(stamp, [(spot.u, spot.v) for spot in spots])

    def add_place(self, values: List[float]) -> None:
        """Adds the place (x, y) [m] where the spot is held now."""
        u, v = self._rest()
        self.session.add([u, v], values)
        print_line(f"  ({values[0]:.3f}, {values[1]:.3f}) m is at ({u:.1f}, {v:.1f}) px")

    def _rest(self) -> Tuple[float, float]:
        """Waits until the spot has been still for long enough; returns its place (u, v) [px]."""
        end = time.monotonic() + _SPOT_TIMEOUT
        while True:
            try:
                with self._lock:
                    return self._held.place()
            except CodedError:
                if time.monotonic() > end or rospy.is_shutdown():
                    raise
            rospy.rostime.wallsleep(0.1)


class BoardCalibrationDialog(CalibrationDialog):
    """A printed ChArUco board that is laid at known places of the map."""

    help = """
Lay the board flat on the floor, with P1 and P2 on two places that you know in the map. Step back, then
  click P1, then P2 in RViz ("Publish Point"), or type their map coordinates: x1 y1 x2 y2 [m]
Lay it on three or four places that are far from each other in the image.
  undo   takes the last place back      done   ends and writes      quit   ends without writing"""
    numbers = 4

    def __init__(self, arguments: argparse.Namespace) -> None:
        board = BoardParams.for_paper(arguments.paper)
        self._board = board if arguments.square is None else board.replace(square=arguments.square)
        self._images: "queue.Queue[Tuple[np.ndarray, str]]" = queue.Queue(_BOARD_IMAGES)
        super().__init__(arguments, PoseEstimationParams(placement_sigma=arguments.placement_sigma))

    def on_image(self, image: np.ndarray, encoding: str, stamp: float) -> None:
        """Keeps the image until a place is measured."""
        with contextlib.suppress(queue.Full):
            self._images.put_nowait((image, encoding))

    def add_place(self, values: List[float]) -> None:
        """Adds the board, whose P1 and P2 are at (x1, y1, x2, y2) [m] now."""
        # those that wait were taken before the board lay there
        while not self._images.empty():
            self._images.get()
        views: List[BoardView] = []
        reason: Optional[CodedError] = None
        with contextlib.suppress(queue.Empty):
            for _ in range(_BOARD_IMAGES):
                try:
                    views.append(find_board(self._board, to_gray(*self._images.get(timeout=_BOARD_TIMEOUT))))
                except CodedError as error:
                    reason = error
        if not views and reason is not None:
            raise reason
        view = merge_views(views)
        self.session.add(view.pixels, corners_on_map(self._board, view.corners, values[:2], values[2:]))
        print_line(f"  {len(view.ids)} corners seen in {len(views)} images")


def check(arguments: argparse.Namespace) -> int:
    """Measures how well overlapping cameras agree, on live spots or those of a recorded bag."""
    if arguments.bag:
        sightings = _from_bag(arguments.bag)
    else:
        rospy.init_node("calibrate_camera", anonymous=True)
        sightings = []
        print_line(
            f"Draw slowly with the spot where cameras overlap: {arguments.seconds:.0f} s from when it is seen first."
        )
        rospy.Subscriber(names.SPOTS, LaserSpot, lambda message: sightings.append(_sighting(message)), queue_size=100)
        end = rospy.Time.now() + _FIRST_SPOT_TIMEOUT
        while not sightings and not rospy.is_shutdown() and rospy.Time.now() < end:
            rospy.rostime.wallsleep(0.1)
        end = rospy.Time.now() + rospy.Duration(arguments.seconds if sightings else 0.0)
        while not rospy.is_shutdown() and rospy.Time.now() < end:
            rospy.rostime.wallsleep(0.1)
    pairs = compare_cameras([one for one in list(sightings) if one is not None])
    for pair in pairs:
        print_line(pair.describe())
    apart = any(pair.median > arguments.limit / 100.0 for pair in pairs)
    camera = find_suspect(pairs, arguments.limit / 100.0)
    remedy = "$calibrate_suspect" if camera else "$calibrate_moved"
    print_line(
        sentences.translate(
            "cameras_apart" if apart else "cameras_agree",
            {"limit": f"{arguments.limit:g}", "camera": camera, "remedy": remedy},
        )
    )
    return 1 if apart else 0


def _sighting(message: LaserSpot) -> Optional[Sighting]:
    # a camera on a robot carries the robot's localisation error: it says nothing about the ceiling cameras
    if message.mobile:
        return None
    return message.camera, message.header.stamp.to_sec(), message.position.x, message.position.y


def _from_bag(path: str) -> List[Optional[Sighting]]:
    import rosbag

    try:
        with rosbag.Bag(path) as bag:
            return [_sighting(message) for _, message, _ in bag.read_messages(topics=[names.SPOTS])]
    except (OSError, rosbag.ROSBagException) as error:
        raise CodedError("bad_file", file=path, why=str(error)) from None


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("calibrate_camera", description="Finds the pose of a ceiling camera in the map.")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    commands.required = True
    board_paper = dict(default="A3", help="of the board: A4, A3 (default), A2, A1, A0")

    printed = commands.add_parser("print_board", help="write the board as PDF or PNG, at true size")
    printed.add_argument("file")
    printed.add_argument("--paper", **board_paper)

    guided = argparse.ArgumentParser(add_help=False)
    guided.add_argument("camera", help="its name: /NAME/image_raw, /NAME/camera_info")
    guided.add_argument(
        "--image", default="", help="image topic; default: that of its running detector, else NAME/image_raw"
    )
    guided.add_argument("--camera_info", default="", help="camera_info topic, if it is not beside the image topic")
    guided.add_argument("--compressed", action="store_true", help="take the compressed images")
    guided.add_argument("--frame", default="", help="optical frame; default: what the images say")
    guided.add_argument("--timeout", type=float, default=15.0, help="[s] for the first image; default: %(default)s")
    guided.add_argument(
        "--folder",
        default="",
        help="where NAME.yaml is written; default: where the running lab.launch looks "
        f"for it, {FOLDER} if none is running",
    )

    board = commands.add_parser("board", parents=[guided], help="from a printed board on known places")
    board.add_argument("--paper", **board_paper)
    board.add_argument("--square", type=float, help="[m] side of a square as measured, if the print is not exact")
    board.add_argument(
        "--placement_sigma",
        type=float,
        default=PoseEstimationParams.placement_sigma,
        help="[m] how exactly P1 and P2 lie on their places; default: %(default)s",
    )
    spots = commands.add_parser("spots", parents=[guided], help="from laser spots on known places")
    spots.add_argument(
        "--point_sigma",
        type=float,
        default=PoseEstimationParams.point_sigma,
        help="[m] how exactly the places are known; default: %(default)s, as clicked in RViz",
    )

    agreed = commands.add_parser("check", help="how well cameras that overlap agree")
    agreed.add_argument("--seconds", type=float, default=30.0, help="how long to listen to live spots")
    agreed.add_argument("--bag", default="", help=f"read {names.SPOTS} from a bag instead")
    agreed.add_argument("--limit", type=float, default=2.0, help="[cm] median distance up to which the status is 0")
    return parser


def main() -> int:
    """Runs the command; see --help."""
    arguments = _parser().parse_args(rospy.myargv()[1:])
    cv2.setNumThreads(1)
    try:
        if arguments.command == "print_board":
            for line in write_board(BoardParams.for_paper(arguments.paper), arguments.paper, arguments.file):
                print_line(line)
            return 0
        if arguments.command == "check":
            return check(arguments)
        rospy.init_node("calibrate_camera", anonymous=True)
        arguments.folder = arguments.folder or str(rospy.get_param("/camera_poses/calibration_dir", FOLDER))
        return (BoardCalibrationDialog if arguments.command == "board" else SpotCalibrationDialog)(arguments).run()
    except CodedError as error:
        print(f"calibrate_camera: {error}", file=sys.stderr)
        return 1
    except (KeyboardInterrupt, rospy.ROSInterruptException):
        return 1
