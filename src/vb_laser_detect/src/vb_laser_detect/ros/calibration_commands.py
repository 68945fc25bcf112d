"""The commands of calibrate_camera that need a running detector's camera: lens, delay, exposure."""

from __future__ import annotations

import argparse
import random
import sys
import threading
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Deque, Dict, Iterable, List, Tuple

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
from vb_laser_detect.calibration.live_picture import LivePicture
from vb_laser_detect.camera.lens_and_settings_files import save_lens, set_capture
from vb_laser_detect.camera.delay import brightness, measure_delay
from vb_laser_detect.camera.exposure import SPOT_LEVEL, find_exposure
from vb_laser_detect.camera.camera_source import without_password
from vb_laser_detect.detection.spot_detector import DetectorParams
from vb_laser_detect.spot_detector_node_params import image_topic
from vb_laser_detect.ros.camera_feed import ReceivedImage, lens_path, subscribe_images
from vb_laser_detect.ros.camera_geometry import is_rectified, require_size, sibling_topic

_TIMEOUT = 15.0  # [s] to wait for the next image, camera_info or the detector's answer
_POLL_PERIOD = 0.005  # [s]
_SETTLING_TIME = 0.5  # [s] after which a new exposure time shows in the images
_BLINKS = 40  # switches of the window
_MIN_BLINK, _MAX_BLINK = 0.25, 0.65  # [s] between two switches
_SPOT_TIMEOUT = 30.0  # [s]
_WHITE_BALANCE = 4600  # [K] between lamps and daylight; only that it is constant matters


class RunningCamera:
    """A camera whose detector is running: its images, lens and settings.

    Args:
        own_source: whether the detector must read the camera directly; if it does not, CodedError "no_source" is raised.

    Subscribed topics:
        <image> (sensor_msgs/Image) or <image>/compressed (sensor_msgs/CompressedImage); camera_info beside it

    Attributes:
        params: parameters of the camera's detector.
        detector_params: the part of them that concerns the search; a stationary camera's if no detector runs.
        settings: path of the camera's settings file; "" if it has none.
        frame: optical frame from the detector's parameters, or else from the images ("" before the first one).
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

    def next_image(self, earliest: float = 0.0) -> Tuple[float, AnyPicture]:
        """Waits for an image taken no earlier than a time [s]; returns its stamp [s] and the picture.

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

    def read_lens(self) -> CameraModel:
        """Waits for an image and camera_info; returns the camera's model.

        Raises:
            CodedError: "no_images"; "camera_no_lens" if images arrive without camera_info; "bad_camera_info" if the lens
                is not calibrated; "unsupported_camera"; "no_camera_info" if camera_info is for images of another size.
        """
        topic = sibling_topic(self._image, "camera_info")
        size = self.next_image()[1].size
        try:
            message = rospy.wait_for_message(topic, CameraInfo, _TIMEOUT)
        except rospy.ROSException:
            raise CodedError("camera_no_lens", camera=self._camera, why=f"nothing arrives on {topic}") from None
        return require_size(camera_from_info(message, is_rectified(self._image)), size)

    def change_settings(self, **values: Any) -> None:
        """Changes capture settings of the running camera.

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
            raise CodedError("control_refused", source=without_password(self.params["source"]), why=", ".join(refused))

    def write_settings(self, **values: Any) -> None:
        """Writes capture settings into the camera's settings file, or prints them if there is none."""
        if not self.settings:
            print("put this into the camera's settings:  capture: " + str(values).replace("'", ""))
            return
        set_capture(Path(self.settings).expanduser(), values)
        print(f"wrote {self.settings}")


def calibrate_lens(arguments: argparse.Namespace) -> int:
    """Collects views of the board until they suffice, then writes the lens file."""
    camera = RunningCamera(arguments.camera)
    board = BoardParams.for_paper(arguments.paper)
    board = board if arguments.square is None else board.replace(square=arguments.square)
    calibration = LensCalibration(camera.next_image()[1].size)
    picture = LivePicture()
    print("Hold the board before the camera: near and far, at every edge of the picture, turned and tilted, and still.")
    print(f"The live picture: {picture.address}    Ctrl-C ends without writing.")
    while not rospy.is_shutdown():
        image = camera.next_image()[1].bgr()
        pixels = ()
        problem = ""
        try:
            view = find_board(board, image)
            pixels = view.pixels
            if calibration.add(view):
                print(f"  {calibration.describe()}", flush=True)
        except CodedError as error:
            problem = error.message
        _draw_progress(image, calibration, pixels, problem)
        picture.show(image)
        try:
            lens, rms = calibration.solve()
        except CodedError:
            continue
        path = lens_path(camera.settings, arguments.camera)
        save_lens(path, arguments.camera, lens)
        result = f"focal length {lens.focal_px:.0f} px, error {rms:.2f} px"
        print(f"wrote {path}: {result}; the running lab takes it within seconds")
        return 0
    return 1


