"""The light that a projector adds to the floor.

Light adds up and is reflected by what it falls on: at each place the floor gets brighter by its own colour times the
projector's light, as a multiple of the light that is there anyway. Things and people that stand in the beam get none of
it, and the floor behind them no shadow; the light's own photon noise is left out.
"""
from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from vb_sim.models_cameras import Optics
from vb_sim.world import Projector

# of white LED light, and channels that share it: how Optics.ambient_w_m2 is worked out in config/models.yaml
_LUMENS_PER_WATT, _CHANNELS = 300.0, 3
# what pictures are made for, sRGB's
_GAMMA = 2.2
_LINEAR = np.rint(255.0 * (np.arange(256) / 255.0) ** _GAMMA).astype(np.uint8)


@dataclass(frozen=True)
class FloorLight:
    """A projector's picture as light.

    Attributes:
        linear: (H, W, 3) uint8 rgb; 255 is all of the projector's light.
        matrix: (3, 3) homogeneous map coordinates [m] to (column, row) [px] of it.
        strength: all of its light as a multiple of the lamps' light on the floor.
    """

    linear: np.ndarray
    matrix: np.ndarray
    strength: float

    def on_floor(self, columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """The light where a camera's pixels meet the floor.

        Args:
            columns, rows: maps as cv2.remap takes them, see `pixel_maps`.
        """
        return cv2.remap(self.linear, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)

    def pixel_maps(self, x: np.ndarray, y: np.ndarray):
        """Floor coordinates (H, W) [m] to maps for `on_floor`; they hold for all pictures of this size and projector."""
        m = self.matrix
        depth = m[2, 0] * x + m[2, 1] * y + m[2, 2]
        # behind the projector there is no light
        depth = np.where(depth > 1e-9, depth, np.nan)
        columns, rows = ((m[axis, 0] * x + m[axis, 1] * y + m[axis, 2]) / depth for axis in (0, 1))
        limit = 16000.0
        outside = ~((np.abs(columns) < limit) & (np.abs(rows) < limit))
        columns[outside] = rows[outside] = -limit
        return cv2.convertMaps(columns.astype(np.float32), rows.astype(np.float32), cv2.CV_16SC2)


def floor_light(picture: np.ndarray, projector: Projector, optics: Optics) -> FloorLight:
    """A projector's picture (H, W, 3) uint8 rgb as the light that it makes."""
    height, width = picture.shape[:2]
    corners = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], np.float32)
    floor = np.array(projector.corners, dtype=float)
    middle = floor.mean(axis=0)
    matrix = cv2.getPerspectiveTransform((floor - middle).astype(np.float32), corners)
    matrix = matrix @ np.array([[1, 0, -middle[0]], [0, 1, -middle[1]], [0, 0, 1.0]])
    # the scale of a homography is free: above 0 is in front of the projector
    matrix = matrix / (matrix[2] @ [*middle, 1.0])
    ambient_lux = optics.ambient_w_m2 * _CHANNELS * _LUMENS_PER_WATT
    return FloorLight(cv2.LUT(picture, _LINEAR), matrix, projector.lumens / projector.area_m2() / ambient_lux)
