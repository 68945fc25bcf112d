"""Takes screenshots of the smart display in every state, for the docs.

    scripts/screenshots [--out docs/images/display] [--world file]

The one idea: the screenshots show the system itself. This script is the person: it moves a laser spot and gives
commands. Whatever the display shows of it comes from the live system's nodes, but for the cameras, whose spots are
published here, and the robot, which is where this script says. It starts its own master and virtual screens, so it
needs neither ROS running nor a display.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any, Callable, Iterator, List, Optional, Sequence

import cv2
import numpy as np
import rosgraph
import rospy
import tf2_ros
from geometry_msgs.msg import Point, PoseStamped
from nav_msgs.msg import Path as PathMessage
from shapely.geometry import Polygon

from vb_core import geometry, names, sentences
from vb_core.errors import CodedError
from vb_core.notices import Notice, Severity
from vb_core.ros import commands, services
from vb_core.ros.messages import OccupancyGridArray, message_from_grid, message_from_transform, points_from_array
from vb_core.ros.notices import message_from_notice
from vb_evaluation.observer import Observer, wait_until
from vb_evaluation.processes import Child, free_port, roslaunch, screenshot, start_screen
from vb_msgs.msg import LaserSpot, NoticeArray, VirtualBorder
from vb_msgs.srv import AddBorder, AddBorderRequest
from vb_sim.room import floor_plan
from vb_sim.room.world import Scenario, World, load_world

SIZE = (1280, 720)
PLAN = "/move_base/NavfnROS/plan"
OFFSETS = 0.025 * np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]])  # [m] by which cameras see the same spot elsewhere
STEP, PERIOD = 0.015, 0.04  # [m] from one image to the next
LOOK_PERIOD = 1.5  # [s] between two looks at the screen: several frames of RViz, also where software draws them
SAME = 0.002  # share of pixels that may differ between two screenshots of the same: the interaction's time goes on
TIMEOUT = 180.0


def main(arguments: Optional[List[str]] = None, top: Optional[Path] = None) -> int:
    """Takes the screenshots; 0 if all could be taken."""
    top = top or Path.cwd()
    parser = argparse.ArgumentParser(prog="screenshots", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--world", default=str(top / "src/vb_sim/worlds/lab.yaml"), help="a world file")
    parser.add_argument("--out", type=Path, default=top / "docs/images/display", help="folder for the pictures")
    parser.add_argument("--language", default=sentences.ENGLISH, choices=sentences.languages(), help="of the display")
    given = parser.parse_args(arguments)
    os.environ.update(LIBGL_ALWAYS_SOFTWARE="1", QT_X11_NO_MITSHM="1")
    port = free_port()
    os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{port}"
    try:
        world = load_world(given.world)
        given.out.mkdir(parents=True, exist_ok=True)
        with contextlib.ExitStack() as stack, tempfile.TemporaryDirectory() as folder:
            os.environ["ROS_LOG_DIR"] = f"{folder}/log"
            stack.callback(Child(["rosmaster", "--core", "-p", str(port)], Path(folder, "master.txt")).stop)
            if not wait_until(rosgraph.is_master_online, TIMEOUT):
                raise CodedError("not_ready", "the ROS master did not come up")
            rospy.init_node("screenshots", disable_signals=True, log_level=rospy.ERROR)
            stack.callback(rospy.signal_shutdown, "all pictures are taken")
            lab = StagedLab(world)
            stack.callback(lab.close)
            _take(lab, Path(folder), top, given.out, given.language)
    except CodedError as error:
        print(f"screenshots: {error}", file=sys.stderr)
        return 1
    return 0


def _take(lab: "StagedLab", folder: Path, top: Path, out: Path, language: str) -> None:
    """Starts the system with a screen of its own, and takes all pictures."""
    with contextlib.ExitStack() as stack:
        screen, os.environ["DISPLAY"] = start_screen(folder / "xvfb.txt", *SIZE)
        stack.callback(screen.stop)
        parts = top / "launch" / "parts"
        files = [parts / "borders.launch", parts / "feedback.launch"]
        launched = roslaunch(files, folder / "launch.txt", state=folder, record=False, language=language)
        stack.callback(launched.stop)
        seen = Observer()
        if not wait_until(lambda: lab.is_watched() and seen.state is not None and seen.posterior is not None, TIMEOUT):
            raise CodedError("not_ready", f"the system did not come up: {launched.tail()}")
        last: List[np.ndarray] = []
        for name in _play(lab, seen):
            path = out / f"{name}_{SIZE[1]}.png"
            last = [still_picture(os.environ["DISPLAY"], path, last)]
            if shutil.which("convert"):  # a palette: a quarter of the size, and invisible in an image of flat colours
                subprocess.run(["convert", str(path), "-strip", "-colors", "128", f"PNG8:{path}"], check=False)
            print(f"wrote {path}", flush=True)


def _play(lab: "StagedLab", seen: Observer) -> Iterator[str]:
    """Draws a border as a person does; yields the name of each picture once it is to be taken."""
    drawn = min(lab.world.scenarios.values(), key=lambda scenario: not scenario.closed)
    inside = (*(0.25 * drawn.seed + 0.75 * drawn.border[0]), 0.6)
    stored = _stored(lab.world, drawn)
    for border in stored:
        request = AddBorderRequest(border=border, source="screenshots")
        services.call(names.ADD_BORDER, AddBorder, request, "$map_integrator")
    _until(lambda: len(seen.borders) == len(stored), "the stored borders")
    lab.show(lab.start)
    yield "default"
    yield from _draw(lab, seen, drawn)
    _send_command(seen, "define_seed", "seed")
    lab.show(inside)
    lab.point(drawn.seed + np.linspace((0.1, 0.1), (0.12, 0.1), 60), lab.cameras[:2])
    yield "seed_mind"
    lab.show(lab.start)
    lab.point(drawn.seed + np.linspace((-0.04, 0.02), (0.0, 0.0), 60), lab.cameras[:2])
    yield "seed"
    lab.rest()
    _send_command(seen, "save", "default")
    _until(lambda: len(seen.borders) == len(stored) + 1, "the new border")
    yield "saved"
    # the robot's driver says this; here is no robot that could drive
    values = {"who": sentences.robot_value(""), "border": seen.borders[-1].name}
    lab.show(inside, Notice("robot_inside_border", Severity.WARNING, values=values))
    yield "robot_in_border"
    yield from _guide(lab, seen, drawn.guide[0] if len(drawn.guide) else drawn.stand)


def _draw(lab: "StagedLab", seen: Observer, drawn: Scenario) -> Iterator[str]:
    """Draws most of a border, tries to save it, and draws the rest; the robot stands beside it and sees it too."""
    line = geometry.resample_chain(np.vstack([drawn.border, drawn.border[:1]]) if drawn.closed else drawn.border, STEP)
    shown = int(0.62 * len(line))
    away = np.array(lab.start[:2]) - line[shown]
    _send_command(seen, "define_border", "border")
    lab.show((*(line[shown] + away / np.linalg.norm(away)), lab.start[2]), way=True)
    lab.point(line[:shown], lab.cameras)
    yield "border"
    lab.rest()
    _send_command(seen, "save", "border")
    yield "refusal"
    lab.point(line[shown:], lab.cameras)


def _guide(lab: "StagedLab", seen: Observer, place: np.ndarray) -> Iterator[str]:
    """Guides the robot from its start towards a place (2,) [m], and stops it."""
    along = geometry.resample_chain(np.array([lab.start[:2], place]), STEP)
    _send_command(seen, "guide_robot", "guide")
    lab.show((*along[len(along) // 2], float(np.arctan2(*(along[-1] - along[0])[::-1]))))
    lab.point(along[len(along) // 2 :], ["robot"])
    yield "guide"
    lab.rest()
    _send_command(seen, "stop", "guide")
    yield "stopped"
    for command, state in (("resume", "guide"), ("cancel", "default")):
        _send_command(seen, command, state)


def _stored(world: World, drawn: Scenario) -> List[VirtualBorder]:
    """Returns the smallest of the other scenarios as a hard border, and things on the floor elsewhere as soft ones."""
    others = sorted(
        (one for one in world.scenarios.values() if one is not drawn), key=lambda one: Polygon(one.region).area
    )
    found = [(one.title.replace(" exclusion", ""), one.border, one.seed, one.closed, 1.0) for one in others[:1]]
    outlines = [(patch.name.capitalize(), patch.footprint()) for patch in world.patches]
    found += [
        (name, outline, outline.mean(axis=0), True, 0.5)
        for name, outline in outlines
        if not Polygon(outline).intersects(Polygon(drawn.region))
    ]
    return [
        VirtualBorder(
            name=name,
            points=points_from_array(points),
            seed=Point(*seed, 0.0),
            occupancy=occupancy,
            enabled=True,
            kind=VirtualBorder.POLYGON if closed else VirtualBorder.SEPARATING_CURVE,
        )
        for name, points, seed, closed, occupancy in found
    ]


def _send_command(seen: Observer, command: str, state: str) -> None:
    """Repeats a command until its state is reached, as a person would."""

    def accepted() -> bool:
        request = commands.make_request(command, "screenshots", TIMEOUT, seen_stop=seen.state.stop_number)
        commands.send(request, TIMEOUT, TIMEOUT)
        return wait_until(lambda: seen.state.name == state, 10.0)

    _until(accepted, f"the state {state}")


def _until(condition: Callable[[], Any], what: str) -> None:
    if not wait_until(condition, TIMEOUT):
        raise CodedError("not_shown", f"{what} did not come")


def still_picture(display: str, path: Path, before: Sequence[np.ndarray]) -> np.ndarray:
    """Takes a screenshot once the screen is still and differs from the one before; on a busy machine RViz lags.

    Raises:
        CodedError: "no_picture" if it cannot be taken, or if the screen does not change or does not come to rest.
    """
    deadline, shown = time.monotonic() + TIMEOUT, [np.zeros((1, 1, 3), np.uint8)] * 2
    while time.monotonic() < deadline:
        time.sleep(LOOK_PERIOD)
        if not screenshot(display, path):
            raise CodedError("no_picture", f"'import' of ImageMagick could not write {path}")
        shown = [*shown[-2:], cv2.imread(str(path))]
        if (
            _alike(shown[0], shown[2])
            and _alike(shown[1], shown[2])
            and not any(_alike(one, shown[2]) for one in before)
        ):
            return shown[2]
    raise CodedError("no_picture", f"RViz did not come to show what {path.name} is to show")


def _alike(one: np.ndarray, other: np.ndarray) -> bool:
    """Returns whether few pixels differ clearly; fading spots hardly do."""
    return one.shape == other.shape and float((cv2.absdiff(one, other).max(axis=2) > 40).mean()) <= SAME


class StagedLab:
    """Publishes the nodes' inputs: the map, the robot's pose, and a laser spot again and again, as it fades."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.cameras = [camera.name for camera in world.cameras][-2:] + ["robot"]
        self.start = world.robots[0].start_pose()
        self._robot, self._notices = self.start, []  # type: ignore[var-annotated]
        self._line: List[np.ndarray] = []
        self._cameras: Sequence[str] = ()
        self._map = rospy.Publisher(names.PHYSICAL_MAP, OccupancyGridArray, queue_size=1, latch=True)
        self._plan = rospy.Publisher(PLAN, PathMessage, queue_size=1, latch=True)
        self._notices_publisher = rospy.Publisher(names.NOTICES, NoticeArray, queue_size=1)
        self._spots = rospy.Publisher(names.SPOTS, LaserSpot, queue_size=50)
        self._transforms = tf2_ros.TransformBroadcaster()
        self._map.publish(message_from_grid(floor_plan.physical_map(world), rospy.Time.now()))
        self._running = True
        self._thread = threading.Thread(target=self._move, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Ends the background activity."""
        self._running = False
        self._thread.join()

    def is_watched(self) -> bool:
        """Returns whether RViz is subscribed: no other node takes the path."""
        return self._plan.get_num_connections() > 0

    def show(self, robot: Sequence[float], *notices: Notice, way: bool = False) -> None:
        """Publishes the robot's pose [m, m, rad], with the path that it came if wanted, and what its driver says."""
        path = PathMessage()
        path.header.frame_id = names.MAP_FRAME
        for x, y in geometry.resample_chain(np.array([self._robot[:2], robot[:2]]), 0.1) if way else ():
            path.poses.append(PoseStamped(header=path.header))
            path.poses[-1].pose.position, path.poses[-1].pose.orientation.w = Point(x, y, 0.0), 1.0
        self._plan.publish(path)
        self._robot, self._notices = robot, [message_from_notice(notice) for notice in notices]

    def point(self, line: np.ndarray, cameras: Sequence[str]) -> None:
        """Moves the spot along a line (N, 2) [m], seen by cameras; it stays at the end."""
        self._line, self._cameras = list(line), cameras
        _until(lambda: len(self._line) == 1, "the spot")

    def rest(self) -> None:
        """Switches the pointer off."""
        self._cameras = ()

    def _move(self) -> None:
        while self._running:
            now = rospy.Time.now()
            self._notices_publisher.publish(source="/screenshots", notices=self._notices)
            self._transforms.sendTransform(
                message_from_transform(geometry.transform_from_pose2d(*self._robot), names.MAP_FRAME, "base_link", now)
            )
            for camera, offset in zip(self._cameras, OFFSETS):
                spot = LaserSpot(
                    camera=camera,
                    mobile=camera == "robot",
                    confidence=1.0,
                    position=Point(*(self._line[0] + offset), 0.0),
                )
                spot.header.stamp, spot.header.frame_id = now, names.MAP_FRAME
                self._spots.publish(spot)
            if len(self._line) > 1:
                self._line.pop(0)
            rospy.rostime.wallsleep(PERIOD)
