"""Converts images and camera_info between ROS messages and numpy.

cv_bridge does the same, but loads a second OpenCV with video and GDAL backends, which takes 48 MiB per process.
"""

from __future__ import annotations

from typing import Union

import cv2
import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header

from vb_core.camera_model import FISHEYE_MODELS, CameraModel
from vb_core.errors import CodedError
from vb_core.image_format import Picture, PixelReader, find_encoding


def array_from_image(message: Image) -> np.ndarray:
    """Returns an image's unconverted pixels (H, W) or (H, W, C); copies only where the byte order requires it.

    The pixels of nv12 and nv21 are (3/2 H, W), because chrominance is stored below the luminance.

    Raises:
        CodedError: "bad_image" for an empty image, an unknown encoding, or too few bytes.
    """
    if message.height == 0 or message.width == 0:
        raise CodedError("bad_image", "the image is empty")
    encoding = find_encoding(message.encoding)
    height = encoding.rows(message.height)
    dtype = encoding.dtype.newbyteorder(">" if message.is_bigendian else "<")
    row_bytes = message.width * encoding.channels * dtype.itemsize
    step = message.step
    if step < row_bytes or len(message.data) < step * (height - 1) + row_bytes:
        raise CodedError(
            "bad_image",
            f"cannot read an image with encoding '{message.encoding}': {message.width} x {message.height} pixels need"
            f" rows of {row_bytes} bytes, it has {len(message.data)} bytes in rows of {step}",
        )
    strides = (step, encoding.channels * dtype.itemsize, dtype.itemsize)
    pixels = np.ndarray((height, message.width, encoding.channels), dtype, bytes(message.data), strides=strides)
    pixels = pixels.astype(dtype.newbyteorder("="), copy=False)
    return pixels[:, :, 0] if encoding.channels == 1 else pixels


def array_from_compressed_image(message: CompressedImage) -> np.ndarray:
    """Decodes a JPEG or PNG image to pixels (H, W, 3) bgr, or (H, W). Raises CodedError "bad_image" if it is damaged."""
    try:
        image = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:  # no bytes at all, or too many pixels for OpenCV
        image = None
    if image is None:
        raise CodedError("bad_image", f"cannot decode a compressed image of format '{message.format}'")
    return image


def decode(message: Union[Image, CompressedImage], reader: PixelReader) -> Picture:
    """Decodes an image message with its camera's reader. Raises CodedError "bad_image", or as `PixelReader.read`."""
    if isinstance(message, Image):
        return reader.read(array_from_image(message), message.encoding)
    image = array_from_compressed_image(message)
    if image.ndim == 3:
        return reader.read(image, "bgr8")
    # the format is "bayer_rggb8; jpeg compressed ..." if the driver names the encoding that it compressed
    driver_encoding = message.format.split(";")[0].strip()
    return reader.read(image, driver_encoding if driver_encoding.startswith("bayer") else "mono8")


def message_from_image(image: np.ndarray, encoding: str, stamp: rospy.Time, frame_id: str) -> Image:
    """Converts pixels to a message. Inverse of `array_from_image`."""
    image = np.ascontiguousarray(image)
    header = Header(stamp=stamp, frame_id=frame_id)
    height, width = image.shape[:2]
    is_bigendian = int(image.dtype.str.startswith(">"))
    return Image(header, height, width, encoding, is_bigendian, image.strides[0], image.tobytes())


def camera_from_info(info: CameraInfo, rectified: bool = False) -> CameraModel:
    """Converts CameraInfo to CameraModel. Inverse of `info_from_camera`.

    Args:
        rectified: whether the images are already undistorted (image_rect, image_rect_color); then P describes them.

    Raises:
        CodedError: "bad_camera_info" if it describes no possible camera; "unsupported_camera" for binning, a region of
            interest or an unknown distortion model.
    """
    models = ("", "plumb_bob", "rational_polynomial", *FISHEYE_MODELS)
    if info.distortion_model not in models and not rectified:
        raise CodedError("unsupported_camera", f"the distortion model '{info.distortion_model}' is not supported")
    roi = info.roi
    is_full_size = (roi.width, roi.height) in ((0, 0), (info.width, info.height))
    is_cropped = not is_full_size or roi.x_offset > 0 or roi.y_offset > 0
    is_binned = info.binning_x > 1 or info.binning_y > 1
    if is_binned or is_cropped:
        raise CodedError("unsupported_camera", "binning or a region of interest is set: send the full image")
    if rectified:
        return CameraModel(info.width, info.height, np.array(info.P).reshape(3, 4)[:, :3], np.zeros(5))
    fisheye = info.distortion_model in FISHEYE_MODELS
    return CameraModel(info.width, info.height, np.array(info.K), np.array(info.D), fisheye)


def info_from_camera(camera: CameraModel, stamp: rospy.Time, frame_id: str) -> CameraInfo:
    """Converts CameraModel to CameraInfo. Inverse of `camera_from_info`."""
    info = CameraInfo(header=Header(stamp=stamp, frame_id=frame_id))
    info.width, info.height = camera.width, camera.height
    info.distortion_model = camera.distortion_model
    info.K = camera.matrix.ravel().tolist()
    info.D = camera.distortion.tolist()
    info.R = np.eye(3).ravel().tolist()
    info.P = np.column_stack([camera.matrix, np.zeros(3)]).ravel().tolist()
    return info
