"""What a node that drives knows of the robot's surroundings: pose, scan, map, and how far it may drive."""
from __future__ import annotations

import math
import threading
from typing import Dict, Optional, Tuple

import numpy as np
import rospy
from sensor_msgs.msg import LaserScan

from vb_core import geometry, names
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.ros.transforms import TransformLookup
from vb_robot.safety import ForbiddenGround, SafetyParams, free_by_scan, leap, scan_points
from vb_robot.viewpoint import Pose


class Surroundings:
    """Answers from the newest scan, map and localisation; what is too old is none.

    Args:
        base_frame: the robot's.
        use_scan: without it the map alone tells what is in the way.
        scan_timeout, pose_timeout: [s] beyond which they count as missing.
    """

    def __init__(
        self,
        base_frame: str,
        safety: SafetyParams,
        use_scan: bool,
        scan_timeout: float,
        pose_timeout: float,
        transforms: TransformLookup,
    ) -> None:
        self._base_frame = base_frame
        self._safety = safety
        self._use_scan = use_scan
        self._scan_timeout = scan_timeout
        self._pose_timeout = pose_timeout
        self._transforms = transforms
        self._lock = threading.Lock()
        self._scan: Optional[LaserScan] = None
        self._ground: Optional[ForbiddenGround] = None
        self._laser_mounts: Dict[str, np.ndarray] = {}
        self._last_pose: Optional[Tuple[rospy.Time, Pose]] = None
        self._doubt_until = rospy.Time(0)

    def set_map(self, grid: GridMap) -> None:
        """Takes the map whose occupied cells are never entered."""
        ground = ForbiddenGround(grid, self._safety)
        with self._lock:
            self._ground = ground

    def set_scan(self, message: LaserScan) -> None:
        """Takes a scan; to be used as a callback."""
        with self._lock:
            self._scan = message

    def free_way(self, now: rospy.Time, v: float, w: float) -> Optional[float]:
        """[m] that may be driven with (v, w) [m/s, rad/s]; None if scan, map or pose are missing or old."""
        with self._lock:
            scan, ground = self._scan, self._ground
        pose = self.pose(now)
        if ground is None or pose is None:
            rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: only turns: no {'map' if ground is None else 'pose'}")
            return None
        free = ground.free_way(pose, v, w)
        if not self._use_scan:
            return free
        points = self._scanned(scan, now)
        if points is None:
            rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: only turns: no fresh scan")
            return None
        return min(free, free_by_scan(points, v > 0, self._safety))

    def pose(self, now: rospy.Time) -> Optional[Pose]:
        """(x, y, yaw) [m, m, rad], map frame; None if the robot is not localised, or its place has just leapt."""
        # tf gives the newest transform however old: asking for one at this time tells whether it is recent
        recent = now - rospy.Duration(min(self._pose_timeout, now.to_sec()))
        if self.lookup(names.MAP_FRAME, self._base_frame, recent) is None:
            return None
        T = self.lookup(names.MAP_FRAME, self._base_frame, rospy.Time(0))
        if T is None:
            return None
        pose = geometry.transform_pose2d(T)
        return None if self._in_doubt(now, pose) else pose

    def _in_doubt(self, now: rospy.Time, pose: Pose) -> bool:
        """Whether the robot's place has leapt a moment ago: localisation was wrong, or is now."""
        with self._lock:
            before, self._last_pose = self._last_pose, (now, pose)
            if self._doubt_until > now + rospy.Duration(self._safety.pose_doubt):
                self._doubt_until = rospy.Time(0)  # time has jumped back
            since = (now - before[0]).to_sec() if before is not None else math.inf
            # after a pause a robot may be anywhere
            if before is not None and 0.0 <= since < 1.0 and leap(before[1], pose, since) > self._safety.pose_jump:
                self._doubt_until = now + rospy.Duration(self._safety.pose_doubt)
                rospy.logwarn("%s: the localisation leapt from (%.2f, %.2f) to (%.2f, %.2f)", rospy.get_name(),
                              *before[1][:2], *pose[:2])
            return now < self._doubt_until

    def lookup(self, target: str, source: str, stamp: rospy.Time, warn: bool = False) -> Optional[np.ndarray]:
        """The transform T_target_source (4, 4); None, with a warning if wanted, if there is none."""
        try:
            return self._transforms.lookup(target, source, stamp, timeout_s=0.0)
        except CodedError as error:
            if warn:
                rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: {error}")
            return None

    def _scanned(self, scan: Optional[LaserScan], now: rospy.Time) -> Optional[np.ndarray]:
        if scan is None or not 0.0 <= (now - scan.header.stamp).to_sec() + 0.1 <= self._scan_timeout + 0.1:
            return None
        frame = scan.header.frame_id
        if frame not in self._laser_mounts:
            T = self.lookup(self._base_frame, frame, rospy.Time(0), warn=True)
            if T is None:
                return None
            self._laser_mounts[frame] = T
        ranges = np.asarray(scan.ranges)
        points = scan_points(ranges, scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max)
        return geometry.apply(self._laser_mounts[frame], np.column_stack([points, np.zeros(len(points))]))[:, :2]
