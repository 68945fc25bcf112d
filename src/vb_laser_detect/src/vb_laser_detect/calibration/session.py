"""What a person collects for a calibration, point by point, and its progress. No ROS, no terminal."""
from __future__ import annotations

import math
from collections import deque
from typing import Deque, List, Optional, Sequence, Tuple

import numpy as np

from vb_core import geometry
from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError
from vb_laser_detect.calibration.pose import LEAST_POINTS, CalibrationParams, Observations, PoseEstimate, estimate_pose
from vb_laser_detect.calibration.board import BoardParams, BoardView, corners_on_map, merge_views

_HOLD_S = 2.0  # a spot is held this long before a point is taken
_LEAST_SIGHTINGS = 5
_STILL_PX = 3.0


class HeldSpot:
    """Where a laser spot that is held still is in the image."""

    def __init__(self) -> None:
        self._sightings: Deque[Tuple[float, float, float]] = deque(maxlen=500)
        self._newest = -math.inf

    def see(self, stamp: float, spots: Sequence[Tuple[float, float]]) -> None:
        """Adds an image's detections [s], [px], even if there are none."""
        if stamp < self._newest:
            self._sightings.clear()
        self._newest = stamp
        self._sightings.extend((stamp, u, v) for u, v in spots)

    def place(self) -> Tuple[float, float]:
        """(u, v) [px] of the spot in the images of the last two seconds.

        Raises:
            CodedError: "no_spot" if it was not seen often enough, "spot_moves" if it was not still.
        """
        recent = np.array([(u, v) for stamp, u, v in self._sightings if stamp >= self._newest - _HOLD_S])
        if len(recent) < _LEAST_SIGHTINGS:
            raise CodedError("no_spot", "the camera does not see the spot: is this place in its picture? Hold the spot still for two seconds and try again")
        middle = np.median(recent, axis=0)
        away = np.linalg.norm(recent - middle, axis=1)
        if np.percentile(away, 80) > _STILL_PX:
            raise CodedError("spot_moves", "the spot is not still: rest the pointer on something, then try again")
        return float(middle[0]), float(middle[1])


class SpotSession:
    """Pairs of the held spot's places in the image and in the map."""

    method = "spots"

    def __init__(self, camera: CameraModel, params: CalibrationParams) -> None:
        self._camera, self._params = camera, params
        self._pairs: List[Tuple[Tuple[float, float], Tuple[float, float]]] = []

    def __len__(self) -> int:
        return len(self._pairs)

    @property
    def observed(self) -> Observations:
        """All pairs so far."""
        pixels, points = zip(*self._pairs) if self._pairs else ((), ())
        return Observations.single(np.array(pixels), np.array(points))

    def add(self, pixel: Tuple[float, float], point: Tuple[float, float]) -> None:
        """Adds a pair [px], [m].

        Raises:
            CodedError: "same_place" if it repeats one.
        """
        for other_pixel, other in self._pairs:
            if math.hypot(pixel[0] - other_pixel[0], pixel[1] - other_pixel[1]) < 15.0:
                place = f"({other[0]:.2f}, {other[1]:.2f})"
                raise CodedError("same_place", f"the spot is where it was for {place}: move it first")
        self._pairs.append((pixel, point))

    def undo(self) -> bool:
        """Removes the last pair."""
        return bool(self._pairs) and self._pairs.pop() is not None

    def solve(self) -> PoseEstimate:
        """The camera's pose; raises what `estimate_pose` raises."""
        return estimate_pose(self._camera, self.observed, self._params)

    def progress(self) -> str:
        """A line about how far one is."""
        return progress(self, LEAST_POINTS, "point", "points")


