"""Conversions between CameraInfo and CameraModel."""

from __future__ import annotations

import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo

from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError


def camera_from_info(info: CameraInfo, rectified: bool = False) -> CameraModel:
    """Converts CameraInfo to CameraModel; inverse of `info_from_camera`.

    Args:
        rectified: whether the images are already undistorted (image_rect, image_rect_color); then P describes them.

    Raises:
        CodedError: "bad_camera_info" if it describes no possible camera; "unsupported_camera" for binning, a region of
            interest or an unknown distortion model.
    """
    models = ("", "plumb_bob", "rational_polynomial", "equidistant", "fisheye")
    if info.distortion_model not in models and not rectified:
        raise CodedError("unsupported_camera", f"the distortion model '{info.distortion_model}' is not supported")
    roi = info.roi
    part = (roi.width, roi.height) not in ((0, 0), (info.width, info.height)) or roi.x_offset > 0 or roi.y_offset > 0
    if info.binning_x > 1 or info.binning_y > 1 or part:
        raise CodedError("unsupported_camera", "binning or a region of interest is set: send the full image")
    if rectified:
        return CameraModel(info.width, info.height, np.array(info.P).reshape(3, 4)[:, :3], np.zeros(5))
    fisheye = info.distortion_model in ("equidistant", "fisheye")
    return CameraModel(info.width, info.height, np.array(info.K), np.array(info.D), fisheye)


def info_from_camera(camera: CameraModel, stamp: rospy.Time, frame_id: str) -> CameraInfo:
    """Converts CameraModel to CameraInfo; inverse of `camera_from_info`."""
    info = CameraInfo()
    info.header.stamp = stamp
    info.header.frame_id = frame_id
    info.width, info.height = camera.width, camera.height
    pinhole = "plumb_bob" if camera.distortion.size <= 5 else "rational_polynomial"
    info.distortion_model = "equidistant" if camera.fisheye else pinhole
    info.K = camera.matrix.ravel().tolist()
    info.D = camera.distortion.tolist()
    info.R = np.eye(3).ravel().tolist()
    info.P = np.column_stack([camera.matrix, np.zeros(3)]).ravel().tolist()
    return info