def _draw_progress(image: np.ndarray, calibration: LensCalibration, pixels: Iterable, problem: str) -> None:
    """Draws the board's corners at `pixels`, the cells that are not covered yet, and two lines of text into an image."""
    height, width = image.shape[:2]
    radius = max(4, width // 240)
    for u, v in pixels:
        cv2.circle(image, (round(u), round(v)), radius, (0, 220, 0), -1)
    line_width = max(1, width // 640)
    for cell in np.argwhere(~calibration.covered):
        upper_left = cell * (width, height) // calibration.covered.shape
        lower_right = (cell + 1) * (width, height) // calibration.covered.shape
        cv2.rectangle(image, upper_left.tolist(), lower_right.tolist(), (0, 140, 255), line_width)
    for line, text in enumerate((calibration.describe(), problem), start=1):
        cv2.putText(image, text, (10, line * height // 18), cv2.FONT_HERSHEY_SIMPLEX, height / 700, (0, 0, 255), 2)


def measure_camera_delay(arguments: argparse.Namespace) -> int:
    """Makes this terminal's window blink, and measures how late the camera's images show that."""
    camera = RunningCamera(arguments.camera)
    request = "Let the camera see this window, as large as it can be and in a dim room."
    print(f"{request} It blinks for 20 s; do not move anything.")
    time.sleep(3.0)
    camera.next_image()
    blinking_ended = threading.Event()

    def watch() -> List[Tuple[float, np.ndarray]]:
        levels = []
        while not blinking_ended.is_set():
            stamp, image = camera.next_image()
            levels.append((stamp, brightness(image.gray())))
        return levels

    with ThreadPoolExecutor() as pool:
        levels = pool.submit(watch)
        try:
            switch_times = _blink()
        finally:
            blinking_ended.set()
    seconds, uncertainty = measure_delay(switch_times, levels.result())
    old_delay_ms = float(camera.params.get("capture", {}).get("delay_ms", 0.0))
    delay_ms = round(max(0.0, old_delay_ms + 1e3 * seconds), 1)
    result = f"{delay_ms:.0f} ms late, to within {1e3 * uncertainty:.0f} ms"
    print(f"The images are {result}; the screen's own delay, often 20 to 50 ms, is in it.")
    camera.change_settings(delay_ms=delay_ms)
    camera.write_settings(delay_ms=delay_ms)
    return 0


def _blink() -> List[float]:
    """Turns the terminal's window white and black at irregular times; returns these times [s]."""
    switch_times = []
    try:
        for number in range(_BLINKS):
            # white or black, whatever the terminal's own colours are, and without text
            sys.stdout.write("\x1b[40m\x1b[2J" if number % 2 else "\x1b[107m\x1b[2J")
            sys.stdout.flush()
            switch_times.append(rospy.Time.now().to_sec())
            time.sleep(random.uniform(_MIN_BLINK, _MAX_BLINK))
        time.sleep(3.0)  # some images arrive late
    finally:
        sys.stdout.write("\x1b[0m\x1b[2J\x1b[H")
        sys.stdout.flush()
    return switch_times


def set_exposure(arguments: argparse.Namespace) -> int:
    """Finds an exposure time at which the floor is grey, and checks that the laser spot is then white."""
    camera = RunningCamera(arguments.camera)

    def take_image(exposure: int) -> np.ndarray:
        camera.change_settings(exposure=exposure)
        return camera.next_image(rospy.Time.now().to_sec() + _SETTLING_TIME)[1].bgr()

    capture = camera.params.get("capture", {})
    old_values = {name: capture.get(name, 0) for name in ("exposure", "white_balance")}
    try:
        values = {"exposure": find_exposure(take_image, lambda text: print(f"  {text}", flush=True))}
        camera.change_settings(exposure=values["exposure"])  # not always the last one tried
        try:
            camera.change_settings(white_balance=_WHITE_BALANCE)
            values["white_balance"] = _WHITE_BALANCE
        except CodedError as error:
            print(f"! the white balance stays automatic: {error.message}")
        camera.write_settings(**values)
    except BaseException:  # the running lab keeps the settings that it had, after Ctrl-C too
        camera.change_settings(**old_values)
        raise
    print(f"Point the laser at the floor ({_SPOT_TIMEOUT:.0f} s) ...", flush=True)
    levels_before = camera.next_image()[1].bgr().max(axis=2)
    end = time.monotonic() + _SPOT_TIMEOUT
    while time.monotonic() < end:
        is_new = (camera.next_image()[1].bgr().min(axis=2) >= SPOT_LEVEL) & (levels_before < SPOT_LEVEL)
        if 3 <= np.count_nonzero(is_new) < 0.001 * is_new.size:
            print(f"The spot is white, {np.count_nonzero(is_new)} px: this is a good exposure.")
            return 0
    print("No white spot was seen. If the laser was on the floor, its light is too weak for a floor as bright as this.")
    return 1