class BoardSession:
    """Views of a board in several places."""

    method = "board"

    def __init__(self, camera: CameraModel, params: CalibrationParams, board: BoardParams) -> None:
        self._camera, self._params, self._board = camera, params, board
        self._placed: List[Tuple[np.ndarray, np.ndarray]] = []

    def __len__(self) -> int:
        return len(self._placed)

    @property
    def observed(self) -> Observations:
        """The corners in all places so far."""
        return Observations.boards(self._placed)

    def add(self, views: List[BoardView], p1: Tuple[float, float], p2: Tuple[float, float]) -> int:
        """Adds views of the board with its two points at two places of the map [m]; returns the corners seen.

        Raises:
            CodedError: "no_board", "board_hidden", "board_moved", "placement_mismatch".
        """
        view = merge_views(views)
        self._placed.append((view.pixels, corners_on_map(self._board, view.corners, p1, p2)))
        return len(view.ids)

    def undo(self) -> bool:
        """Removes the last place."""
        return bool(self._placed) and self._placed.pop() is not None

    def solve(self) -> PoseEstimate:
        """The camera's pose; raises what `estimate_pose` raises."""
        return estimate_pose(self._camera, self.observed, self._params)

    def progress(self) -> str:
        """A line about how far one is."""
        return progress(self, 1, "place", "places")


def progress(session: "SpotSession | BoardSession", least: int, one: str, many: str) -> str:
    """The result of the points so far, or what is missing."""
    count = f"{len(session)} {one if len(session) == 1 else many}"
    if len(session) < least:
        return f"{count}; at least {least} are needed"
    try:
        estimate = session.solve()
    except CodedError as error:
        return f"{count}; not yet: {error}"
    left_out = int((~estimate.used).sum())
    return (
        f"{count}: error {estimate.rms_px:.2f} px, {100 * estimate.rms_m:.2f} cm on the floor"
        + (f", {left_out} of {len(estimate.used)} left out as wrong" if left_out else "")
        + f"; a spot is certain to {100 * estimate.floor_sigma[0]:.1f} cm in the middle, "
        f"{100 * estimate.floor_sigma[1]:.1f} cm at the worst place"
    )


def describe(estimate: PoseEstimate, observed: Observations) -> List[str]:
    """Lines that show the result to a person."""
    T = estimate.T_map_camera
    tilt = math.degrees(math.acos(max(-1.0, min(1.0, -float(T[2, 2])))))
    right = math.degrees(math.atan2(T[1, 0], T[0, 0]))
    used = estimate.used
    sigma_cm, sigma_deg = 100 * estimate.position_sigma, np.degrees(estimate.angle_sigma)
    qx, qy, qz, qw = geometry.quaternion_from_rotation(T[:3, :3])
    lines = [
        f"position     {T[0, 3]:.3f} {T[1, 3]:.3f} {T[2, 3]:.3f} m, "
        f"+- {sigma_cm[0]:.1f} {sigma_cm[1]:.1f} {sigma_cm[2]:.1f} cm",
        f"orientation  {tilt:.2f} deg off looking straight down, the image's right is {right:.1f} deg in the map, "
        f"+- {sigma_deg[0]:.2f} {sigma_deg[1]:.2f} {sigma_deg[2]:.2f} deg about the camera's x, y, z",
        f"quaternion   {qx:.6f} {qy:.6f} {qz:.6f} {qw:.6f}",
        f"points       {int(used.sum())} of {len(used)} used",
        f"error        {estimate.rms_px:.2f} px rms, {estimate.errors_px[used].max():.2f} px at most",
        f"on the floor {100 * estimate.rms_m:.2f} cm rms, {100 * estimate.errors_m[used].max():.2f} cm at most",
        f"certain to   {100 * estimate.floor_sigma[0]:.1f} cm in the middle of the image, "
        f"{100 * estimate.floor_sigma[1]:.1f} cm at its worst place (1 sigma)",
    ]
    for point, error in zip(observed.points[~used], estimate.errors_m[~used]):
        lines.append(f"left out     ({point[0]:.3f}, {point[1]:.3f}): {100 * error:.0f} cm off")
    return lines


def parse_numbers(text: str, count: int) -> Optional[List[float]]:
    """The numbers of a line that has exactly this many, separated by spaces or commas; None otherwise."""
    try:
        values = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        return None
    return values if len(values) == count and all(math.isfinite(value) for value in values) else None
