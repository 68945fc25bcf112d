"""Watches a running system over ROS and keeps what an evaluation needs."""
from __future__ import annotations

import json
import threading
import time
from typing import Callable, Dict, List, Optional, Tuple

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.srv import GetPlan
from sensor_msgs.msg import Image
from std_msgs.msg import String

from vb_core import names
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.ros import messages
from vb_msgs.msg import BorderProgress, DetectorStatus, InteractionState, LabState, LaserSpot, VirtualBorder, VirtualBorderArray


class Observer:
    """Subscribes to what the stack publishes about itself; every attribute is the newest value or None.

    Must be made after `rospy.init_node`. Nothing here commands the system but `plan`, which asks
    move_base for a plan.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.state: Optional[InteractionState] = None
        self.progress: Optional[BorderProgress] = None
        self.borders: List[VirtualBorder] = []
        self.prior: Optional[GridMap] = None
        self.posterior: Optional[GridMap] = None
        self.lab: Optional[LabState] = None
        self.detectors: Dict[str, DetectorStatus] = {}
        self._counted: Dict[str, Tuple[int, int]] = {}
        self._delays: Dict[str, List[Tuple[float, float]]] = {}
        self.outcome: Optional[dict] = None
        self._published: Dict[str, int] = {}
        self._published_before: Dict[str, int] = {}
        self.trails: Dict[str, List[Tuple[float, float, float]]] = {}
        self.mobile: Dict[str, bool] = {}
        self._subscribers = [
            rospy.Subscriber(names.STATE, InteractionState, lambda m: setattr(self, "state", m)),
            rospy.Subscriber(names.PROGRESS, BorderProgress, lambda m: setattr(self, "progress", m)),
            rospy.Subscriber(names.BORDERS, VirtualBorderArray, lambda m: setattr(self, "borders", m.borders)),
            rospy.Subscriber(names.PHYSICAL_MAP, messages.OccupancyGridArray, lambda m: self._on_map("prior", m)),
            rospy.Subscriber(names.MAP_WITH_BORDERS, messages.OccupancyGridArray, lambda m: self._on_map("posterior", m)),
            rospy.Subscriber(names.LAB_STATE, LabState, lambda m: setattr(self, "lab", m), queue_size=1),
            rospy.Subscriber(names.DETECTORS, DetectorStatus, self._on_detector),
            rospy.Subscriber(names.SPOTS, LaserSpot, self._on_spot),
            rospy.Subscriber("/sim/participant_done", String, self._on_done),
            rospy.Subscriber("/sim/cameras", DiagnosticArray, self._on_cameras),
        ]

    # ------------------------------------------------------------- inputs
    def _on_map(self, which: str, message) -> None:
        try:
            setattr(self, which, messages.grid_from_message(message))
        except CodedError as error:
            rospy.logwarn("%s: %s", which, error)

    def _on_detector(self, message: DetectorStatus) -> None:
        last = self.detectors.get(message.camera)
        if last is not None and message.processed < last.processed:
            # a respawned detector counts from zero
            before = self._counted.get(message.camera, (0, 0))
            self._counted[message.camera] = (before[0] + last.processed, before[1] + last.detected)
        self.detectors[message.camera] = message
        if np.isfinite(message.latency_p95_ms):
            self._delays.setdefault(message.camera, []).append((message.latency_ms, message.latency_p95_ms))

    def _on_cameras(self, message: DiagnosticArray) -> None:
        for status in message.status:
            for entry in status.values:
                if entry.key == "published":
                    self._on_published(status.name, int(entry.value))

    def _on_published(self, camera: str, count: int) -> None:
        last = self._published.get(camera, 0)
        if count < last:
            self._published_before[camera] = self._published_before.get(camera, 0) + last
        self._published[camera] = count

    def _on_spot(self, message: LaserSpot) -> None:
        with self._lock:
            trail = self.trails.setdefault(message.camera, [])
            trail.append((message.header.stamp.to_sec(), message.u, message.v))
            self.mobile[message.camera] = message.mobile

    def _on_done(self, message: String) -> None:
        try:
            self.outcome = json.loads(message.data)
        except ValueError:
            self.outcome = {"outcome": message.data}

    # ------------------------------------------------------------- questions
    def frames(self) -> Dict[str, Dict[str, int]]:
        """Frames published, processed, and with a spot, by camera; they go on counting over a node's restart."""
        counts = {}
        for camera, status in self.detectors.items():
            processed, detected = self._counted.get(camera, (0, 0))
            counts[camera] = {
                "published": self._published.get(camera, 0) + self._published_before.get(camera, 0),
                "processed": processed + int(status.processed),
                "detected": detected + int(status.detected),
            }
        return counts

    def delays(self, camera: str) -> np.ndarray:
        """(N, 2) [ms] median and 95th percentile from image to search, each over some seconds, as the detector reported."""
        return np.array(self._delays.get(camera, []), dtype=float).reshape(-1, 2)

    def trail(self, camera: str) -> np.ndarray:
        """(N, 3) stamp [s], column, row [px] of every spot that a camera reported."""
        with self._lock:
            return np.array(self.trails.get(camera, []), dtype=float).reshape(-1, 3)

    def plan(self, start: Tuple[float, float, float], goal: Tuple[float, float, float], service: str) -> np.ndarray:
        """move_base's plan between two poses [m, m, rad]: (N, 2) [m], empty if there is none.

        Raises:
            CodedError: "no_planner" if the service does not answer.
        """
        poses = []
        for pose in (start, goal):
            stamped = PoseStamped()
            stamped.header.frame_id = names.MAP_FRAME
            stamped.header.stamp = rospy.Time.now()
            stamped.pose = messages.pose_from_2d(*pose)
            poses.append(stamped)
        try:
            rospy.wait_for_service(service, timeout=20.0)
            reply = rospy.ServiceProxy(service, GetPlan)(poses[0], poses[1], 0.0)
        except (rospy.ROSException, rospy.ServiceException) as error:
            raise CodedError("no_planner", f"{service} does not answer: {error}") from None
        return messages.array_from_points([pose.pose.position for pose in reply.plan.poses])


