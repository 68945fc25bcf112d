"""A projector's calibration: the homography between the floor and the projector's image, from clicked points."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Sequence, Tuple

import cv2
import numpy as np
import yaml

from vb_core.errors import CodedError
from vb_core.files import write_atomically

_INSET = 0.12  # markers' distance from the edges, as a share of the image's sides; the smaller, the more accurate
MARKER_COUNT = 4
# [m] between a click and the line through its neighbours; if it is shorter, the click is a mistake
_MIN_DISTANCE = 0.10


@dataclass(frozen=True)
class ProjectorCalibration:
    """A projector over the floor.

    Attributes:
        width, height: [px] size of the projector's image.
        matrix: (3, 3) homography from map coordinates [m] to (column, row) [px] of this image.

    Raises:
        CodedError: "bad_calibration" if no projector can have this size or matrix.
    """

    width: int
    height: int
    matrix: np.ndarray

    def __post_init__(self) -> None:
        matrix = np.asarray(self.matrix, dtype=float)
        if not (16 <= self.width <= 16384 and 16 <= self.height <= 16384):
            size = f"{self.width} x {self.height}"
            raise CodedError("bad_calibration", f"the picture's size must be 16 to 16384 px, got {size}")
        is_homography = matrix.shape == (3, 3) and np.isfinite(matrix).all()
        if not is_homography or abs(np.linalg.det(matrix)) < 1e-12:
            raise CodedError("bad_calibration", "the homography must be an invertible matrix of 3 x 3 numbers")
        inverse = np.linalg.inv(matrix)
        scales = image_corners(self.width, self.height) @ inverse[2, :2] + inverse[2, 2]
        if scales.min() * scales.max() <= 0:
            reason = "a part of the picture would lie beyond the horizon: was a point mistaken?"
            raise CodedError("bad_calibration", reason)
        object.__setattr__(self, "matrix", matrix)

    def footprint(self) -> np.ndarray:
        """Returns the image's corners on the floor, (4, 2) [m]: upper left, upper right, lower right, lower left."""
        corners = image_corners(self.width, self.height)
        return cv2.perspectiveTransform(corners[:, None], np.linalg.inv(self.matrix))[:, 0]


def image_corners(width: int, height: int) -> np.ndarray:
    """Returns the corners of an image, (4, 2) [px], in the order of `ProjectorCalibration.footprint`."""
    return np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * (width - 1, height - 1)


def markers(width: int, height: int) -> np.ndarray:
    """Returns the positions of the calibration's markers, (4, 2) [px], in the order of the corners."""
    inset = _INSET * np.array([width - 1, height - 1])
    towards_center = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    return image_corners(width, height) + inset * towards_center


def calibrate(width: int, height: int, floor: Sequence[Tuple[float, float]]) -> ProjectorCalibration:
    """Calibrates a projector whose four `markers` were clicked on the floor.

    Args:
        floor: (4, 2) [m], finite: the clicked positions, in the markers' order.

    Raises:
        CodedError: "bad_click" if the markers cannot be at these positions.
    """
    points = np.asarray(floor, dtype=float).reshape(-1, 2)
    # twice the area [m^2] of each three consecutive points' triangle, above 0 if they are in counter-clockwise order
    sides = np.roll(points, -1, axis=0) - points
    side_x, side_y = sides.T
    next_x, next_y = np.roll(sides, -1, axis=0).T
    double_areas = side_x * next_y - side_y * next_x
    # no two clicks may coincide and no three be collinear: each must be away from the line through its neighbours
    distances = [float(np.linalg.norm(first - second)) for first, second in combinations(points, 2)]
    is_flat = np.abs(double_areas).min() < _MIN_DISTANCE * max(distances)
    turns_both_ways = double_areas.min() < 0 < double_areas.max()
    if is_flat or turns_both_ways:
        raise CodedError("bad_click", reason_code="clicks_out_of_order")
    # the homography is computed relative to the points' centroid, because large coordinates would reduce its precision
    centroid = points.mean(axis=0)
    relative_points = (points - centroid).astype(np.float32)
    pixels = markers(width, height).astype(np.float32)
    to_centroid = np.eye(3)
    to_centroid[:2, 2] = -centroid
    matrix = cv2.getPerspectiveTransform(relative_points, pixels) @ to_centroid
    return ProjectorCalibration(width, height, matrix / np.abs(matrix).max())


def write_calibration(calibration: ProjectorCalibration, path: Path) -> None:
    """Writes a calibration's YAML file. Inverse of `read_calibration`. Raises CodedError "cannot_write"."""
    values = {"width": calibration.width, "height": calibration.height, "map_to_pixels": calibration.matrix.tolist()}
    head = "# Written by floor_projector, which makes another one if this is deleted: map coordinates [m] to pixels.\n"
    write_atomically(path, (head + yaml.safe_dump(values, sort_keys=False)).encode("utf-8"))


def read_calibration(path: Path) -> ProjectorCalibration:
    """Reads a calibration's YAML file.

    Raises:
        CodedError: "no_calibration" if it cannot be read, "bad_calibration" if it is not a calibration.
    """
    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
        if set(values) != {"width", "height", "map_to_pixels"}:
            raise ValueError(f"it must have exactly the keys width, height and map_to_pixels, not {list(values)}")
        matrix = np.array(values["map_to_pixels"], dtype=float)
        return ProjectorCalibration(int(values["width"]), int(values["height"]), matrix)
    except OSError as error:
        raise CodedError("no_calibration", f"cannot read '{path}': {error.strerror}") from None
    except yaml.YAMLError:
        raise CodedError("bad_calibration", f"'{path}' is not valid YAML") from None
    except (TypeError, ValueError) as error:
        raise CodedError("bad_calibration", f"'{path}' is not a projector's calibration: {error}") from None
