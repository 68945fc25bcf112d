"""Estimates a lens from views of the printed board, held before the camera in many ways (Zhang, 2000; OpenCV)."""

from __future__ import annotations

from typing import List, NamedTuple, Optional, Tuple

import cv2
import numpy as np

from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError
from vb_laser_detect.calibration.board import BoardView

MIN_VIEWS, MIN_COVERAGE = 12, 0.6
_MAX_VIEWS = 30  # the newest ones: more make the estimate slower, but hardly better
_CELLS = (8, 6)  # of the image; a cell is covered once a corner was seen in it
_NEW_SHARE = 0.06  # of the image's width, by which a new view's corners must have moved on average
# far more steps than OpenCV's default, which ends 3 % off a wide lens's focal length
_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-9)
_MAX_RMS = 1.0  # [px]
_MAX_FOCAL_SIGMA = 0.01  # of the focal length: 1 cm at 1 m
_MIN_TILT, _MIN_TILTED = np.radians(12.0), 4  # views from straight ahead cannot tell a near board from a long lens
_MIN_CORNERS = 8  # of a view: fewer say little about the lens


class LensEstimate(NamedTuple):
    """A lens.

    Attributes:
        rms: [px] error of the corners.
        focal_sigma: relative standard deviation of the focal length.
        tilted: number of views in which the board is tilted.
    """

    camera: CameraModel
    rms: float
    focal_sigma: float
    tilted: int


class LensCalibration:
    """Collects views, and estimates the lens.

    Args:
        size: width and height of the images [px].

    Attributes:
        covered: cells of the image in which corners were seen, (columns, rows) bool.
    """

    def __init__(self, size: Tuple[int, int]) -> None:
        self.size = size
        self.views: List[BoardView] = []
        self.covered = np.zeros(_CELLS, bool)
        self._estimated: Optional[LensEstimate] = None

    def add(self, view: BoardView) -> bool:
        """Adds a view unless it has too few corners or resembles another one; returns whether it was added."""
        if len(view.ids) < _MIN_CORNERS or any(self._moved(view, other) < _NEW_SHARE for other in self.views):
            return False
        self.views = [*self.views, view][-_MAX_VIEWS:]
        self._estimated = None
        cells = (view.pixels / self.size * _CELLS).astype(int)
        self.covered[tuple(np.clip(cells, 0, np.array(_CELLS) - 1).T)] = True
        return True

    def _moved(self, view: BoardView, other: BoardView) -> float:
        both, here, there = np.intersect1d(view.ids, other.ids, return_indices=True)
        if len(both) < 4:
            return 1.0
        moved = np.linalg.norm(view.pixels[here] - other.pixels[there], axis=1)
        return float(moved.mean()) / self.size[0]

    def estimate(self) -> LensEstimate:
        """Estimates the lens.

        Raises:
            CodedError: "too_few_views" while there are not enough, "lens_not_determined" if they do not fit one lens.
        """
        if len(self.views) < 4:
            raise CodedError("too_few_views", views=len(self.views), least=MIN_VIEWS)
        if self._estimated is None:
            corners = [
                np.column_stack([view.corners, np.zeros(len(view.ids))]).astype(np.float32) for view in self.views
            ]
            pixels = [view.pixels.astype(np.float32) for view in self.views]
            try:
                rms, matrix, distortion, turns, _, deviations, *_ = cv2.calibrateCameraExtended(
                    corners, pixels, self.size, None, None, criteria=_CRITERIA
                )
            except cv2.error:
                raise CodedError("lens_not_determined") from None
            camera = CameraModel(*self.size, matrix, distortion.ravel()[:5])
            focal_sigma = max(deviations.ravel()[:2] / (matrix[0, 0], matrix[1, 1]))
            slants = [np.arccos(min(1.0, abs(float(cv2.Rodrigues(turn)[0][2, 2])))) for turn in turns]
            self._estimated = LensEstimate(camera, rms, focal_sigma, sum(slant > _MIN_TILT for slant in slants))
        return self._estimated

    def solve(self) -> Tuple[CameraModel, float]:
        """Returns the lens and its error [px], if it is good enough to be used.

        Raises:
            CodedError: "too_few_views", "little_coverage", "lens_not_determined", "board_not_tilted", "lens_uncertain".
        """
        if len(self.views) < MIN_VIEWS:
            raise CodedError("too_few_views", views=len(self.views), least=MIN_VIEWS)
        if self.covered.mean() < MIN_COVERAGE:
            raise CodedError(
                "little_coverage", percent=round(100 * self.covered.mean()), least=round(100 * MIN_COVERAGE)
            )
        found = self.estimate()
        if found.rms > _MAX_RMS:
            raise CodedError("lens_not_determined")
        if found.tilted < _MIN_TILTED:
            raise CodedError("board_not_tilted", views=found.tilted, least=_MIN_TILTED)
        if found.focal_sigma > _MAX_FOCAL_SIGMA:
            raise CodedError("lens_uncertain", percent=f"{100 * found.focal_sigma:.1f}")
        return found.camera, found.rms

    def describe(self) -> str:
        """Describes the progress in one line."""
        text = f"{len(self.views)} views, {100 * self.covered.mean():.0f} % of the image covered"
        try:
            found = self.estimate()
        except CodedError:
            return text
        return f"{text}, {found.tilted} tilted, error {found.rms:.2f} px"
