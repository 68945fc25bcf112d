"""Watches the cameras while people work, and reports a faulty one in a notice. No ROS.

Without it, an unplugged camera looks to a person as if the laser were off.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Deque, Dict, List, Mapping, Sequence

from vb_core.errors import CodedError
from vb_core.notices import Notice, Severity
from vb_laser_detect.calibration.consistency import Sighting, compare_cameras

# [s] a detector reports each second; two reports may be late on a busy computer
SILENCE_TIMEOUT = 3.0
# [s] on a slow computer detectors start one after the other
START_TIMEOUT = 15.0
# [m] the extraction takes cameras to agree within a hand's tremble; calibrated ones differ by one or two centimetres
MAX_DISAGREEMENT = 0.05
# sightings of one camera that are compared, and [s] for how long: enough for a mean, soon replaced after a calibration
_SIGHTINGS, _SIGHTING_LIFETIME = 200, 300.0
# [s] a detector looks a fixed camera's pose up every two seconds: what it sees until then may still have the former one
_POSE_LATENCY = 5.0
# a detector's count of dropped spots, to the code of the notice; the first that holds hides those behind it. Of a
# shared frame `check_lab` tells, which knows the cameras that have it.
_REASONS = {"shared_frame": "", "no_camera_info": "camera_no_lens", "no_transform": "camera_no_pose"}


@dataclass
class _WatchedCamera:
    heard: float
    images: int = 0
    image_at: float = 0.0
    dropped: Dict[str, int] = field(default_factory=dict)
    dropped_at: Dict[str, float] = field(default_factory=dict)


class LabMonitor:
    """Finds the cameras' present faults from their detectors' reports. Not thread safe.

    Args:
        cameras: names of those that should be there; others are watched once they report.
    """

    def __init__(self, cameras: Sequence[str]) -> None:
        self._expected = list(cameras)
        self._cameras: Dict[str, _WatchedCamera] = {}

    def begin(self, now: float) -> None:
        """Starts the clock [s]: until something is overdue nothing is said."""
        started = now + START_TIMEOUT - SILENCE_TIMEOUT
        self._cameras = {name: _WatchedCamera(started, image_at=started) for name in self._expected}

    def update(self, camera: str, images: int, dropped: Mapping[str, int], now: float) -> None:
        """Adopts a detector's report at a time [s].

        Args:
            images: received since it was started; dropped: how often a spot or image was, by reason.
        """
        known = self._cameras.setdefault(camera, _WatchedCamera(now, image_at=now))
        known.heard = now
        if images != known.images:
            known.images, known.image_at = images, now
        for reason in _REASONS:
            count = dropped.get(reason, 0)
            if count > known.dropped.get(reason, 0):
                known.dropped_at[reason] = now
            known.dropped[reason] = count

    def notices(self, now: float) -> List[Notice]:
        """Returns what people should know at a time [s], one notice per camera at most."""
        found = []
        for name, camera in sorted(self._cameras.items()):
            code = self._fault(camera, now)
            if code:
                found.append(Notice(code, Severity.ERROR, camera=name, values={"camera": name}))
        return found

    @staticmethod
    def _fault(camera: _WatchedCamera, now: float) -> str:
        if now - camera.heard > SILENCE_TIMEOUT:
            return "detector_missing"
        if now - camera.image_at > SILENCE_TIMEOUT:
            return "camera_silent"
        return next(
            (
                code
                for reason, code in _REASONS.items()
                if now - camera.dropped_at.get(reason, -math.inf) <= SILENCE_TIMEOUT
            ),
            "",
        )


class CameraComparison:
    """Finds cameras that see the laser at different places: one was moved, or has another's pose. Not thread safe.

    Nobody has to draw for it: whenever people use the laser where cameras overlap, their spots are compared.
    """

    def __init__(self) -> None:
        self._sightings: Dict[str, Deque[Sighting]] = {}
        self._moved: Dict[str, float] = {}  # [s] when a camera got its present pose

    def add_spot(self, camera: str, stamp: float, x: float, y: float) -> None:
        """Adds a spot [m] of a stationary camera, in the map, at the time of its image [s]."""
        if abs(stamp - self._moved.get(camera, -math.inf)) > _POSE_LATENCY:
            self._sightings.setdefault(camera, deque(maxlen=_SIGHTINGS)).append((camera, stamp, x, y))

    def clear(self, camera: str, now: float) -> None:
        """Drops what a camera has seen, because it has another pose since a time [s]."""
        self._sightings.pop(camera, None)
        self._moved[camera] = now

    def notices(self, now: float) -> List[Notice]:
        """Returns one notice for each two cameras that disagree."""
        fresh = [one for seen in self._sightings.values() for one in seen if 0.0 <= now - one[1] <= _SIGHTING_LIFETIME]
        try:
            pairs = compare_cameras(fresh)
        except CodedError:
            return []  # no two of them saw the laser together
        return [
            Notice(
                "cameras_disagree",
                Severity.ERROR,
                camera=pair.second,
                values={"first": pair.first, "second": pair.second, "cm": f"{100 * pair.median:.0f}"},
            )
            for pair in pairs
            if pair.median > MAX_DISAGREEMENT
        ]
