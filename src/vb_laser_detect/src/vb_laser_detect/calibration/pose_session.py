"""Collects places for a camera's calibration one by one, and describes the progress. No ROS, no terminal."""

from __future__ import annotations

import math
from collections import deque
from typing import Deque, List, Optional, Sequence, Tuple

import numpy as np

from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError
from vb_laser_detect.calibration.pose import MIN_POINTS, POINT_SIGMA, Correspondences, PoseEstimate, estimate_pose

_HOLD_TIME = 2.0  # [s] for which a spot must be held before its position is taken
_MIN_SIGHTINGS = 5  # within the hold time
_STILL_PX = 3.0  # [px] from their median, within which four fifths of a still spot's sightings are
_SAME_PLACE_PX = 15.0  # [px] from an earlier place, within which a spot has not been moved


class StillSpotFinder:
    """Finds a laser spot that is held still in the image."""

    def __init__(self) -> None:
        self._sightings: Deque[Tuple[float, float, float]] = deque(maxlen=500)
        self._newest = -math.inf

    def add(self, stamp: float, spots: Sequence[Tuple[float, float]]) -> None:
        """Adds an image's stamp [s] and its detections (u, v) [px], even if there are none."""
        if stamp < self._newest:
            self._sightings.clear()
        self._newest = stamp
        self._sightings.extend((stamp, u, v) for u, v in spots)

    def median_position(self) -> Tuple[float, float]:
        """Returns the spot's median position (u, v) [px] in the images of the last two seconds.

        Raises:
            CodedError: "spot_not_seen_by_camera" if it was not seen often enough, "spot_moving" if it was not still.
        """
        recent = np.array([(u, v) for stamp, u, v in self._sightings if stamp >= self._newest - _HOLD_TIME])
        if len(recent) < _MIN_SIGHTINGS:
            raise CodedError("spot_not_seen_by_camera")
        median = np.median(recent, axis=0)
        if np.percentile(np.linalg.norm(recent - median, axis=1), 80) > _STILL_PX:
            raise CodedError("spot_moving")
        return float(median[0]), float(median[1])


class PoseCalibrationSession:
    """The places on the floor where a camera saw a spot. Their map positions are known to `point_sigma` [m]."""

    def __init__(self, camera: CameraModel, point_sigma: float = POINT_SIGMA) -> None:
        self._camera = camera
        self._point_sigma = point_sigma
        self._pixels: List[Sequence[float]] = []
        self._points: List[Sequence[float]] = []

    def __len__(self) -> int:
        return len(self._points)

    @property
    def observed(self) -> Correspondences:
        """All places so far."""
        return Correspondences(self._pixels, self._points)

    def add(self, pixel: Sequence[float], point: Sequence[float]) -> None:
        """Adds a place, (u, v) in the image [px] and (x, y) in the map [m].

        Raises:
            CodedError: "bad_points" if x or y is not finite, "same_place" if the pixel is that of an earlier place.
        """
        if not np.isfinite(point).all():
            raise CodedError("bad_points")
        for earlier_pixel, earlier_point in zip(self._pixels, self._points):
            if math.dist(pixel, earlier_pixel) < _SAME_PLACE_PX:
                raise CodedError("same_place", place="({:.2f}, {:.2f})".format(*earlier_point))
        self._pixels.append(pixel)
        self._points.append(point)

    def undo(self) -> bool:
        """Removes the last place; returns whether there was one."""
        had_place = len(self) > 0
        del self._pixels[-1:], self._points[-1:]
        return had_place

    def solve(self) -> PoseEstimate:
        """Estimates the camera's pose. Errors are those of `estimate_pose`."""
        return estimate_pose(self._camera, self.observed, self._point_sigma)

    def describe_progress(self) -> str:
        """Describes the result so far, or what is missing, in one line."""
        count = f"{len(self)} place{'' if len(self) == 1 else 's'}"
        if len(self) < MIN_POINTS:
            return f"{count}; at least {MIN_POINTS} are needed"
        try:
            estimate = self.solve()
        except CodedError as error:
            return f"{count}; not yet: {error}"
        return f"{count}: {_describe_fit(estimate)}"


def describe_estimate(estimate: PoseEstimate, observed: Correspondences) -> List[str]:
    """Describes the result to a person, in lines."""
    T = estimate.T_map_camera
    tilt = math.degrees(math.acos(max(-1.0, min(1.0, -float(T[2, 2])))))
    x_axis = math.degrees(math.atan2(T[1, 0], T[0, 0]))
    left_out = ~estimate.used
    lines = [
        f"position     {T[0, 3]:.3f} {T[1, 3]:.3f} {T[2, 3]:.3f} m",
        f"orientation  {tilt:.2f} deg from vertical, the image's x axis points to {x_axis:.1f} deg in the map",
        _describe_fit(estimate),
    ]
    for point, error in zip(observed.points[left_out], estimate.errors_m[left_out]):
        lines.append(f"left out     ({point[0]:.3f}, {point[1]:.3f}): {100 * error:.0f} cm off")
    return lines


def _describe_fit(estimate: PoseEstimate) -> str:
    """Describes how well the places fit, and a spot's uncertainty on the floor, in one line."""
    middle, worst = 100 * np.array(estimate.floor_sigma)
    return (
        f"{int(estimate.used.sum())} of {len(estimate.used)} points used, error {estimate.rms_px:.2f} px, "
        f"{100 * estimate.rms_m:.2f} cm on the floor; uncertainty of a spot {middle:.1f} cm in the middle of the image, "
        f"{worst:.1f} cm at its worst place (1 sigma)"
    )


def describe_points(estimate: PoseEstimate, observed: Correspondences) -> List[str]:
    """Describes each point that was measured, in lines, so that a calibration can be computed again."""
    return [
        f"({u:.2f}, {v:.2f}) px is ({x:.4f}, {y:.4f}) m, {100 * error:.2f} cm off"
        for (u, v), (x, y), error in zip(observed.pixels, observed.points, estimate.errors_m)
    ]


def parse_point(text: str) -> Optional[List[float]]:
    """Returns a line's two numbers, separated by spaces or commas, or None for any other line."""
    try:
        values = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        return None
    is_point = len(values) == 2 and all(map(math.isfinite, values))
    return values if is_point else None
