"""Sets up a camera that its detector reads directly: lens, delay, exposure."""

from __future__ import annotations

import argparse
import http.server
import random
import sys
import threading
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Deque, Dict, List, Tuple

import cv2
import dynamic_reconfigure.client
import numpy as np
import rospy
from dynamic_reconfigure import DynamicReconfigureException
from sensor_msgs.msg import CameraInfo

from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError
from vb_core.image_format import AnyPicture
from vb_core.ros.images import camera_from_info
from vb_laser_detect.calibration.lens import BoardParams, LensCalibration, find_board
from vb_laser_detect.camera.camera_files import save_lens, set_capture
from vb_laser_detect.camera.delay import brightness, measure_delay
from vb_laser_detect.camera.exposure import WHITE, Brightness, find_exposure, measure_brightness
from vb_laser_detect.camera.source import printable
from vb_laser_detect.ros.camera_feed import ReceivedImage, lens_path, subscribe_images
from vb_laser_detect.ros.camera_geometry import is_rectified, require_size, sibling_topic
from vb_laser_detect.detection.spot_detector import DetectorParams
from vb_laser_detect.detector_params import image_topic

_TIMEOUT, _POLL_PERIOD = 15.0, 0.005  # [s] to wait for the next image, and between two polls
_SETTLED = 0.5  # [s] until a new exposure time shows in the images
_BLINKS, _MIN_BLINK, _MAX_BLINK = 40, 0.25, 0.65  # number of switches; shortest and longest time [s] between two
_SPOT_TIMEOUT = 30.0  # [s]
_USUAL_WHITE = 4600  # [K] between lamps and daylight: that it is constant matters, not its value
_WIDTH = 960  # [px] of the live picture


class CameraImages:
    """The images and settings of a camera whose detector is running.

    Args:
        own_source: whether to raise CodedError "no_source" unless its detector reads the camera directly.

    Subscribed topics:
        <image> (sensor_msgs/Image) or <image>/compressed (sensor_msgs/CompressedImage); camera_info beside it

    Attributes:
        params: its detector's parameters.
        detector_params: those of the search, by default a stationary camera's.
        frame: its optical frame, from the detector's parameters, else from the images ("" before the first).
    """

    def __init__(self, camera: str, own_source: bool = True) -> None:
        self._camera = camera
        self.params: Dict[str, Any] = rospy.get_param(f"/spot_detector_{camera}", {})
        if own_source and not self.params.get("source"):
            raise CodedError("no_source", camera=camera)
        self.detector_params = DetectorParams.from_mapping(self.params.get("detector", {}), "detector")
        self.settings = str(self.params.get("settings", ""))
        self.frame = str(self.params.get("frame", ""))
        self._newest: Deque[ReceivedImage] = deque(maxlen=1)
        self._image = "/" + image_topic(camera, self.params.get("image", "")).lstrip("/")
        transport = str(self.params.get("image_transport"))
        self._topic = subscribe_images(self._image, transport, self.frame, self._newest.append)

    def next(self, earliest: float = 0.0) -> Tuple[float, AnyPicture]:
        """Waits for an image taken no earlier than a time [s]; returns its stamp [s] and the image.

        Raises:
            CodedError: "no_images", "bad_image", "unknown_encoding"
        """
        end = time.monotonic() + _TIMEOUT
        while time.monotonic() < end and not rospy.is_shutdown():
            if not self._newest:
                rospy.rostime.wallsleep(_POLL_PERIOD)
                continue
            received = self._newest.popleft()
            self.frame = received.frame_id
            if received.stamp.to_sec() >= earliest:
                return received.stamp.to_sec(), received.decode()
        raise CodedError("no_images", topics=self._topic)

    def model(self) -> CameraModel:
        """Waits for an image and camera_info; returns the camera's model.

        Raises:
            CodedError: "no_images"; "camera_no_lens" if images arrive without camera_info; "bad_camera_info" if the lens
                is not calibrated; "unsupported_camera"; "no_camera_info" if camera_info is for images of another size.
        """
        info, size = sibling_topic(self._image, "camera_info"), self.next()[1].size
        try:
            message = rospy.wait_for_message(info, CameraInfo, _TIMEOUT)
        except rospy.ROSException:
            raise CodedError("camera_no_lens", camera=self._camera, why=f"nothing arrives on {info}") from None
        return require_size(camera_from_info(message, is_rectified(self._image)), size)

    def set(self, **values: Any) -> None:
        """Changes settings of the running camera.

        Raises:
            CodedError: "control_refused" if the camera did not take them; "detector_missing"
        """
        try:
            client = dynamic_reconfigure.client.Client(f"/spot_detector_{self._camera}/capture", timeout=_TIMEOUT)
            accepted = client.update_configuration(values)
        except (rospy.ROSException, DynamicReconfigureException):
            raise CodedError("detector_missing", camera=self._camera) from None
        client.close()
        refused = [name for name, value in values.items() if accepted[name] != value]
        if refused:
            raise CodedError("control_refused", source=printable(self.params["source"]), why=", ".join(refused))

    def keep(self, **values: Any) -> None:
        """Writes settings into the camera's settings file, or prints them if there is none."""
        if not self.settings:
            print("put this into the camera's settings:  capture: " + str(values).replace("'", ""))
            return
        set_capture(Path(self.settings).expanduser(), values)
        print(f"wrote {self.settings}")


