"""Tries any camera: you mark four corners of something on the floor, then draw borders, without knowledge of ROS.

    make try CAMERA=0        a webcam; also a device, an address (rtsp://, http://), or a video file
    make try                 plays the supplied video, unattended

A page shows the camera's picture and asks for the corners, from which the camera's pose is computed. The pose is
written into the folder of an ordinary lab, which then starts with its usual detector, fusion, integration and page.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import shutil
import sys
import time
import webbrowser
from collections import deque
from pathlib import Path
from typing import Callable, Deque, List, Optional, Tuple

import cv2
import numpy as np
import rosgraph
import rospkg
import rospy
import tornado.web
import yaml

from vb_bringup.new_lab import parse_source, write_lab
from vb_core import names
from vb_core.camera_model import project_to_floor
from vb_core.child_processes import ChildProcess, free_port, start_roslaunch
from vb_core.errors import CodedError
from vb_core.files import write_atomically
from vb_core.grid_map import GridMap
from vb_core.map_files import write_map
from vb_core.request_origin import may_use_local_page
from vb_core.ros import commands
from vb_core.ros.node import wait_until
from vb_laser_detect.calibration import pose_file
from vb_laser_detect.calibration.pose_file import CameraPose
from vb_laser_detect.calibration.pose import PosedCamera, project, click_uncertainty, estimate_camera_from_rectangle
from vb_laser_detect.camera.lens_and_settings_files import save_lens
from vb_laser_detect.camera.camera_report import describe_camera_command
from vb_laser_detect.camera.camera_source import CameraSource, CapturedImage, is_file
from vb_laser_detect.camera.v4l2_controls import CaptureParams
from vb_map_integration.border import VirtualBorder, borders_to_geojson
from vb_map_integration.border_messages import border_from_message
from vb_msgs.msg import LaserSpot, VirtualBorderArray

CAMERA = "camera"
PORT = 8420
_PACKAGE = Path(rospkg.RosPack().get_path("vb_bringup"))
_CELL = 0.025  # [m] of the map
_FAR = 10.0  # [m] from the camera, beyond which the floor is left out
_GRID = 0.5  # [m] between the lines that the page draws
_SEED_PAUSE = 1.0  # [s] without a spot between a line and its seed in the video
_REPEAT_PAUSE = 2.9  # [s] without a spot before the video begins again
_START_TIMEOUT, _PLAY_TIMEOUT = 60.0, 90.0  # [s]
_INSTRUCTIONS = (
    "On it: press Define border and draw; press Mark what is off limits and hold the spot there; press Save."
)
_REPEAT_NOTE = (
    " The film repeats. Press each button just before its part of the film. If you miss one, press Cancel and wait for the"
    " next round."
)


# ------------------------------------------------------------- the floor
def empty_map_of_seen_floor(view: PosedCamera) -> GridMap:
    """Returns an empty map of the floor that a camera sees. Raises CodedError "bad_rectangle" if it sees no near floor."""
    camera = view.camera
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, 60), np.linspace(0, camera.height - 1, 40))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    positions = project_to_floor(camera, view.T_map_camera, pixels)[:, :2]
    with np.errstate(invalid="ignore"):  # a pixel above the horizon has no position
        distances = np.linalg.norm(positions - view.T_map_camera[:2, 3], axis=1)
        positions = positions[distances < _FAR]
    if not len(positions):
        raise CodedError("bad_rectangle")
    low = positions.min(axis=0)
    columns, rows = np.ceil((positions.max(axis=0) - low) / _CELL).astype(int) + 1
    floor = GridMap(np.zeros((rows, columns), np.int8), _CELL, (*low, 0.0))
    cells = floor.cell_to_world(np.argwhere(floor.data == 0))
    in_view = camera.contains(project(camera, view.T_map_camera, cells)).reshape(floor.shape)
    return floor.with_data(np.where(in_view, np.int8(0), np.int8(-1)))


def grid_lines(view: PosedCamera, floor: GridMap) -> List[List[List[float]]]:
    """Returns lines on the floor every half metre, in pixels of the camera's picture, over which the page draws them."""
    low = floor.corners().min(axis=0)
    high = floor.corners().max(axis=0)
    lines = []
    for axis, other in ((0, 1), (1, 0)):
        first, last = np.ceil(low[axis] / _GRID), np.floor(high[axis] / _GRID)
        for number in np.arange(first, last + 1):
            positions = np.empty((40, 2))
            positions[:, axis] = number * _GRID
            positions[:, other] = np.linspace(low[other], high[other], 40)
            pixels = project(view.camera, view.T_map_camera, positions)
            in_view = pixels[view.camera.contains(pixels)]
            if len(in_view) > 1:
                lines.append(np.round(in_view, 1).tolist())
    return lines


