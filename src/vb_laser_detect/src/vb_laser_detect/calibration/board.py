"""Draws a ChArUco board for printing, and finds it in an image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Tuple

import cv2
import numpy as np

from vb_core.errors import CodedError
from vb_core.parameters import Parameters, param

PAPERS_MM = {
    "A4": (297.0, 210.0),
    "A3": (420.0, 297.0),
    "A2": (594.0, 420.0),
    "A1": (841.0, 594.0),
    "A0": (1189.0, 841.0),
}
_DPI = 300
_EDGE_MM = 8.0  # printers leave a margin
_MODULE_PX = 2.3  # a marker's modules cannot be told apart when they are smaller in the image
_MODULES = 6  # per side of a DICT_4X4 marker, with its black border
_MIN_CORNERS = 6
_SQUARES = (5, 4)  # few and therefore large: a camera on the ceiling must resolve them
_MARKER_SHARE = 0.75  # of a square's side


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
        ids: (N,) the corners' numbers.
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
    side = 0.0
    if markers:
        side = float(np.median([cv2.arcLength(marker, True) / 4 for marker in markers]))
        if side < _MODULES * _MODULE_PX:
            raise CodedError("board_too_small", px=f"{side:.0f}", least=f"{_MODULES * _MODULE_PX:.0f}")
    found = 0 if ids is None else len(ids)
    if not found and not markers:
        raise CodedError("no_board")
    if found < _MIN_CORNERS:
        raise CodedError("board_hidden", corners=found, least=_MIN_CORNERS)
    ids = ids.ravel()
    # refined again: whether the detector counts pixels from their centres or their edges depends on its version;
    # only within the white between a corner and the markers
    window = max(2, min(5, int(side * (1.0 / _MARKER_SHARE - 1.0) / 2.0)))
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 0.001)
    pixels = cv2.cornerSubPix(gray, corners.astype(np.float32), (window, window), (-1, -1), criteria)
    return BoardView(pixels.reshape(-1, 2).astype(float), design.getChessboardCorners()[ids][:, :2].astype(float), ids)


def write_board(paper: str, path: str) -> List[str]:
    """Writes the largest board at true size as PDF or PNG, by the path's extension; returns instructions for its use.

    Raises:
        CodedError: "unknown_paper", "bad_file".
    """
    from PIL import Image

    board, (width, height) = BoardParams.for_paper(paper), PAPERS_MM[paper]
    square, dots = 1e3 * board.square, _DPI / 25.4
    # each of a marker's modules is a whole number of pixels, so that enlarging keeps the edges in place
    wide, high = (round(dots * 1e3 * side) for side in board.size)
    picture = cv2.resize(draw_board(board, 80.0 / board.square), (wide, high), interpolation=cv2.INTER_NEAREST)
    page = np.full((round(dots * height), round(dots * width)), 255, np.uint8)
    top, left = (page.shape[0] - high) // 2, (page.shape[1] - wide) // 2
    page[top : top + high, left : left + wide] = picture
    below, ruler = top + high + round(3.5 * dots), left + round(100.0 * dots)
    cv2.line(page, (left, below), (ruler, below), 0, 3)
    text = f"100 mm: print at 100 %, not fitted to the page.   {paper}, squares of {square:.0f} mm"
    cv2.putText(page, text, (ruler + round(3.0 * dots), below + 14), cv2.FONT_HERSHEY_SIMPLEX, 1.2, 0, 2)
    try:
        Image.fromarray(page > 127).save(path, resolution=_DPI, dpi=(_DPI, _DPI))
    except (OSError, ValueError) as error:  # no such folder, or an unknown extension
        raise CodedError("bad_file", file=path, why=str(error)) from None
    return [
        f"wrote {path}: {paper}, {_SQUARES[0]} x {_SQUARES[1]} squares of {square:.0f} mm",
        f"Print it at 100 %. Check with a ruler: the pattern is {_SQUARES[0] * square:.0f} mm wide. Glue it on something flat.",
    ]
