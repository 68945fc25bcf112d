"""Stores where everything that moves in the lab has been recently, and interpolates it at an image's timestamp."""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass, field, replace
from typing import Any, Dict, Optional, Tuple

from vb_core.geometry import Pose, wrap_angle
from vb_sim.world import Point2

_MAX_JUMP = 0.4  # [m] between two snapshots; if a spot jumps farther, the laser was off while it was moved
_EXTRAPOLATION = 0.03  # [s] how far motion is extrapolated beyond the newest snapshot
_STALE = 1.0  # [s] without a snapshot after which the scene is empty
_LENGTH = 64  # [snapshots], more than a second


@dataclass(frozen=True)
class Snapshot:
    """Where everything that moves is at one time, map frame."""

    stamp: float  # [s]
    robots: Dict[str, Pose] = field(default_factory=dict)  # (x, y, yaw) [m, m, rad] by name
    laser: Optional[Point2] = None  # (x, y) [m] of the spot; None while the laser is off
    laser_color: str = "red"
    laser_velocity: Point2 = (0.0, 0.0)  # [m/s] of the spot
    person: Optional[Pose] = None  # (x, y, yaw) [m, m, rad]; None if nobody is in the lab


def snapshot_from_message(message: Any) -> Snapshot:
    """Converts a vb_msgs/LabState to a snapshot."""
    poses = [(pose.x, pose.y, pose.theta) for pose in [*message.robot_poses, message.person]]
    return Snapshot(
        message.header.stamp.to_sec(),
        {name.strip("/"): pose for name, pose in zip(message.robots, poses)},
        (message.laser.x, message.laser.y) if message.laser_on else None,
        message.laser_color or "red",
        person=poses[-1] if message.person_present else None,
    )


class LabHistory:
    """The newest snapshots. One thread may add them while others read them."""

    def __init__(self) -> None:
        self._snapshots: Tuple[Snapshot, ...] = ()  # replaced as a whole, so that no lock is needed

    def add(self, snapshot: Snapshot) -> None:
        """Adds a snapshot, which must be newer than the others. Only one thread may call it."""
        self._snapshots = (*self._snapshots[-_LENGTH + 1 :], snapshot)

    def at(self, stamp: float) -> Snapshot:
        """Interpolates the scene at time `stamp` [s]. It is empty if no snapshot is within _STALE of that time."""
        snapshots = self._snapshots
        if not snapshots:
            return Snapshot(stamp)
        is_too_late = stamp - snapshots[-1].stamp > _STALE
        is_too_early = snapshots[0].stamp - stamp > _STALE
        if is_too_late or is_too_early:
            return Snapshot(stamp)
        if len(snapshots) == 1:
            return replace(snapshots[0], stamp=stamp)
        index = bisect_left([snapshot.stamp for snapshot in snapshots], stamp)
        index = min(max(index, 1), len(snapshots) - 1)
        first, second = snapshots[index - 1], snapshots[index]
        interval = second.stamp - first.stamp
        time = min(max(stamp, first.stamp), second.stamp + _EXTRAPOLATION)
        return _interpolate(first, second, (time - first.stamp) / interval, interval, stamp)


def _interpolate(a: Snapshot, b: Snapshot, share: float, interval: float, stamp: float) -> Snapshot:
    nearest = a if share < 0.5 else b
    robots = {}
    for name, pose in b.robots.items():
        robots[name] = _interpolate_pose(a.robots.get(name, pose), pose, share)
    person = nearest.person
    if a.person is not None and b.person is not None:
        person = _interpolate_pose(a.person, b.person, share)
    laser = nearest.laser
    velocity = (0.0, 0.0)
    if a.laser is not None and b.laser is not None and math.dist(a.laser, b.laser) < _MAX_JUMP:
        laser = _interpolate_point(a.laser, b.laser, share)
        velocity = ((b.laser[0] - a.laser[0]) / interval, (b.laser[1] - a.laser[1]) / interval)
    return Snapshot(stamp, robots, laser, nearest.laser_color, velocity, person)


def _interpolate_pose(a: Pose, b: Pose, share: float) -> Pose:
    x, y = _interpolate_point(a[:2], b[:2], share)
    rotation = wrap_angle(b[2] - a[2])
    return (x, y, wrap_angle(a[2] + share * rotation))


def _interpolate_point(a: Point2, b: Point2, share: float) -> Point2:
    return (a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]))