def write_camera_lab(folder: Path, source: str, view: PosedCamera) -> None:
    """Empties the lab's folder, and writes camera, lens, pose and an empty map into it.

    Raises:
        CodedError: "cannot_write_lab"
    """
    shutil.rmtree(str(folder), ignore_errors=True)
    write_map(folder.parent / "floor", empty_map_of_seen_floor(view))
    write_lab(folder, {CAMERA: source}, "", folder.parent / "floor.yaml", _PACKAGE / "robots")
    save_lens(folder / "lenses" / f"{CAMERA}.yaml", CAMERA, view.camera)
    pose = CameraPose(CAMERA, names.MAP_FRAME, f"{CAMERA}_optical_frame", view.T_map_camera, view.camera.focal_px)
    pose_file.write_pose(folder / "calibration" / f"{CAMERA}.yaml", pose, ["from a rectangle on the floor"])


# ------------------------------------------------------------- the page that asks for the corners
class CornerPage:
    """Shows the camera's picture, and asks for the four corners of a rectangle on the floor."""

    def __init__(self, source: str) -> None:
        self.fault: Optional[CodedError] = None  # why the camera sends no pictures, if that is known
        self._newest: Deque[CapturedImage] = deque(maxlen=1)
        self._source = CameraSource(source, CaptureParams(), self._newest.append, self._set_fault)
        self._source.start()

    def _set_fault(self, error: Optional[CodedError]) -> None:
        fault = None if error is None else CodedError(error.code, **{**error.values, "camera": "1"})
        if fault is not None and str(fault) != str(self.fault):
            print(f"  {fault.message}\n  If this does not help, end it with Ctrl-C, and report what this prints:")
            print(f"    . scripts/env.sh; {describe_camera_command(self._source.address)}", flush=True)
        self.fault = fault

    async def ask(self, port: int) -> PosedCamera:
        """Serves the page until somebody accepts the floor that it shows. Returns the camera's view of that floor."""
        self._accepted: asyncio.Queue = asyncio.Queue()
        handlers = {r"/": _Page, r"/image\.jpg": _Picture, r"/(floor|start)": _Floor}
        routes = [(path, handler, {"page": self}) for path, handler in handlers.items()]
        application = tornado.web.Application(routes, log_function=lambda _handler: None)
        server = application.listen(port, "127.0.0.1")
        view = await self._accepted.get()
        await asyncio.sleep(0.3)  # until the browser has the answer
        server.stop()
        await server.close_all_connections()
        self._source.close()
        return view

    def picture(self) -> np.ndarray:
        """Returns the newest picture (H, W, 3) bgr. Raises a CodedError that says why there is none."""
        if not self._newest:
            raise CodedError("camera_opening") if self.fault is None else self.fault.without_traceback()
        return self._newest[-1].picture().pixels

    def accept(self, view: PosedCamera) -> None:
        """Makes `ask` return this view of the floor."""
        self._accepted.put_nowait(view)