def wait_until(condition: Callable[[], bool], timeout_s: float, period_s: float = 0.05) -> bool:
    """Looks at a condition until it holds; False after `timeout_s` of wall time or at shutdown."""
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline and not rospy.is_shutdown():
        if condition():
            return True
        time.sleep(period_s)
    return condition()


class CameraAlbum:
    """Keeps, for each camera, one image in which its detector found a spot: the one with the spot nearest the middle.

    Images are large, so a camera is listened to only for a moment, and only one at a time.
    """

    def __init__(self, observer: Observer, topics: Dict[str, str], pause_s: float = 2.0) -> None:
        self._observer = observer
        self._topics = topics
        self._pause_s = pause_s
        self._closing = threading.Event()
        self.images: Dict[str, Image] = {}
        self._off_middle: Dict[str, float] = {}
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Ends the listening; a camera that never saw a spot gets an image without one."""
        self._closing.set()
        self._thread.join(10.0)
        for camera, topic in self._topics.items():
            if camera not in self.images:
                try:
                    self.images[camera] = rospy.wait_for_message(topic, Image, timeout=10.0)
                except rospy.ROSException:
                    rospy.logwarn("no image from %s on %s", camera, topic)

    def _run(self) -> None:
        while not self._closing.wait(self._pause_s):
            for camera, topic in self._topics.items():
                seeing = self._observer.progress.seeing if self._observer.progress else []
                if camera in seeing and not self._closing.is_set():
                    self._look(camera, topic)

    def _look(self, camera: str, topic: str) -> None:
        taken: List[Image] = []
        done = threading.Event()

        def keep(image: Image) -> None:
            taken.append(image)
            if len(taken) >= 6:
                done.set()

        subscriber = rospy.Subscriber(topic, Image, keep, queue_size=1, buff_size=2**23)
        done.wait(1.5)
        subscriber.unregister()
        spots = {round(stamp, 4): (u, v) for stamp, u, v in self._observer.trail(camera)[-100:]}
        for image in taken:
            spot = spots.get(round(image.header.stamp.to_sec(), 4))
            if spot is None:
                continue
            off = max(abs(2.0 * spot[0] / image.width - 1.0), abs(2.0 * spot[1] / image.height - 1.0))
            if off < self._off_middle.get(camera, 2.0):
                self._off_middle[camera], self.images[camera] = off, image
