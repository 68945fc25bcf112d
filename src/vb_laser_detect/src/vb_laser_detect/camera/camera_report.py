"""Describes a camera that does not work, in lines that people should send."""

from __future__ import annotations

import platform
import shlex
import time
from typing import List

import av
import numpy as np

from vb_core.errors import CodedError
from vb_laser_detect.camera.v4l2_controls import CaptureParams, run_v4l2
from vb_laser_detect.camera.camera_source import CameraSource, CapturedImage, is_device, without_password

# codes of notices about a camera that cannot be read, is slow or refuses a setting, which the lines help to explain
REPORTED = frozenset(
    "camera_unplugged camera_busy camera_forbidden camera_unreachable camera_stalled camera_ended camera_password"
    " camera_no_stream camera_fault camera_silent camera_slow bad_image control_refused no_control".split()
)
_WATCH_TIME = 5.0  # [s]


def describe_camera_command(source: str) -> str:
    """Returns the command that describes a camera; a password in its address is left out."""
    return f"rosrun vb_bringup check_lab --camera {shlex.quote(without_password(source))}"


def describe_camera(source: str, params: CaptureParams) -> List[str]:
    """Describes a camera in lines: driver, formats, sizes, rates and stamps. This takes some seconds.

    If the running detector reads the device, the lines say that it is busy, and list what the device can do.
    """
    numbers = {name: ".".join(map(str, number)) for name, number in av.library_versions.items()}
    versions = ", ".join(f"{name} {number}" for name, number in numbers.items())
    lines = [f"source {without_password(source)}", f"Linux {platform.release()}, PyAV {av.__version__}, {versions}"]
    if is_device(source):
        try:
            lines += run_v4l2(source, "--info", "--list-formats-ext", "--list-ctrls-menus").splitlines()
        except CodedError as error:
            lines.append(str(error))
    return lines + _watch(source, params)


def _watch(source: str, params: CaptureParams) -> List[str]:
    """Reads a camera for some seconds, and describes its images and faults in lines."""
    images: List[CapturedImage] = []
    arrival_times: List[float] = []
    faults: List[str] = []

    def add_image(image: CapturedImage) -> None:
        arrival_times.append(time.time())
        images.append(image._replace(jpeg=None, frame=None) if len(images) > 1 else image)

    def add_fault(error: object) -> None:
        if isinstance(error, CodedError):
            faults.append(f"{error.code}: {error.values}")

    reader = CameraSource(source, params, add_image, add_fault)
    reader.start()
    time.sleep(_WATCH_TIME)
    reader.close()
    lines = [f"fault: {fault}" for fault in dict.fromkeys(faults)]
    if len(images) < 2:
        return [*lines, f"{len(images)} images in {_WATCH_TIME:g} s"]
    first = images[0]
    try:
        size: object = first.picture().pixels.shape[1::-1]
    except CodedError as error:
        size = error
    stamps = np.array([image.stamp for image in images])
    intervals = np.diff(stamps)
    ages = np.array(arrival_times) - stamps
    return [
        *lines,
        f"{len(images)} images in {_WATCH_TIME:g} s, as {'JPEG' if first.jpeg else 'video'}, {size} px",
        f"stamps: {1e3 * np.median(intervals):.1f} ms apart ({1e3 * intervals.min():.1f} to {1e3 * intervals.max():.1f})",
        f"arrival after the stamp: {1e3 * np.median(ages):.1f} ms ({1e3 * ages.min():.1f} to {1e3 * ages.max():.1f})",
    ]