class LivePicture:
    """Serves a changing picture to browsers on this computer."""

    def __init__(self) -> None:
        self._jpeg = b""
        outer = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                image = self.path.startswith("/image")
                body = outer._jpeg if image else _PAGE
                self.send_response(200)
                self.send_header("Content-Type", "image/jpeg" if image else "text/html")
                self.send_header("Cache-Control", "no-store")
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: Any) -> None:
                pass

        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.address = f"http://127.0.0.1:{self._server.server_address[1]}/"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def show(self, image: np.ndarray) -> None:
        """Replaces the picture."""
        small = cv2.resize(image, (_WIDTH, round(image.shape[0] * _WIDTH / image.shape[1])))
        self._jpeg = cv2.imencode(".jpg", small)[1].tobytes()


_PAGE = b"""<!doctype html><title>Lens</title><body style="margin:0;background:#222"><img id=i style="width:100%">
<script>const i=document.getElementById("i");i.onload=i.onerror=()=>setTimeout(()=>i.src="image?"+Date.now(),150);i.src="image"</script>"""


def calibrate_lens(arguments: argparse.Namespace) -> int:
    """Collects views of the board until they suffice, then writes the lens file."""
    images = CameraImages(arguments.camera)
    board = BoardParams.for_paper(arguments.paper)
    board = board if arguments.square is None else board.replace(square=arguments.square)
    lens, picture = LensCalibration(images.next()[1].size), LivePicture()
    print("Hold the board before the camera: near and far, at every edge of the picture, turned and tilted, and still.")
    print(f"The live picture: {picture.address}    Ctrl-C ends without writing.")
    while not rospy.is_shutdown():
        image = images.next()[1].bgr()
        _look_for_board(lens, board, image, picture)
        try:
            camera, rms = lens.solve()
        except CodedError:
            continue
        path = lens_path(images.settings, arguments.camera)
        save_lens(path, arguments.camera, camera)
        print(
            f"wrote {path}: focal length {camera.focal_px:.0f} px, error {rms:.2f} px; the running lab takes it within seconds"
        )
        return 0
    return 1


