"""Reads the lab's state from its message."""

from __future__ import annotations

from vb_msgs.msg import LabState
from vb_sim.lab_history import Snapshot


def snapshot_from_message(message: LabState) -> Snapshot:
    """Reads a Snapshot from a LabState."""
    poses = [(pose.x, pose.y, pose.theta) for pose in [*message.robot_poses, message.person]]
    return Snapshot(
        message.header.stamp.to_sec(),
        {name.strip("/"): pose for name, pose in zip(message.robots, poses)},
        (message.laser.x, message.laser.y) if message.laser_on else None,
        message.laser_color or "red",
        person=poses[-1] if message.person_present else None,
    )
