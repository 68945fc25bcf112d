"""Takes screenshots of the smart display in every state, for the docs: real RViz and display_markers, scripted messages.

    scripts/screenshots [--out docs/images/display] [--world file] [--only seed]

Starts its own master and a virtual screen for each size, so it needs neither ROS running nor a display.
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
from typing import Any, Dict, List, Optional, Tuple

import cv2
import numpy as np
import rosgraph
import rospkg
import rospy
import tf2_ros
from geometry_msgs.msg import Point, PoseStamped
from nav_msgs.msg import Path as PathMessage

from vb_core import geometry, names, sentences
from vb_core.errors import CodedError
from vb_core.ros.messages import (
    BorderPreviewArray, OccupancyGridArray, message_from_grid, points_from_array, transform_message, values_from_mapping,
)
from vb_core.ros.notices import message_from_notice
from vb_evaluation.observer import wait_until
from vb_evaluation.processes import Child, free_port, screenshot, start_screen
from vb_evaluation.live.screenshot_scenes import Scene, scenes
from vb_feedback.display import rviz_config, rviz_fonts
from vb_feedback.display.layout import Box, plain
from vb_msgs.msg import (
    BorderProgress, BorderIssue, InteractionState, LaserSpot, NoticeArray, VirtualBorder, VirtualBorderArray,
)
from vb_sim.room import floor_plan
from vb_sim.room.world import load_world
from visualization_msgs.msg import Marker, MarkerArray

SIZES = ((1920, 1080), (1280, 720))
_PLAN = "/move_base/NavfnROS/plan"
# [s] between two looks at the screen: several frames of RViz, also where software draws them
_PAUSE_S = 1.0
# share of pixels that may differ between two screenshots of the same
_SAME = 0.0005
_PATIENCE_S = 180.0


def main(arguments: Optional[List[str]] = None, top: Optional[Path] = None) -> int:
    """Takes the screenshots; 0 if all could be taken."""
    top = top or Path.cwd()
    parser = argparse.ArgumentParser(prog="screenshots", description=__doc__.split("\n")[0])
    parser.add_argument("--world", default=str(top / "src/vb_sim/worlds/lab.yaml"), help="a world file")
    parser.add_argument("--out", default=str(top / "docs/images/display"), help="folder for the pictures")
    parser.add_argument("--language", default=sentences.ENGLISH, choices=sentences.languages(), help="of the display")
    parser.add_argument("--only", nargs="*", default=[], help="names of the states to be taken; default: all")
    given = parser.parse_args(arguments)
    try:
        world = load_world(given.world)
        wanted = [scene for scene in scenes(world) if not given.only or scene.name in given.only]
        if not wanted:
            raise CodedError("no_scene", f"known are {', '.join(scene.name for scene in scenes(world))}")
        out = Path(given.out)
        out.mkdir(parents=True, exist_ok=True)
        with contextlib.ExitStack() as stack, tempfile.TemporaryDirectory() as folder:
            _take(stack, Path(folder), top, world, wanted, out, given.language)
    except CodedError as error:
        print(f"screenshots: {error}", file=sys.stderr)
        return 1
    return 0


def _take(
    stack: contextlib.ExitStack, folder: Path, top: Path, world: Any, wanted: List[Scene], out: Path, language: str
) -> None:
    port = free_port()
    os.environ.update({
        "ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_LOG_DIR": str(folder / "log"), "LIBGL_ALWAYS_SOFTWARE": "1",
        "QT_X11_NO_MITSHM": "1",
    })
    stack.callback(_start(["rosmaster", "--core", "-p", str(port)], folder / "master.txt").stop)
    if not wait_until(rosgraph.is_master_online, _PATIENCE_S):
        raise CodedError("not_ready", "the ROS master did not come up")
    rospy.init_node("screenshots", disable_signals=True, log_level=rospy.ERROR)
    stack.callback(rospy.signal_shutdown, "all pictures are taken")
    stack.callback(_start(["rosrun", "vb_feedback", "display_markers", f"_language:={language}"], folder / "display_markers.txt").stop)
    grid = floor_plan.physical_map(world)
    stage = Stage(grid, language)
    letters = rviz_fonts.overlay(Path(rospkg.RosPack().get_path("rviz")), folder / "letters")
    path_with_letters = f"{letters}:{os.environ.get('ROS_PACKAGE_PATH', '')}"
    stack.callback(stage.close)
    for width, height in SIZES:
        with contextlib.ExitStack() as screen_stack:
            screen, display = start_screen(folder / "xvfb.txt", width, height)
            screen_stack.callback(screen.stop)
            config = folder / f"{width}.rviz"
            rviz_config.write_fitted(str(top / "rviz/smart_display.rviz"), config, Box.around(grid.corners()), width, height)
            rviz = _start(["rviz", "--fullscreen", "-d", str(config)], folder / "rviz.txt",
                          {"DISPLAY": display, "ROS_PACKAGE_PATH": path_with_letters})
            screen_stack.callback(rviz.stop)
            if not wait_until(stage.is_watched, _PATIENCE_S):
                raise CodedError("not_ready", f"RViz did not come up: {rviz.tail()}")
            before = None
            for scene in wanted:
                stage.show(scene)
                path = out / f"{scene.name}_{height}.png"
                before = _still_picture(display, path, before)
                _shrink(path)
                print(f"wrote {path}", flush=True)


def _start(command: List[str], log: Path, more: Optional[Dict[str, str]] = None) -> Child:
    return Child(command, log, {**os.environ, **(more or {})})


def _still_picture(display: str, path: Path, before: Optional[np.ndarray]) -> np.ndarray:
    """Takes a screenshot once the screen is still and differs from before; on a busy machine RViz lags.

    Raises:
        CodedError: "no_picture" if it cannot be taken, or if the screen does not change or does not come to rest.
    """
    deadline, still = time.monotonic() + _PATIENCE_S, 0
    last: Optional[np.ndarray] = None
    while time.monotonic() < deadline:
        time.sleep(_PAUSE_S)
        if not screenshot(display, path):
            raise CodedError("no_picture", f"'import' of ImageMagick could not write {path}")
        shown = cv2.imread(str(path))
        changed = before is None or _difference(shown, before) > _SAME
        still = still + 1 if changed and last is not None and _difference(shown, last) <= _SAME else 0
        if still == 2:
            return shown
        last = shown
    raise CodedError("no_picture", f"RViz did not come to show what {path.name} is to show")


def _difference(one: np.ndarray, other: np.ndarray) -> float:
    """Share of the pixels that differ clearly; fading spots hardly do."""
    return float((cv2.absdiff(one, other).max(axis=2) > 40).mean())


def _shrink(path: Path) -> None:
    """A palette of 128 colours: a quarter of the size, and it is invisible in an image of flat colours."""
    if shutil.which("convert"):
        subprocess.run(["convert", str(path), "-strip", "-colors", "128", f"PNG8:{path}"], check=False)


class Stage:
    """Publishes scenes as the system would."""

    def __init__(self, grid: Any, language: str) -> None:
        self._grid = grid
        self._language = language
        self._scene: Optional[Scene] = None
        self._said: Dict[Tuple[str, int], str] = {}
        latched: Dict[str, Any] = {"queue_size": 1, "latch": True}
        self._map = rospy.Publisher(names.PHYSICAL_MAP, OccupancyGridArray, **latched)
        self._posterior = rospy.Publisher(names.MAP_WITH_BORDERS, OccupancyGridArray, **latched)
        self._state = rospy.Publisher(names.STATE, InteractionState, **latched)
        self._progress = rospy.Publisher(names.PROGRESS, BorderProgress, **latched)
        self._preview = rospy.Publisher(names.PREVIEW, BorderPreviewArray, **latched)
        self._borders = rospy.Publisher(names.BORDERS, VirtualBorderArray, **latched)
        self._notices = rospy.Publisher(names.NOTICES, NoticeArray, **latched)
        self._plan = rospy.Publisher(_PLAN, PathMessage, **latched)
        self._spots = rospy.Publisher(names.SPOTS, LaserSpot, queue_size=50)
        self._transforms = tf2_ros.TransformBroadcaster()
        self._markers = rospy.Subscriber(names.MARKERS, MarkerArray, self._on_markers, queue_size=50)
        self._running = True
        self._thread = threading.Thread(target=self._move, daemon=True)
        self._thread.start()
        self._map.publish(message_from_grid(grid, rospy.Time.now()))

    def close(self) -> None:
        """Ends the background activity."""
        self._running = False
        self._thread.join()

    def is_watched(self) -> bool:
        """Whether RViz listens: it takes the path, which display_markers does not."""
        return self._plan.get_num_connections() > 0

    def show(self, scene: Scene) -> None:
        """Publishes a scene and waits until display_markers says its sentence."""
        now = rospy.Time.now()
        self._posterior.publish(message_from_grid(scene.posterior, now))
        self._borders.publish(borders=list(map(border_message, scene.borders)))
        self._progress.publish(self._progress_message(scene))
        self._preview.publish(self._preview_message(scene))
        path = PathMessage(poses=[PoseStamped() for _ in scene.path])
        path.header.frame_id = names.MAP_FRAME
        for pose, (x, y) in zip(path.poses, scene.path):
            pose.header.frame_id, pose.pose.position, pose.pose.orientation.w = names.MAP_FRAME, Point(x, y, 0.0), 1.0
        self._plan.publish(path)
        self._scene = scene
        self._state.publish(InteractionState(
            name=scene.state, interaction_id=scene.name if scene.state != "default" else "", border_s=scene.elapsed_s,
            commands=list(scene.commands), last_success=scene.success, last_code=scene.code, last_answered=now, stopped=scene.stopped,
        ))
        wanted = plain(sentences.say(scene.code or "display_start", {}, self._language))
        if not wait_until(lambda: self._answer() == wanted.split(), _PATIENCE_S, 0.05):
            raise CodedError("not_shown", f"display_markers did not show: {wanted}")

    def _answer(self) -> List[str]:
        said = sorted((key[1], text) for key, text in list(self._said.items()) if key[0] == "words/answer")
        return [text for _, text in said]

    def _on_markers(self, message: MarkerArray) -> None:
        for marker in message.markers:
            if marker.action == Marker.DELETEALL:
                self._said.clear()
            elif marker.action == Marker.DELETE:
                self._said.pop((marker.ns, marker.id), None)
            elif marker.type == Marker.TEXT_VIEW_FACING:
                self._said[marker.ns, marker.id] = marker.text

    def _progress_message(self, scene: Scene) -> BorderProgress:
        return BorderProgress(
            interaction_id=scene.name, cameras=list(scene.cameras), seeing=list(scene.seeing),
            points=points_from_array(scene.points), point_cameras=bytes(scene.point_cameras),
            chain=points_from_array(scene.chain), closed=scene.closed, has_seed=scene.seed is not None,
            seed=Point(*(scene.seed or (0.0, 0.0)), 0.0),
        )

    def _preview_message(self, scene: Scene) -> Any:
        if scene.region is None:
            return BorderPreviewArray(interaction_id=scene.name, region=message_from_grid(self._grid, rospy.Time.now()))
        region = self._grid.with_data(np.where(scene.region, 100, 0).astype(np.int8))
        return BorderPreviewArray(
            interaction_id=scene.name, available=True, success=True, area_m2=scene.area_m2,
            issues=[
                BorderIssue(severity=BorderIssue.WARNING, code=found.code, message=found.sentence(), values=values_from_mapping(found.values))
                for found in scene.issues
            ],
            region=message_from_grid(region, rospy.Time.now()),
        )

    def _move(self) -> None:
        """Robot and spots, over and over: they would fade."""
        while self._running:
            scene, now = self._scene, rospy.Time.now()
            if scene is not None:
                self._notices.publish(source="/screenshots", notices=list(map(message_from_notice, scene.notices)))
                pose = geometry.pose2d_transform(*scene.robot)
                self._transforms.sendTransform(transform_message(pose, names.MAP_FRAME, "base_link", now))
                for number, (camera, x, y) in enumerate(scene.spots):
                    age = rospy.Duration.from_sec(0.02 * (len(scene.spots) - 1 - number))
                    spot = LaserSpot(camera=camera, position=Point(x, y, 0.0))
                    spot.header.stamp, spot.header.frame_id = now - age, names.MAP_FRAME
                    self._spots.publish(spot)
            rospy.rostime.wallsleep(0.15)


def border_message(border: Any) -> VirtualBorder:
    """A border of the map integration, with the area it restricts, to a message."""
    plain, area_m2 = border
    return VirtualBorder(
        id=plain.name, name=plain.name, points=points_from_array(plain.points),
        kind=VirtualBorder.POLYGON if plain.closed else VirtualBorder.SEPARATING_CURVE,
        seed=Point(*plain.seed, 0.0), occupancy=plain.occupancy, enabled=plain.enabled, area_m2=area_m2,
    )
