"""Augments labelled pictures as if other cameras had recorded them.

The steps simulate a camera: another exposure in linear light, with flicker that rolls through the image; another tone
curve; noise; denoising; sharpening; and compression, which halves the colours' resolution. A picture does not tell how
bright a saturated spot was, so the spot's profile is continued inwards as a Gaussian.
"""

from __future__ import annotations

from typing import List, NamedTuple, Optional, Sequence, Tuple

import cv2
import numpy as np

GAMMA = 2.2
SATURATED = 245  # [grey levels]
PAINT_EVERY = 12  # [pictures]
_MIN_CONTRAST = 30  # [grey levels] of a painted spot that counts as visible
_SIGMAS = 0.7, 5.0  # [px] of painted spots
_LEVELS = 16383  # of linear light


class CameraSettings(NamedTuple):
    """The settings of a camera.

    Attributes:
        exposure: as a multiple of the picture's, in linear light.
        spot_widths: radius of the saturated core [sigmas of the spot]; 1.5 gives a peak of 3 times white, 2 of 7.
        bands: amplitude of the rolling bands of mains flicker, as a share of the light.
        noise: [grey levels]
        denoised: whether a median filter is applied, and the last picture is blended in where little has changed.
        gamma: of the tone curve, as a multiple of the usual one.
        sharpening: share of the difference from the blurred picture that is added.
        quality: of the JPEG.
    """

    exposure: float = 1.0
    spot_widths: float = 1.8
    bands: float = 0.0
    noise: float = 0.0
    denoised: bool = False
    gamma: float = 1.0
    sharpening: float = 0.0
    quality: int = 90

    @staticmethod
    def draw(random: np.random.Generator, exposure: Tuple[float, float]) -> "CameraSettings":
        """Draws random settings, with an exposure between two limits [stops]."""
        return CameraSettings(
            exposure=float(2.0 ** random.uniform(*exposure)),
            spot_widths=float(random.uniform(1.3, 2.1)),
            bands=float(random.choice([0.0, 0.0, 0.1, 0.3])),
            noise=float(random.uniform(0.5, 3.0)),
            denoised=bool(random.random() < 0.4),
            gamma=float(random.uniform(0.85, 1.2)),
            sharpening=float(random.choice([0.0, 0.5, 1.0])),
            quality=int(random.integers(45, 96)),
        )


class PaintedSpot(NamedTuple):
    """A spot at (u, v) [px], with its sigma [px], its peak in units of white, and its shares of blue, green and red."""

    u: float
    v: float
    sigma: float
    peak: float
    color: Tuple[float, float, float]

    @staticmethod
    def draw(random: np.random.Generator, width: int, height: int) -> "PaintedSpot":
        """Draws a random spot in an image, from barely visible to saturated, in the sizes at all camera distances."""
        u, v = random.uniform((24, 24), (width - 24, height - 24))
        strong_channel = int(random.integers(1, 3))
        color = random.uniform(0.05, 0.6, 3)
        color[strong_channel] = 1.0
        sigma = float(np.exp(random.uniform(*np.log(_SIGMAS))))
        peak = float(random.uniform(0.12, 3.0))
        return PaintedSpot(float(u), float(v), sigma, peak, tuple(color.tolist()))

    def shows_in(self, picture: np.ndarray) -> bool:
        """Returns whether the spot stands out from its surroundings."""
        u, v = int(round(self.u)), int(round(self.v))
        reach = max(7, int(3.0 * self.sigma))
        part = picture[v - reach : v + reach + 1, u - reach : u + reach + 1].max(axis=2).astype(int)
        middle = part[reach - 2 : reach + 3, reach - 2 : reach + 3]
        rim = np.concatenate([part[0], part[-1], part[:, 0], part[:, -1]])
        return bool(middle.max() - np.median(rim) >= _MIN_CONTRAST)


