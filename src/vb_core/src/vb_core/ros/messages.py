"""Conversions between ROS messages and numpy, each next to its inverse if it has one.

Images and cameras are in `images`, because most nodes need neither, and OpenCV takes 20 MiB per process.
"""

from __future__ import annotations

from typing import Any, Dict, Iterable, List, Mapping, Tuple

import numpy as np
import rospy
from diagnostic_msgs.msg import KeyValue
from geometry_msgs.msg import Point, Pose, Quaternion, Transform, TransformStamped, Vector3
from nav_msgs.msg import OccupancyGrid
from rospy.numpy_msg import numpy_msg
from std_msgs.msg import Header
from vb_msgs.msg import BorderPreview

from vb_core import geometry, sentences
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap

# rospy serialises int8[] cell by cell; publishers and subscribers of these types copy all cells at once
NumpyOccupancyGrid = numpy_msg(OccupancyGrid)
NumpyBorderPreview = numpy_msg(BorderPreview)


# ----------------------------------------------------------------- maps
def grid_from_message(message: OccupancyGrid) -> GridMap:
    """Converts OccupancyGrid to GridMap. Inverse of `message_from_grid`.

    Raises:
        CodedError: "bad_map" if size and data do not match or the origin is not a planar pose.
    """
    info = message.info
    data = np.asarray(message.data, dtype=np.int8)
    if info.width * info.height != data.size or data.size == 0:
        raise CodedError("bad_map", f"the map says {info.width} x {info.height} cells but carries {data.size}")
    position, orientation = info.origin.position, info.origin.orientation
    q = (orientation.x, orientation.y, orientation.z, orientation.w)
    # older map_servers leave the orientation zero if there is no rotation
    yaw = 0.0 if not any(q) else geometry.yaw_from_quaternion(q)
    return GridMap(data.reshape(info.height, info.width), info.resolution, (position.x, position.y, yaw))


def message_from_grid(grid: GridMap, stamp: rospy.Time, frame_id: str = "map") -> OccupancyGrid:
    """Converts GridMap to OccupancyGrid. Inverse of `grid_from_message`. To be published as NumpyOccupancyGrid."""
    message = NumpyOccupancyGrid(header=Header(stamp=stamp, frame_id=frame_id))
    message.info.map_load_time = stamp
    message.info.resolution = grid.resolution
    message.info.height, message.info.width = grid.shape
    message.info.origin = message_from_pose2d(*grid.origin)
    message.data = np.ascontiguousarray(grid.data).ravel()
    return message


# ----------------------------------------------------------------- sentences
def values_from_mapping(values: Mapping[str, Any]) -> List[KeyValue]:
    """Converts a sentence's values for a message. Inverse of `mapping_from_values`."""
    return [KeyValue(key=key, value=str(value)) for key, value in values.items()]


def mapping_from_values(values: Iterable[KeyValue]) -> Dict[str, str]:
    """Converts a sentence's values from a message. Inverse of `values_from_mapping`."""
    return {value.key: value.value for value in values}


def sentence_in(message: Any, language: str, prefix: str = "") -> str:
    """Returns a message's sentence in a language. The message has the fields code, values and message (in English).

    `prefix`: prefix of these fields' names, for instance "last_".
    """
    code, values, english = (getattr(message, prefix + field) for field in ("code", "values", "message"))
    return sentences.translate(code, mapping_from_values(values), language, english) if code else english


# ----------------------------------------------------------------- poses and points
def points_from_array(points: np.ndarray) -> List[Point]:
    """Converts an array (N, 2) or (N, 3) [m] to points. Inverse of `array_from_points`."""
    with_z = ((*point, 0.0)[:3] for point in points)
    return [Point(float(x), float(y), float(z)) for x, y, z in with_z]


def array_from_points(points: Iterable[Point]) -> np.ndarray:
    """Converts points to an array (N, 2) float64 [m] without z. Inverse of `points_from_array`."""
    return np.array([(p.x, p.y) for p in points], dtype=float).reshape(-1, 2)


def message_from_quaternion(quaternion) -> Quaternion:
    """Converts a quaternion (x, y, z, w) to a message."""
    return Quaternion(*(float(value) for value in quaternion))


def message_from_pose2d(x: float, y: float, yaw: float) -> Pose:
    """Converts a planar pose [m, m, rad] to a message. Inverse of `pose2d_from_message`."""
    return Pose(Point(float(x), float(y), 0.0), message_from_quaternion(geometry.quaternion_from_yaw(yaw)))


def pose2d_from_message(pose: Pose) -> Tuple[float, float, float]:
    """Converts a message to a planar pose (x, y, yaw) [m, m, rad]. Inverse of `message_from_pose2d`."""
    q = pose.orientation
    return pose.position.x, pose.position.y, geometry.yaw_from_quaternion((q.x, q.y, q.z, q.w))


def transform_from_message(message: Transform) -> np.ndarray:
    """Converts a transform to a 4x4 matrix. Inverse of `message_from_transform`.

    Raises:
        CodedError: "bad_transform" if the rotation is zero or not finite.
    """
    q, t = message.rotation, message.translation
    try:
        rotation = geometry.rotation_from_quaternion((q.x, q.y, q.z, q.w))
    except ValueError:
        raise CodedError("bad_transform") from None
    return geometry.make_transform(rotation, (t.x, t.y, t.z))


def message_from_transform(T: np.ndarray, parent: str, child: str, stamp: rospy.Time) -> TransformStamped:
    """Converts a 4x4 matrix T_parent_child to a stamped transform. Inverse of `transform_from_message`."""
    message = TransformStamped(header=Header(stamp=stamp, frame_id=parent), child_frame_id=child)
    message.transform.translation = Vector3(*(float(value) for value in T[:3, 3]))
    message.transform.rotation = message_from_quaternion(geometry.quaternion_from_rotation(T[:3, :3]))
    return message
