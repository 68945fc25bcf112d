"""Finds faults of ceiling cameras that one detector alone cannot find. No ROS.

Each detector reports what is wrong with its own images. This module compares the detectors' reports with the calibration
files, with this computer's clock, and with each other.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from dataclasses import dataclass
from typing import Deque, Dict, List, Mapping, Optional, Sequence, Tuple, Union

import numpy as np

from vb_core.errors import CodedError
from vb_core.notices import Notice, Severity
from vb_laser_detect.calibration import pose_file
from vb_laser_detect.calibration.pose_file import CameraPose
from vb_laser_detect.detection.detector_counts import MAX_CLOCK_OFFSET

_SILENCE_TIMEOUT = 3.0  # [s] without a report; detectors report each second, and a busy computer may delay two reports
_START_TIMEOUT = 60.0  # [s] in which all nodes of a lab start, one after another, even on a small computer
_CLOCK_REPORTS = 10  # of which the quickest counts: a busy computer delays some, but a wrong clock shifts all of them
_MAX_FOCAL_CHANGE = 0.01  # share; lenses of one model differ by more, two calibrations of one lens by less
# [m] extraction assumes that cameras agree within the hand's tremor; calibrated ones differ by one or two centimetres
_MAX_DISAGREEMENT = 0.05
_MAX_SIGHTINGS = 200  # per camera: enough for a median
_SIGHTING_LIFETIME = 300.0  # [s] sightings from before a calibration soon no longer count
_MIN_COMMON = 20  # sightings that two cameras must share before they are compared
# positions are interpolated over at most one lost image, and no longer than a straight part of a slow drawing lasts
_MAX_GAP_PERIODS = 2.5  # in multiples of a camera's usual interval between sightings
_MAX_GAP = 0.5  # [s]
_POSE_LATENCY = 5.0  # [s] after a change of pose, in which spots may still be located with the former pose

PoseFile = Union[CameraPose, CodedError]  # a calibration, or the reason why it cannot be read


@dataclass(frozen=True)
class DetectorReport:
    """The part of a detector's status that is compared."""

    arrival: float  # [s] time at which it arrived
    frame: str = ""  # frame of the images; "" if not known
    focal: float = 0.0  # [px] focal length of the lens; 0 if not known
    age: float = 0.0  # [s] time from the status's stamp until its arrival


class CameraFaultFinder:
    """Finds faults of the cameras that should be there. Not thread safe.

    Args:
        cameras: names of the cameras.
        now: [s] when the watch begins; detectors have a minute to start.
    """

    def __init__(self, cameras: Sequence[str], now: float) -> None:
        self._reports = {name: DetectorReport(now + _START_TIMEOUT - _SILENCE_TIMEOUT) for name in cameras}
        self._ages: Dict[str, Deque[float]] = {name: deque(maxlen=_CLOCK_REPORTS) for name in cameras}
        self._sightings: Dict[str, Deque[Tuple[float, float, float]]] = {}  # stamp [s], x, y [m]
        self._pose_changes: Dict[str, float] = {}  # [s] when a camera got its present pose

    def report(self, camera: str, report: DetectorReport) -> None:
        """Records a detector's report; that of an unexpected camera is ignored."""
        if camera in self._reports:
            self._reports[camera] = report
            self._ages[camera].append(report.age)

    def add_spot(self, camera: str, stamp: float, x: float, y: float) -> None:
        """Adds a stationary camera's spot at (x, y) [m] in the map, with its image's stamp [s].

        Nobody has to draw for the comparison: any use of the laser where cameras overlap serves it.
        """
        since_change = abs(stamp - self._pose_changes.get(camera, -math.inf))
        if math.isfinite(x + y) and since_change > _POSE_LATENCY:
            self._sightings.setdefault(camera, deque(maxlen=_MAX_SIGHTINGS)).append((stamp, x, y))

    def forget_spots(self, camera: str, now: float) -> None:
        """Drops a camera's sightings, because its pose changed at a time [s]."""
        self._sightings.pop(camera, None)
        self._pose_changes[camera] = now

    def find_missing_detectors(self, now: float) -> List[Notice]:
        """Returns a notice for each camera whose detector has not reported for too long at a time [s]."""
        error = CodedError("detector_missing")
        cameras = [camera for camera in sorted(self._reports) if self._is_missing(camera, now)]
        return [Notice.from_error(error, Severity.ERROR, camera) for camera in cameras]

    def _is_missing(self, camera: str, now: float) -> bool:
        return now - self._reports[camera].arrival > _SILENCE_TIMEOUT

    def find_wrong_clocks(self, now: float) -> List[Notice]:
        """Returns a notice for each camera on a computer whose clock differs from this one's at a time [s]."""
        notices = []
        for camera, ages in sorted(self._ages.items()):
            age = min(ages, key=abs, default=0.0)
            is_known = len(ages) == _CLOCK_REPORTS and not self._is_missing(camera, now)
            if is_known and abs(age) > MAX_CLOCK_OFFSET:
                notices.append(Notice.from_error(CodedError("camera_clock", age=f"{age:.2f}"), Severity.ERROR, camera))
        return notices

    def find_calibration_faults(
        self, files: Mapping[str, PoseFile], cameras_with_old_pose: Sequence[str], now: float
    ) -> List[Notice]:
        """Returns a notice for each camera whose calibration cannot be used, or does not fit its images.

        Args:
            files: each camera's calibration, or why it cannot be read.
            cameras_with_old_pose: cameras whose earlier pose is still published.
            now: [s] present time.
        """
        frames = [report.frame for camera, report in self._reports.items() if not self._is_missing(camera, now)]
        notices = []
        for camera, file in sorted(files.items()):
            report = self._reports[camera]
            fault = _calibration_fault(camera, file, report, camera in cameras_with_old_pose)
            # a frame that two cameras have is reported by the detectors, and must be resolved before the pose
            is_shared = report.frame != "" and frames.count(report.frame) > 1
            if fault is not None and not is_shared:
                notices.append(Notice.from_error(fault, Severity.ERROR, camera))
        return notices

    def find_disagreements(self, now: float) -> List[Notice]:
        """Returns a notice for each pair of cameras that disagree on a spot. One was moved, or has another one's pose."""
        recent = {
            camera: np.array(sorted(row for row in rows if 0.0 <= now - row[0] <= _SIGHTING_LIFETIME)).reshape(-1, 3)
            for camera, rows in self._sightings.items()
        }
        notices = []
        for first, second in itertools.combinations(sorted(recent), 2):
            distance = distance_between(recent[first], recent[second])
            if distance > _MAX_DISAGREEMENT:
                values = {"first": first, "second": second, "cm": f"{100 * distance:.0f}"}
                notices.append(Notice.from_error(CodedError("cameras_disagree", **values), Severity.ERROR, second))
        return notices


