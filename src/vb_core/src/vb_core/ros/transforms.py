"""Looks up transforms at the time of a message."""

from __future__ import annotations

from typing import Optional

import numpy as np
import rospy
import tf2_ros

from vb_core import names
from vb_core.errors import CodedError
from vb_core.geometry import Pose, pose2d_from_transform
from vb_core.ros.messages import transform_from_message


class TransformLookup:
    """tf2's buffer and listener; returns 4x4 matrices or raises an error."""

    def __init__(self) -> None:
        self._buffer = tf2_ros.Buffer()  # transforms of the last 10 s
        self._listener = tf2_ros.TransformListener(self._buffer)

    def lookup(self, target: str, source: str, stamp: rospy.Time, timeout: float = 0.1) -> np.ndarray:
        """Looks up T_target_source (4, 4).

        Args:
            stamp: the transform's time; rospy.Time(0) for the newest transform.
            timeout: [s] how long to wait for a transform that has not arrived yet.

        Raises:
            CodedError: "no_transform" if there is none at that time; "bad_transform" if its rotation is invalid.
        """
        try:
            stamped = self._buffer.lookup_transform(target, source, stamp, rospy.Duration(timeout))
        except (tf2_ros.TransformException, rospy.ROSException) as error:
            # for a frame that tf does not know, its error says only that the argument is wrong
            exists = f"Frame {source} exists" in self._buffer.all_frames_as_string()
            reason = error if exists else "nothing publishes one, as before a camera is calibrated or a robot localised"
            raise CodedError("no_transform", f"no transform from '{source}' to '{target}': {reason}") from None
        return transform_from_message(stamped.transform)

    def pose_on_map(self, frame: str, silence: float) -> Optional[Pose]:
        """Returns a frame's pose on the map, (x, y, yaw) [m, m, rad], or None if none is newer than `silence` [s]."""
        stamp = self.newest(names.MAP_FRAME, frame)
        if not stamp.is_zero() and abs((rospy.Time.now() - stamp).to_sec()) > silence:
            return None
        try:
            pose = pose2d_from_transform(self.lookup(names.MAP_FRAME, frame, stamp, 0.0))
        except CodedError:
            return None
        return pose if np.isfinite(pose).all() else None

    def newest(self, target: str, source: str) -> rospy.Time:
        """Returns the time of the newest transform, or zero if it is static or missing."""
        try:
            return self._buffer.get_latest_common_time(target, source)
        except (tf2_ros.TransformException, rospy.ROSException):
            return rospy.Time(0)
