"""Watches the cameras while people work: which detector is gone, what each says of itself, which two disagree. No ROS.

Without it, an unplugged camera looks to a person as if the laser were off.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Deque, Dict, List, Sequence

from vb_core.errors import CodedError
from vb_core.notices import Notice, Severity
from vb_laser_detect.calibration.consistency import Sighting, compare_cameras

# [s] a detector reports each second; two reports may be late on a busy computer
SILENCE_TIMEOUT = 3.0
START_TIMEOUT = (
    60.0  # [s] a lab's nodes start one after the other, on a small computer for a minute; nothing is missed before
)
# [m] the extraction takes cameras to agree within a hand's tremble; calibrated ones differ by one or two centimetres
MAX_DISAGREEMENT = 0.05
# sightings of one camera that are compared, and [s] for how long: enough for a mean, soon replaced after a calibration
_SIGHTINGS, _SIGHTING_LIFETIME = 200, 300.0
# [s] a detector looks a fixed camera's pose up every two seconds: what it sees until then may still have the former one
_POSE_LATENCY = 5.0


class DetectorWatch:
    """Finds the cameras whose detectors do not report, or report a fault of their own. Not thread safe.

    Args:
        cameras: names of those that should be there; others are watched once they report.
        now: [s] when they may start.
    """

    def __init__(self, cameras: Sequence[str], now: float) -> None:
        self._heard = {name: (now + START_TIMEOUT - SILENCE_TIMEOUT, "") for name in cameras}  # when [s], and what

    def update(self, camera: str, fault: str, now: float) -> None:
        """Adopts a detector's report at a time [s]: the code of its fault, or ""."""
        self._heard[camera] = now, fault

    def notices(self, now: float) -> List[Notice]:
        """Returns what people should know at a time [s], one notice per camera at most."""
        codes = {
            name: "detector_missing" if now - heard > SILENCE_TIMEOUT else fault
            for name, (heard, fault) in sorted(self._heard.items())
        }
        return [
            Notice(code, Severity.ERROR, camera=name, values={"camera": name}) for name, code in codes.items() if code
        ]


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