class _Handler(tornado.web.RequestHandler):
    def initialize(self, page: CornerPage) -> None:
        self.page = page
        self.set_header("Cache-Control", "no-store")

    def prepare(self) -> None:
        request = self.request
        if not may_use_local_page(request.method, request.host, request.headers.get("Origin")):
            raise tornado.web.HTTPError(403)


class _Page(_Handler):
    def get(self) -> None:
        self.write((Path(__file__).with_name("try_camera.html")).read_text(encoding="utf-8"))


class _Picture(_Handler):
    def get(self) -> None:
        try:
            picture = self.page.picture()
            fault = self.page.fault
        except CodedError as error:
            fault = error
        if fault is not None:
            self.set_status(503)
            self.write(fault.message)
            return
        self.set_header("Content-Type", "image/jpeg")
        _, jpeg = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 85])
        self.write(jpeg.tobytes())


class _Floor(_Handler):
    """Answers marked corners with lines on the floor and the largest error of a spot. "start" also accepts them."""

    def post(self, step: str) -> None:
        try:
            height, width = self.page.picture().shape[:2]
            request = json.loads(self.request.body)
            corners = np.array(request["corners"], float).reshape(4, 2)
            size = float(request["width"]), float(request["depth"])
            view = estimate_camera_from_rectangle(corners, size, (width, height))
            floor = empty_map_of_seen_floor(view)
            some_cells = np.argwhere(floor.data == 0)[:: max(1, floor.data.size // 400)]
            pixels = project(view.camera, view.T_map_camera, floor.cell_to_world(some_cells))
            worst = click_uncertainty(corners, size, (width, height), pixels)
            if step == "start":
                self.page.accept(view)
            self.write({"lines": grid_lines(view, floor), "worst_cm": round(100.0 * min(worst, 9.99))})
        except CodedError as error:
            self.write({"error": error.message})
        except (ValueError, KeyError, TypeError):
            self.set_status(400)
            self.write({"error": CodedError("bad_rectangle").message})


# ------------------------------------------------------------- the lab
class TryLab:
    """The running lab: keeps the borders' file, and gives the commands that belong to the supplied video."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / "borders.geojson"
        self.borders: List[VirtualBorder] = []
        self._spot_at = time.monotonic()
        self._spots = 0
        rospy.Subscriber(names.BORDERS, VirtualBorderArray, self._on_borders, queue_size=5)
        rospy.Subscriber(names.SPOTS, LaserSpot, self._on_spot, queue_size=50)

    def _on_borders(self, message: VirtualBorderArray) -> None:
        borders = [border_from_message(border) for border in message.borders]
        known_ids = {border.id for border in self.borders}
        new_borders = [border for border in borders if border.id not in known_ids]
        if borders != self.borders:
            write_atomically(self._file, borders_to_geojson(borders).encode("utf-8"))
        self.borders = borders
        for border in new_borders:
            corners = " ".join(f"({x:.2f}, {y:.2f})" for x, y in border.points)
            print(f"  Border {border.name or border.id}: {corners} m, in {self._file}", flush=True)

    def _on_spot(self, _message: LaserSpot) -> None:
        self._spot_at = time.monotonic()
        self._spots += 1

    def play(self) -> None:
        """Gives the commands that the video needs: before its line, before its seed, and at its end.

        Raises:
            CodedError: "no_response" if the lab does not accept them, or if nothing was drawn.
        """
        self._wait(lambda: self._has_paused(_REPEAT_PAUSE))
        for command in ("define_border", "define_seed"):
            self._give(command)
            enough = self._spots + 5
            self._wait(lambda enough=enough: self._spots > enough and self._has_paused(_SEED_PAUSE))
        if self._give("save") == "confirm_save":  # the extraction was not quite certain of the line
            self._give("save")
        self._wait(lambda: bool(self.borders))

    @staticmethod
    def _give(command: str) -> str:
        answer = commands.send(commands.make_request(command, "try", 10.0))
        print(f"  {command}: {answer.message}", flush=True)
        return answer.code

    def _has_paused(self, seconds: float) -> bool:
        """Returns whether no spot has been seen for some seconds."""
        return time.monotonic() - self._spot_at > seconds

    @staticmethod
    def _wait(condition: Callable[[], bool]) -> None:
        if not wait_until(condition, _PLAY_TIMEOUT):
            raise CodedError("no_response", who_code="interaction_manager")


def find_view(camera: str, port: int) -> Tuple[str, PosedCamera]:
    """Returns the source of a camera's images, and the camera's view of the floor.

    For a camera, somebody marks the floor on a page at the port. The supplied video ("") comes with its floor.
    """
    if not camera:
        truth = yaml.safe_load((_PACKAGE / "example_video/room.yaml").read_text(encoding="utf-8"))
        size = truth["width"], truth["depth"]
        view = estimate_camera_from_rectangle(np.array(truth["corners"]), size, tuple(truth["image"]))
        return str(_PACKAGE / "example_video/room.mp4"), view
    source = parse_source(camera)
    address = f"http://127.0.0.1:{port}/"
    print(f"Open {address} and mark four corners of something on the floor whose size you know.", flush=True)
    webbrowser.open(address)
    return source, asyncio.run(CornerPage(source).ask(port))


def start_lab(folder: Path, port: int) -> ChildProcess:
    """Starts the lab in a folder, with its page at a port and with its own master, which this process then uses too."""
    master_port = free_port()
    os.environ.update(ROS_MASTER_URI=f"http://127.0.0.1:{master_port}", ROS_LOG_DIR=str(folder / "log"))
    print("Starting the detector, the map and the page ...", flush=True)
    log = folder / "log/roslaunch.txt"
    return start_roslaunch([folder / "lab/lab.launch"], log, master_port, rviz=False, page_port=port)


def run(arguments: Optional[List[str]] = None) -> int:
    """Finds the floor, starts the lab, and keeps the borders' file until Ctrl-C. Returns the exit status."""
    parser = argparse.ArgumentParser(prog="try_camera", description=__doc__.split("\n")[0])
    parser.add_argument("--camera", default="", help="number, device, address or file; left out: plays a video of ours")
    parser.add_argument("--out", type=Path, default=Path("out/try"), help="folder for the lab and the borders")
    parser.add_argument("--port", type=int, default=PORT, help="of the page")
    parser.add_argument("--once", action="store_true", help="end after the video's border was saved")
    options = parser.parse_args(arguments)
    folder = options.out.expanduser().resolve()
    port = free_port(options.port)
    source, view = find_view(options.camera, port)
    write_camera_lab(folder / "lab", source, view)
    lab = start_lab(folder, port)
    try:
        if not _wait_for_services(lab):
            print(lab.tail(), file=sys.stderr)
            return 1
        running = TryLab(folder)
        print(f"The page is at http://127.0.0.1:{port}/", flush=True)
        if options.camera:
            print(_INSTRUCTIONS + (_REPEAT_NOTE if is_file(source) else ""), flush=True)
        else:
            running.play()
            if options.once:
                return 0
        print("Ctrl-C ends it.", flush=True)
        while lab.running:
            time.sleep(0.5)
        return 1
    finally:
        lab.stop()


def _wait_for_services(lab: ChildProcess) -> bool:
    """Waits for the lab's master and for the services that saving a border needs. Returns whether all of them answer."""
    wait_until(lambda: rosgraph.is_master_online() or not lab.running, _START_TIMEOUT)  # roslaunch starts the master
    if not lab.running:
        return False
    try:
        rospy.init_node("try_camera", anonymous=True, disable_signals=True, log_level=rospy.ERROR)
        for service in (names.COMMAND, names.GET_DRAWN_BORDER, names.PREVIEW_BORDER):
            rospy.wait_for_service(service, _START_TIMEOUT)
    except rospy.ROSException:
        return False
    return True


def main() -> None:
    """Runs the program."""
    try:
        sys.exit(run())
    except CodedError as error:
        print(error, file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
