"""The printed ChArUco board: draws it, finds it in an image, and estimates a lens from views of it.

A person holds the board in front of the camera at many places and angles (Zhang, 2000; OpenCV).

>>> board = BoardParams.for_paper("A4")
>>> sheet = np.pad(draw_board(board, pixels_per_meter=2000.0), 50, constant_values=255)
>>> find_board(board, sheet).pixels.shape  # the inner corners of 5 x 4 squares
(12, 2)
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, NamedTuple, Optional, Tuple

import cv2
import numpy as np

from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError
from vb_core.parameters import Parameters, param

_SQUARES = (5, 4)  # few and therefore large: a camera on the ceiling must resolve them
_MARKER_SHARE = 0.75  # a marker's side, as a share of a square's
PAPERS_MM = {"A4": (297, 210), "A3": (420, 297), "A2": (594, 420), "A1": (841, 594), "A0": (1189, 841)}
_DPI = 300
_EDGE_MM = 8.0  # printers leave a margin
_MIN_MARKER_PX = 6 * 2.3  # side of a marker of 6 modules (4 x 4 and a black border), which need 2.3 px each
_MIN_CORNERS_TO_FIND_BOARD = 6
_MIN_CORNERS_TO_FIT_LENS = 8  # fewer in a view say little about the lens
_MIN_VIEWS = 12
_MAX_VIEWS = 30  # the newest ones; more views make the estimate slower, but hardly better
_CELLS = (8, 6)  # columns and rows of the image; a cell is covered once a corner has been seen in it
_MIN_COVERAGE = 0.6  # share of the cells
_MIN_SHIFT = 0.06  # share of the image's width by which the corners of a new view must have moved on average
# far more steps than OpenCV's default, with which a wide lens's focal length is 3 % off
_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-9)
_MAX_RMS = 1.0  # [px]
_MAX_FOCAL_SIGMA = 0.01  # share of the focal length: 1 cm at 1 m
# in views from straight ahead, a near board looks as it does through a long lens
_MIN_TILT = np.radians(12.0)
_MIN_TILTED_VIEWS = 4


@dataclass(frozen=True)
class BoardParams(Parameters):
    """The size of the printed board; its design is fixed."""

    square: float = param(0.07, "m", above=0.0, high=1.0, doc="side of a square")

    @classmethod
    def for_paper(cls, paper: str) -> "BoardParams":
        """Returns the largest board that fits a sheet.

        Raises:
            CodedError: "unknown_paper".
        """
        if paper not in PAPERS_MM:
            raise CodedError("unknown_paper", paper=paper, papers=", ".join(PAPERS_MM))
        width, height = PAPERS_MM[paper]
        square = min((width - 2 * _EDGE_MM) / _SQUARES[0], (height - 2 * _EDGE_MM) / _SQUARES[1])
        return cls(square=math.floor(square) / 1e3)

    @property
    def size(self) -> Tuple[float, float]:
        """(width, height) [m]"""
        return _SQUARES[0] * self.square, _SQUARES[1] * self.square

    def opencv(self) -> "cv2.aruco.CharucoBoard":
        """Returns the board as OpenCV's object."""
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        return cv2.aruco.CharucoBoard(_SQUARES, self.square, self.square * _MARKER_SHARE, dictionary)


@dataclass(frozen=True)
class BoardView:
    """A board's corners as seen in an image.

    Attributes:
        pixels: (N, 2) [px]
        corners: (N, 2) [m] the same corners on the board, to the right and down from its upper left corner.
        ids: (N,) numbers of the corners.
    """

    pixels: np.ndarray
    corners: np.ndarray
    ids: np.ndarray


def draw_board(board: BoardParams, pixels_per_meter: float) -> np.ndarray:
    """Draws the board without a margin, (H, W) uint8."""
    width, height = (int(round(side * pixels_per_meter)) for side in board.size)
    return board.opencv().generateImage((width, height), marginSize=0, borderBits=1)


def find_board(board: BoardParams, image: np.ndarray) -> BoardView:
    """Finds the board in an image, mono or bgr, uint8.

    Raises:
        CodedError: "no_board" if there is none; "board_too_small" if its markers are too small in the image;
            "board_hidden" if too few of its corners are seen.
    """
    gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    parameters = cv2.aruco.DetectorParameters()
    # relative to the image's longer side; OpenCV's default of 0.03 means 15 px per side at 1920
    parameters.minMarkerPerimeterRate = 0.01
    # markers on a floor are small: more samples of each module, from a smoother outline
    parameters.perspectiveRemovePixelPerCell = 8
    parameters.adaptiveThreshWinSizeMax = 33
    design = board.opencv()
    detector = cv2.aruco.CharucoDetector(design, cv2.aruco.CharucoParameters(), parameters)
    corners, ids, markers, _ = detector.detectBoard(gray)
    marker_px = 0.0
    if markers:
        marker_px = float(np.median([cv2.arcLength(marker, True) / 4 for marker in markers]))
        if marker_px < _MIN_MARKER_PX:
            raise CodedError("board_too_small", px=f"{marker_px:.0f}", least=f"{_MIN_MARKER_PX:.0f}")
    corner_count = 0 if ids is None else len(ids)
    if not corner_count and not markers:
        raise CodedError("no_board")
    if corner_count < _MIN_CORNERS_TO_FIND_BOARD:
        raise CodedError("board_hidden", corners=corner_count, least=_MIN_CORNERS_TO_FIND_BOARD)
    ids = ids.ravel()
    # the detector counts pixels from their centres or edges, depending on OpenCV's version: corners are refined again,
    # within the white between a corner and the markers
    window = max(2, min(5, int(marker_px * (1.0 / _MARKER_SHARE - 1.0) / 2.0)))
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 0.001)
    pixels = cv2.cornerSubPix(gray, corners.astype(np.float32), (window, window), (-1, -1), criteria)
    corners_on_board = design.getChessboardCorners()[ids][:, :2]
    return BoardView(pixels.reshape(-1, 2).astype(float), corners_on_board.astype(float), ids)