def distance_between(a: np.ndarray, b: np.ndarray) -> float:
    """Returns how far apart [m] two cameras see the same spot (median), or NaN if they hardly saw it together.

    Cameras do not take their images at the same time, and a spot moves. So the second camera's position is interpolated
    to the first one's time, between two consecutive sightings at its usual rate.

    Args:
        a, b: (N, 3) sightings in order of time: stamp [s], x, y [m].
    """
    if min(len(a), len(b)) < _MIN_COMMON:
        return math.nan
    intervals = np.diff(b[:, 0])
    max_gap = min(_MAX_GAP_PERIODS * float(np.median(intervals)), _MAX_GAP)
    # the interval of b in which each row of a lies, which is infinite before and after all of b
    row_after = np.searchsorted(b[:, 0], a[:, 0], side="right")
    gaps = np.array([np.inf, *intervals, np.inf])[row_after]
    a = a[gaps <= max_gap]
    if len(a) < _MIN_COMMON:
        return math.nan
    x = np.interp(a[:, 0], b[:, 0], b[:, 1])
    y = np.interp(a[:, 0], b[:, 0], b[:, 2])
    return float(np.median(np.hypot(x - a[:, 1], y - a[:, 2])))


def read_files(folder: str, cameras: Sequence[str]) -> Dict[str, PoseFile]:
    """Reads each camera's calibration, or returns its error; a frame that two cameras share is an error of both."""
    files: Dict[str, PoseFile] = {}
    for camera in cameras:
        try:
            files[camera] = pose_file.read_pose(pose_file.calibration_path(folder, camera))
        except CodedError as error:
            files[camera] = error.without_traceback()
    frames = {camera: file.frame for camera, file in files.items() if isinstance(file, CameraPose)}
    for camera, frame in frames.items():
        sharing = sorted(name for name in frames if frames[name] == frame)
        if len(sharing) > 1:  # the frame may be wrong for either
            files[camera] = CodedError("shared_frame", cameras=", ".join(sharing), frame=frame)
    return files


def _calibration_fault(camera: str, file: PoseFile, report: DetectorReport, has_old_pose: bool) -> Optional[CodedError]:
    """Returns the fault if a calibration cannot be used, or does not fit the camera's images, or None if it fits."""
    name = f"{camera}.yaml"
    if isinstance(file, CodedError):
        if file.code == "shared_frame":
            return file
        if file.code == "no_calibration" and not has_old_pose:
            return CodedError("camera_not_calibrated", error=file.message)
        return CodedError("camera_file_broken", error=file.message, file=name)
    if report.frame not in ("", file.frame):
        return CodedError("camera_frame_differs", frame=report.frame, file_frame=file.frame, file=name)
    if report.focal and file.focal and abs(report.focal / file.focal - 1.0) > _MAX_FOCAL_CHANGE:
        focal, of_file = f"{report.focal:.0f}", f"{file.focal:.0f}"
        return CodedError("camera_other_lens", focal=focal, file_focal=of_file, file=name)
    return None