def _look_for_board(lens: LensCalibration, board: BoardParams, image: np.ndarray, picture: LivePicture) -> None:
    """Adds the board's view if it is new; draws the board's corners, and the cells that are not covered yet."""
    text = "no board"
    try:
        view = find_board(board, image)
        if lens.add(view):
            print(f"  {lens.describe()}", flush=True)
        text = ""
        for u, v in view.pixels:
            cv2.circle(image, (round(u), round(v)), max(4, image.shape[1] // 240), (0, 220, 0), -1)
    except CodedError as error:
        text = error.message
    height, width = image.shape[:2]
    for cell in np.argwhere(~lens.covered):
        corners = ((corner * (width, height) // lens.covered.shape).tolist() for corner in (cell, cell + 1))
        cv2.rectangle(image, *corners, (0, 140, 255), max(1, width // 640))
    for line, words in enumerate((lens.describe(), text)):
        cv2.putText(
            image, words, (10, (line + 1) * height // 18), cv2.FONT_HERSHEY_SIMPLEX, height / 700, (0, 0, 255), 2
        )
    picture.show(image)


def measure_camera_delay(arguments: argparse.Namespace) -> int:
    """Makes this terminal's window blink, and measures how late the camera's images show that."""
    images = CameraImages(arguments.camera)
    print(
        "Let the camera see this window, as large as it can be and in a dim room. It blinks for 20 s; do not move anything."
    )
    time.sleep(3.0)
    images.next()
    ended = threading.Event()

    def watch() -> List[Tuple[float, np.ndarray]]:
        levels = []
        while not ended.is_set():
            stamp, image = images.next()
            levels.append((stamp, brightness(image.gray())))
        return levels

    with ThreadPoolExecutor() as pool:
        watching = pool.submit(watch)
        try:
            switched = _blink()
        finally:
            ended.set()
    seconds, uncertainty = measure_delay(switched, watching.result())
    old_delay_ms = float(images.params.get("capture", {}).get("delay_ms", 0.0))
    delay_ms = round(max(0.0, old_delay_ms + 1e3 * seconds), 1)
    print(
        f"The images are {delay_ms:.0f} ms late, to within {1e3 * uncertainty:.0f} ms; the screen's own delay, often 20 to "
        "50 ms, is in it."
    )
    images.set(delay_ms=delay_ms)
    images.keep(delay_ms=delay_ms)
    return 0


def _blink() -> List[float]:
    """Turns the terminal's window white and black at irregular times; returns these times [s]."""
    switched = []
    try:
        for number in range(_BLINKS):
            # white or black, whatever the terminal's own colours are, and without text
            sys.stdout.write("\x1b[40m\x1b[2J" if number % 2 else "\x1b[107m\x1b[2J")
            sys.stdout.flush()
            switched.append(rospy.Time.now().to_sec())
            time.sleep(random.uniform(_MIN_BLINK, _MAX_BLINK))
        time.sleep(3.0)  # for images that arrive late
    finally:
        sys.stdout.write("\x1b[0m\x1b[2J\x1b[H")
        sys.stdout.flush()
    return switched


def set_exposure(arguments: argparse.Namespace) -> int:
    """Finds an exposure time at which the floor is grey, and checks that the laser spot is then white."""
    images = CameraImages(arguments.camera)

    def try_exposure(exposure: int) -> Brightness:
        images.set(exposure=exposure)
        return measure_brightness(images.next(rospy.Time.now().to_sec() + _SETTLED)[1].bgr())

    capture = images.params.get("capture", {})
    old_values = {name: capture.get(name, 0) for name in ("exposure", "white_balance")}
    try:
        values = {"exposure": find_exposure(try_exposure, lambda text: print(f"  {text}", flush=True))}
        try:
            images.set(white_balance=_USUAL_WHITE)
            values["white_balance"] = _USUAL_WHITE
        except CodedError as error:
            print(f"! the white balance stays automatic: {error.message}")
        images.keep(**values)
    except BaseException:  # also Ctrl-C: the running lab keeps the settings it had
        images.set(**old_values)
        raise
    print(f"Point the laser at the floor ({_SPOT_TIMEOUT:.0f} s) ...", flush=True)
    levels_before = images.next()[1].bgr().max(axis=2)
    end = time.monotonic() + _SPOT_TIMEOUT
    while time.monotonic() < end:
        new = (images.next()[1].bgr().min(axis=2) >= WHITE) & (levels_before < WHITE)
        if 3 <= np.count_nonzero(new) < 0.001 * new.size:
            print(f"The spot is white, {np.count_nonzero(new)} px: this is a good exposure.")
            return 0
    print("No white spot was seen. If the laser was on the floor, its light is too weak for a floor as bright as this.")
    return 1
