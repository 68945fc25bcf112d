"""Rendered camera images whose spots are known to a fraction of a pixel."""

from __future__ import annotations

import math
from typing import Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core import geometry
from vb_core.camera_model import CameraModel
from vb_core.image_format import Picture
from vb_laser_detect.detection.projection import FloorProjection, ImageGeometry
from vb_laser_detect.detection.spot_detector import SpotDetector

RED = (0.12, 0.2, 1.0)  # response of the sensor's blue, green and red pixels to a red laser
GREEN = (0.2, 1.0, 0.15)


class Scene:
    """A textured floor under a camera: its mean brightness [grey levels], and each pixel's standard deviation as noise."""

    def __init__(
        self, width: int = 640, height: int = 360, brightness: float = 110.0, noise: float = 3.0, seed: int = 1
    ) -> None:
        self._random = np.random.default_rng(seed)
        coarse = self._random.normal(0.0, 1.0, (height // 40 + 2, width // 40 + 2)).astype(np.float32)
        fine = cv2.GaussianBlur(self._random.normal(0.0, 1.0, (height, width)).astype(np.float32), (0, 0), 1.5)
        floor = brightness * (1.0 + 0.08 * cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC))
        floor += 0.12 * brightness * fine / fine.std()
        # straight edges: joints between tiles
        floor[:: max(60, height // 5)] *= 0.6
        floor[:, :: max(60, width // 7)] *= 0.6
        self.floor = floor[:, :, None] * np.array([0.86, 0.97, 1.04], np.float32)
        # noise is drawn once, and read from another offset for each image: to draw it each time would take most of the time
        self._noise = self._random.normal(0.0, noise, (2 * height * width * 3,)).astype(np.float32)

    def render(
        self,
        spots: Sequence[Tuple[float, float]] = (),
        sigma: float = 2.5,
        power: float = 420.0,
        color: Tuple[float, float, float] = RED,
        smear: Tuple[float, float] = (0.0, 0.0),
        gain: float = 1.0,
        floor: Optional[np.ndarray] = None,
        bayer: bool = False,
    ) -> np.ndarray:
        """Renders (H, W, 3) bgr uint8, or (H, W) as bayer_rggb8.

        Args:
            spots, sigma, power: centres (u, v) [px], size [px] and light [grey levels] of Gaussian spots.
            smear: [px] motion of a spot while the shutter is open, centred on its position.
            floor: a floor (H, W, 3) float in place of the scene's.
        """
        light = (self.floor if floor is None else floor).copy()
        height, width = light.shape[:2]
        steps = 1 + int(np.hypot(*smear))
        path = np.linspace(-0.5, 0.5, steps) if steps > 1 else [0.0]
        for u, v in spots:
            for step in path:
                cu, cv = u + step * smear[0], v + step * smear[1]
                left, right = (int(np.clip(cu + side * 5 * sigma, 0, width)) for side in (-1, 1))
                top, bottom = (int(np.clip(cv + side * 5 * sigma, 0, height)) for side in (-1, 1))
                gx = np.exp(-0.5 * ((np.arange(left, right) - cu) / sigma) ** 2)
                gy = np.exp(-0.5 * ((np.arange(top, bottom) - cv) / sigma) ** 2)
                glow = (power / steps) * (gy[:, None] * gx[None])[:, :, None]
                light[top:bottom, left:right] += (glow * color).astype(np.float32)
        light = light * gain
        if bayer:
            mosaic = np.empty((height, width), np.float32)
            for row, column, channel in ((0, 0, 2), (0, 1, 1), (1, 0, 1), (1, 1, 0)):
                mosaic[row::2, column::2] = light[row::2, column::2, channel]
            light = mosaic
        start = int(self._random.integers(0, self._noise.size - light.size))
        noise = self._noise[start : start + light.size].reshape(light.shape)
        return cv2.convertScaleAbs(np.clip(light + noise, 0, 255))


def tinted(scene: Scene) -> Scene:
    """Returns the scene with its floor so coloured that its Bayer image can be told from a grey one."""
    scene.floor = scene.floor * np.array([0.75, 1.0, 1.1], np.float32)
    return scene


def shown(scene: Scene, kind: str, spots=(), *light, **more) -> np.ndarray:
    """Renders an image as a camera of a kind takes it: bgr, bayer, or mono, which is the green channel."""
    image = scene.render(spots, *light, bayer=kind == "bayer", **more)
    return image[:, :, 1].copy() if kind == "mono" else image


class ImageDetector(SpotDetector):
    """A detector whose `detect` returns the image's own spots; `earlier` has those of earlier images, now confirmed."""

    def __init__(self, params=None, classifier=None, bayer=False, geometry=None):
        super().__init__(params, classifier)
        self.bayer, self.geometry = bayer, geometry
        self.detections = []  # what has become of each image so far

    def detect(self, image, stamp):
        """See `SpotDetector.detect`."""
        picture = Picture(image, "bayer_rggb") if self.bayer else image
        self.detections.append(super().detect(picture, stamp, self.geometry))
        spots = list(self.detections[-1].spots)
        self.earlier = [spot for spot in spots if spot.stamp != stamp]
        return spots[len(self.earlier) :]


def from_above(meters_per_pixel=0.004, floor=None, find_pose=None):
    """Returns the geometry of a camera that looks straight down on (0, 0), or whose pose a function finds."""
    pose = geometry.make_transform(geometry.rotation_from_rpy(math.pi, 0.0, 0.0), (0.0, 0.0, 500.0 * meters_per_pixel))
    return ImageGeometry(CameraModel.ideal(640, 480, 500.0), FloorProjection(floor=floor), find_pose or (lambda: pose))