class OtherCamera:
    """Converts a clip's pictures, in order, to those that another camera would record.

    Args:
        seed: of the camera's noise.
    """

    def __init__(self, settings: CameraSettings, seed: int) -> None:
        self._settings = settings
        self._random = np.random.default_rng(seed)
        self._count = 0
        self._last: Optional[np.ndarray] = None
        self._painted: Optional[PaintedSpot] = None
        self._curve = (np.arange(256) / 255.0).astype(np.float32) ** GAMMA
        # uses lookup tables and one noise image that is shifted: computing both for each pixel would be slow
        levels = 255.0 * (np.arange(_LEVELS + 1) / _LEVELS) ** (1.0 / (GAMMA * settings.gamma))
        self._shown = levels.astype(np.float32)
        self._noise = self._random.normal(0.0, settings.noise, (512, 2048, 3)).astype(np.float32)

    def record(
        self, image: np.ndarray, spots: Sequence[Tuple[float, float]], paint: bool = False
    ) -> Tuple[np.ndarray, List[Tuple[float, float]], List[Tuple[float, float]]]:
        """Returns a bgr picture (H, W, 3) as this camera records it, and the positions of the spots painted into it.

        The first list contains the visible spots, the second the hardly visible ones.

        Args:
            spots: (u, v) [px] of the picture's spots.
            paint: whether a spot may be added, which happens in three of every twelve pictures.
        """
        painted = []
        if paint and self._count % PAINT_EVERY < 3:
            if self._count % PAINT_EVERY == 0 or self._painted is None:
                self._painted = PaintedSpot.draw(self._random, image.shape[1], image.shape[0])
            painted = [self._painted]
        frame = self._record(image, spots, painted)
        seen, hidden = [], []
        for spot in painted:
            (seen if spot.shows_in(frame) else hidden).append((spot.u, spot.v))
        return frame, seen, hidden

    def _record(
        self, image: np.ndarray, spots: Sequence[Tuple[float, float]], painted: Sequence[PaintedSpot]
    ) -> np.ndarray:
        settings = self._settings
        self._count += 1
        light = cv2.LUT(image, self._curve)
        for u, v in spots:
            _continue_inwards(image, light, u, v, settings.spot_widths)
        light *= settings.exposure
        for spot in painted:
            columns = np.exp(-((np.arange(light.shape[1]) - spot.u) ** 2) / (2.0 * spot.sigma**2))
            rows = np.exp(-((np.arange(light.shape[0]) - spot.v) ** 2) / (2.0 * spot.sigma**2))
            near = slice(int(spot.v) - 20, int(spot.v) + 21), slice(int(spot.u) - 20, int(spot.u) + 21)
            profile = spot.peak * np.outer(rows[near[0]], columns[near[1]])
            light[near] += profile[:, :, None] * np.array(spot.color)
        if settings.bands:
            rows = np.arange(len(image), dtype=np.float32)[:, None, None]
            light *= 1.0 + settings.bands * np.sin(2 * np.pi * (rows / (0.35 * len(image)) + 0.13 * self._count))
        frame = self._shown[cv2.multiply(np.minimum(light, 1.0), (_LEVELS,) * 4, dtype=cv2.CV_16U)]
        top, left = self._random.integers(0, 32), self._random.integers(0, 700)
        for row in range(0, len(frame), 480):
            part = frame[row : row + 480]
            part += self._noise[top : top + len(part), left : left + part.shape[1]]
        if settings.denoised:
            median = cv2.medianBlur(np.clip(frame, 0, 255).astype(np.uint8), 3)
            frame = median.astype(np.float32) * 0.5 + frame * 0.5
            if self._last is not None:
                unchanged = np.abs(frame - self._last) < 12.0
                frame = np.where(unchanged, 0.4 * frame + 0.6 * self._last, frame)
            self._last = frame
        if settings.sharpening:
            frame = frame + settings.sharpening * (frame - cv2.GaussianBlur(frame, (0, 0), 1.2))
        done = np.clip(frame + 0.5, 0, 255).astype(np.uint8)
        _, jpeg = cv2.imencode(".jpg", done, [cv2.IMWRITE_JPEG_QUALITY, settings.quality])
        return cv2.imdecode(jpeg, cv2.IMREAD_COLOR)


def _continue_inwards(image: np.ndarray, light: np.ndarray, u: float, v: float, widths: float) -> None:
    """Replaces the light in a spot's saturated core by that of a Gaussian with the same outline."""
    reach = 40
    top, left = max(0, int(v) - reach), max(0, int(u) - reach)
    part = slice(top, int(v) + reach + 1), slice(left, int(u) + reach + 1)
    for channel in range(3):
        white = cv2.medianBlur((image[part][:, :, channel] >= SATURATED).view(np.uint8), 3)
        _, labels, stats, _ = cv2.connectedComponentsWithStats(white, connectivity=8)
        row = min(labels.shape[0] - 1, int(v) - top)
        column = min(labels.shape[1] - 1, int(u) - left)
        near = labels[max(0, row - 3) : row + 4, max(0, column - 3) : column + 4]
        label = int(near.max())
        if not label or stats[label, cv2.CC_STAT_AREA] > 0.08 * labels.size:
            continue
        inside = (labels == label).view(np.uint8)
        padded = cv2.copyMakeBorder(inside, 1, 1, 1, 1, cv2.BORDER_CONSTANT)
        depth = cv2.distanceTransform(padded, cv2.DIST_L2, 5)[1:-1, 1:-1]
        radius = float(depth.max())
        sigma = max(radius / widths, 0.5)
        gain = np.exp((radius**2 - (radius - depth) ** 2) / (2.0 * sigma**2))
        light[part][:, :, channel] *= np.where(inside > 0, gain, 1.0)


def draw_augmentations(name: str, random: np.random.Generator) -> List[Tuple[str, CameraSettings]]:
    """Draws a clip's two augmentations for training, with their names: a usual exposure and a dark one."""
    return [
        (f"taken again: {name}", CameraSettings.draw(random, (-1.0, 0.5))),
        (f"set dark: {name}", CameraSettings.draw(random, (-4.5, -1.5))),
    ]
