"""The light that a projector adds to the floor.

Light adds up and is reflected by what it falls on: at each place the floor gets brighter by its own colour times the
projector's light, as a multiple of the light that is there anyway. Things and people in the beam get none of
it, and the floor behind them no shadow; the light's photon noise is ignored.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

import cv2
import numpy as np

from vb_sim.room.camera_models import Optics
from vb_sim.room.world import Projector

# of white LED light, and channels that share it: how Optics.ambient_w_m2 is worked out in config/models.yaml
_LUMENS_PER_WATT, _CHANNELS = 300.0, 3
# the gamma of images, sRGB's
_GAMMA = 2.2
_LINEAR = np.rint(255.0 * (np.arange(256) / 255.0) ** _GAMMA).astype(np.uint8)


@dataclass(frozen=True)
class FloorLight:
    """A projector's image as light.

    Attributes:
        linear: (H, W, 3) uint8 rgb; 255 is all of the projector's light.
        matrix: (3, 3) homogeneous map coordinates [m] to (column, row) [px] of it.
        strength: all of its light as a multiple of the lamps' light on the floor.
    """

    linear: np.ndarray
    matrix: np.ndarray
    strength: float

    def pixel_maps(self, x: np.ndarray, y: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Maps floor coordinates x and y (H, W) [m] to the image, for all images of this size and projector.

        Returns:
            (H, W, 2) float32 (column, row) [px], and (H, W) bool: which of them are in the image.
        """
        m = self.matrix
        depth = m[2, 0] * x + m[2, 1] * y + m[2, 2]
        ahead = depth > 1e-9  # behind the projector there is no light
        at = np.stack([m[axis, 0] * x + m[axis, 1] * y + m[axis, 2] for axis in (0, 1)], axis=-1)
        at /= np.where(ahead, depth, 1.0)[..., None]
        at[~ahead] = -2.0
        height, width = self.linear.shape[:2]
        inside = ahead & (at > -1.0).all(axis=-1) & (at[..., 0] < width) & (at[..., 1] < height)
        return at.astype(np.float32), inside

    @staticmethod
    def remap_maps(at: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Converts those maps to what `on_floor` takes, (H, W, 2) [px] in fixed point: half the time of floats."""
        columns, rows = (np.clip(at[..., axis], -2.0, 16000.0) for axis in (0, 1))
        return cv2.convertMaps(columns, rows, cv2.CV_16SC2)

    def on_floor(self, columns_rows: np.ndarray, fractions: np.ndarray) -> np.ndarray:
        """Returns the light (H, W, 3) uint8 at the places that `remap_maps` gave."""
        return cv2.remap(self.linear, columns_rows, fractions, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)


def floor_light(image: np.ndarray, projector: Projector, optics: Optics) -> FloorLight:
    """Turns a projector's image (H, W, 3) uint8 rgb into light."""
    height, width = image.shape[:2]
    corners = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], np.float32)
    floor = np.array(projector.corners, dtype=float)
    middle = floor.mean(axis=0)
    matrix = cv2.getPerspectiveTransform((floor - middle).astype(np.float32), corners)
    matrix = matrix @ np.array([[1, 0, -middle[0]], [0, 1, -middle[1]], [0, 0, 1.0]])
    # the scale of a homography is free: above 0 is in front of the projector
    matrix = matrix / (matrix[2] @ [*middle, 1.0])
    ambient_lux = optics.ambient_w_m2 * _CHANNELS * _LUMENS_PER_WATT
    return FloorLight(cv2.LUT(image, _LINEAR), matrix, projector.lumens / projector.area_m2() / ambient_lux)