def write_board(paper: str, path: str) -> List[str]:
    """Writes the largest board at true size as PDF or PNG, by the path's extension; returns instructions for its use.

    Raises:
        CodedError: "unknown_paper", "bad_file".
    """
    from PIL import Image

    board = BoardParams.for_paper(paper)
    square_mm = 1e3 * board.square
    dots_per_mm = _DPI / 25.4
    width, height = (round(dots_per_mm * 1e3 * side) for side in board.size)
    page_width, page_height = (round(dots_per_mm * side) for side in PAPERS_MM[paper])
    # each of a marker's modules is a whole number of pixels, so that enlarging keeps the edges in place
    pattern = cv2.resize(draw_board(board, 80.0 / board.square), (width, height), interpolation=cv2.INTER_NEAREST)
    page = np.full((page_height, page_width), 255, np.uint8)
    top, left = (page_height - height) // 2, (page_width - width) // 2
    page[top : top + height, left : left + width] = pattern
    ruler_y = top + height + round(3.5 * dots_per_mm)
    ruler_end = left + round(100.0 * dots_per_mm)
    cv2.line(page, (left, ruler_y), (ruler_end, ruler_y), 0, 3)
    text = f"100 mm: print at 100 %, not fitted to the page.   {paper}, squares of {square_mm:.0f} mm"
    cv2.putText(page, text, (ruler_end + round(3 * dots_per_mm), ruler_y + 14), cv2.FONT_HERSHEY_SIMPLEX, 1.2, 0, 2)
    try:
        Image.fromarray(page > 127).save(path, resolution=_DPI, dpi=(_DPI, _DPI))
    except (OSError, ValueError) as error:  # no such folder, or an unknown extension
        raise CodedError("bad_file", file=path, why=str(error)) from None
    return [
        f"wrote {path}: {paper}, {_SQUARES[0]} x {_SQUARES[1]} squares of {square_mm:.0f} mm",
        f"Print it at 100 %. Check with a ruler: the pattern is {_SQUARES[0] * square_mm:.0f} mm wide. Glue it on something flat.",
    ]


class LensEstimate(NamedTuple):
    """A lens, and how well it is known."""

    camera: CameraModel
    rms: float  # [px] error of the corners
    focal_sigma: float  # relative standard deviation of the focal length
    tilted: int  # number of views in which the board is tilted


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
        """Adds a view unless it has too few corners or resembles an earlier one; returns whether it was added."""
        if len(view.ids) < _MIN_CORNERS_TO_FIT_LENS:
            return False
        if any(self._shift_between(view, earlier) < _MIN_SHIFT for earlier in self.views):
            return False
        self.views = [*self.views, view][-_MAX_VIEWS:]
        self._estimated = None
        cells = (view.pixels / self.size * _CELLS).astype(int)
        self.covered[tuple(np.clip(cells, 0, np.array(_CELLS) - 1).T)] = True
        return True

    def _shift_between(self, view: BoardView, earlier: BoardView) -> float:
        """Returns how far the corners have moved on average, in widths of the image, or 1 if both views share too few."""
        shared_ids, places, earlier_places = np.intersect1d(view.ids, earlier.ids, return_indices=True)
        if len(shared_ids) < 4:
            return 1.0
        shifts = np.linalg.norm(view.pixels[places] - earlier.pixels[earlier_places], axis=1)
        return float(shifts.mean()) / self.size[0]

    def estimate(self) -> LensEstimate:
        """Estimates the lens from the views so far, however good they are.

        Raises:
            CodedError: "too_few_views" while there are not enough, "lens_not_determined" if they do not fit one lens.
        """
        if len(self.views) < 4:
            raise CodedError("too_few_views", views=len(self.views), least=_MIN_VIEWS)
        if self._estimated is None:
            corners = [np.pad(view.corners, ((0, 0), (0, 1))).astype(np.float32) for view in self.views]  # z = 0
            pixels = [view.pixels.astype(np.float32) for view in self.views]
            try:
                result = cv2.calibrateCameraExtended(corners, pixels, self.size, None, None, criteria=_CRITERIA)
            except cv2.error:
                raise CodedError("lens_not_determined") from None
            rms, matrix, distortion, turns, _, deviations, *_ = result
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
        if len(self.views) < _MIN_VIEWS:
            raise CodedError("too_few_views", views=len(self.views), least=_MIN_VIEWS)
        coverage = self.covered.mean()
        if coverage < _MIN_COVERAGE:
            raise CodedError("little_coverage", percent=round(100 * coverage), least=round(100 * _MIN_COVERAGE))
        lens = self.estimate()
        if lens.rms > _MAX_RMS:
            raise CodedError("lens_not_determined")
        if lens.tilted < _MIN_TILTED_VIEWS:
            raise CodedError("board_not_tilted", views=lens.tilted, least=_MIN_TILTED_VIEWS)
        if lens.focal_sigma > _MAX_FOCAL_SIGMA:
            raise CodedError("lens_uncertain", percent=f"{100 * lens.focal_sigma:.1f}")
        return lens.camera, lens.rms

    def describe(self) -> str:
        """Describes the progress in one line."""
        text = f"{len(self.views)} views, {100 * self.covered.mean():.0f} % of the image covered"
        try:
            lens = self.estimate()
        except CodedError:
            return text
        return f"{text}, {lens.tilted} tilted, error {lens.rms:.2f} px"
