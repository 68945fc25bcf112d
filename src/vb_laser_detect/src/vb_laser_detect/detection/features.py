"""Measures features of an image's regions, and decides by them whether each shows a laser spot.

`measure` cuts a blob out of the rise over the reference and measures what sets light apart: it is brightest in its
middle, ends within some pixels and darkens nothing. An additive logistic model weighs the features: each has a curve,
linear between knots, whose value it adds to the log-odds. That is 0 for a usual spot, so the feature that lowers the
log-odds most is the reason for a rejection. bench/detection/training.py fits the curves.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import cycle
from pathlib import Path
from typing import Dict, List, Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_laser_detect.detection.background import blocks_around, brightest, max_channel, relight
from vb_laser_detect.detection.stage_results import Box, SearchedImage, Spot

_EDGE = 0.35  # the blob is where the rise exceeds this share of its peak
_MAX_ELONGATION = 2.0  # largest length of a spot, in largest diameters: a fast one is elongated
_ONE_MOSAIC = 0.75  # in one mosaic, a small spot's colour depends on the pixels it falls on; in a mean it does not
_WHITE = 240.0  # [grey levels] a pixel whose weakest channel is above this says nothing about colour
_GRAY = 0.85  # a floor is grey if its weakest channel has at least this share of the strongest
_MIN_BUSY = 0.02  # from this value of `busy` on, ghosts may be left
FEATURES = ("elongation", "peak", "level", "edge", "fall", "diameter", "chroma_mosaic", "busy")
# features that do not count against a spot seen where it was expected: its surroundings, and its colour, which it has
# shown before, and which other light, or the pixels of a mosaic that it falls on, may now hide
_WAIVED_IF_EXPECTED = ("fall", "busy", "chroma_mosaic")
_SQUARE, _QUAD = np.ones((3, 3), np.uint8), np.ones((2, 2), np.uint8)
_HALO = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))


@dataclass(frozen=True)
class Blob:
    """A region of an image that became brighter, in the image's pixels.

    Attributes:
        u, v: [px] centroid, sub-pixel; the centre of the first pixel is 0.
        diameter: [px] of a disc of the same area.
        problem: "too_large" or "too_faint" if only position and size were measured; else "".
        tint: (C,) each channel's share of its light, see `tint_of`; None for grey images.
        features: values by names of FEATURES; NaN for one that says nothing.
    """

    u: float
    v: float
    diameter: float
    problem: str = ""
    tint: Optional[np.ndarray] = None
    features: Dict[str, float] = field(default_factory=dict)


def examine_regions(
    searched: SearchedImage, max_diameters: Dict[Box, float], classifier: SpotClassifier, min_probability: float
) -> List[Spot]:
    """Measures and classifies all regions of an image.

    Args:
        max_diameters: [px] a spot's largest diameter in each box of each bright region; NaN where no floor is seen.
        min_probability: that the classifier must give to a spot.

    Returns:
        What each region shows, a spot or a rejected candidate, in the regions' order.
    """
    found = []
    for region in searched.regions:
        blob = _unmeasured(region.box, "too_dark")
        for box in region.boxes() if region.bright else ():
            max_width = math.inf if box is region.box else region.expected.max_width
            blob = measure(searched, box, max_diameters[box], max_width)
            if blob.problem != "too_large":
                break
            # by now, other light falls where a spot is expected
        probability, rejection = 0.0, blob.problem
        if not rejection:
            is_expected = region.expected is not None and region.expected.holds(blob.u, blob.v)
            probability, reason = classifier.classify(blob, is_expected)
            rejection = reason if probability < min_probability else ""
        found.append(Spot(blob.u, blob.v, blob.diameter, probability, rejection=rejection, tint=blob.tint))
    return found


def _unmeasured(box: Box, problem: str) -> Blob:
    left, top, right, bottom = box
    return Blob((left + right) / 2.0, (top + bottom) / 2.0, float(right - left), problem)


def measure(searched: SearchedImage, box: Box, max_diameter: float, max_width: float) -> Blob:
    """Measures the brightest blob of an image whose peak is in a box.

    Args:
        max_diameter: [px] a spot's largest diameter; NaN if no floor is seen there.
        max_width: [px] wider light is a change of the room's light, and belongs to the background.

    Returns:
        The blob; see its `problem`.
    """
    if math.isnan(max_diameter):
        return _unmeasured(box, "off_floor")
    image = searched.picture.pixels
    if brightest(image, box) < searched.min_level:  # now that it is decoded whole
        return _unmeasured(box, "too_dark")
    left, top, right, bottom = box
    margin, missing = 20, 1
    while missing > 0:
        # even bounds keep each pixel's position in the Bayer pattern
        x0, y0 = max(0, left - margin) & ~1, max(0, top - margin) & ~1
        window = slice(y0, bottom + margin), slice(x0, right + margin)
        now, before = image[window], searched.reference[window]
        if max_width < math.inf:
            before = cv2.max(before, relight(before, now, max_width))
        # the kernel [1 2 1] averages out noise and a Bayer image's mosaic
        smooth = cv2.GaussianBlur(max_channel(cv2.subtract(now, before)), (3, 3), 0, borderType=cv2.BORDER_REFLECT_101)
        _, peak, _, at = cv2.minMaxLoc(smooth[top - y0 : bottom - y0, left - x0 : right - x0])
        _, labels, stats, _ = cv2.connectedComponentsWithStats((smooth > _EDGE * peak).astype(np.uint8), connectivity=8)
        label = labels[at[1] + top - y0, at[0] + left - x0]
        bx, by, bw, bh, _ = stats[label].tolist()
        if peak < 4 or max(bw, bh) > _MAX_ELONGATION * max_diameter:
            middle = (left + right) / 2.0, (top + bottom) / 2.0
            return Blob(*middle, float(max(right - left, bottom - top)), "too_faint" if peak < 4 else "too_large")
        # the blob's surroundings must be in the window too
        pad = int(math.ceil(0.6 * max(bw, bh))) + 4
        (high, wide), (height, width) = now.shape[:2], image.shape[:2]
        missing = max(
            pad - bx if x0 > 0 else 0,
            pad - (wide - bx - bw) if x0 + wide < width else 0,
            pad - by if y0 > 0 else 0,
            pad - (high - by - bh) if y0 + high < height else 0,
        )
        margin += missing
    sx, sy = max(0, bx - pad) & ~1, max(0, by - pad) & ~1
    part = slice(sy, by + bh + pad), slice(sx, bx + bw + pad)
    mask = (labels[part] == label).view(np.uint8)
    moments = cv2.moments(cv2.copyTo(smooth[part], mask))
    u, v = moments["m10"] / moments["m00"] + x0 + sx, moments["m01"] / moments["m00"] + y0 + sy
    area, elongation = _shape_of(mask)
    diameter = 2.0 * math.sqrt(area / math.pi)
    if diameter > max_diameter:
        return Blob(u, v, diameter, "too_large")
    busy, may_be_ghost = _surroundings_of(u, v, diameter, searched)
    tint, light = _light_of(mask, smooth[part], now[part], before[part], diameter, searched, may_be_ghost)
    return Blob(u, v, diameter, tint=tint, features={"elongation": elongation, **light, "busy": busy})


def _light_of(
    mask: np.ndarray,
    light: np.ndarray,
    now: np.ndarray,
    before: np.ndarray,
    diameter: float,
    searched: SearchedImage,
    may_be_ghost: bool,
) -> Tuple[Optional[np.ndarray], Dict[str, float]]:
    """Returns the tint of a blob's light, and the features that say how it differs from the floor.

    Args:
        mask: (H, W) uint8, the blob.
        light: (H, W) the rise of the brightest channel, smoothed.
        now, before: image and reference.
    """
    mosaic, bright = searched.picture.mosaic, searched.bright
    levels, reference_levels = means_over(mask, mosaic, now, before)
    tint = tint_of(mask, light, now, before, levels, reference_levels) if len(levels) > 1 else None
    channel = int(np.argmax(levels - reference_levels)) if now.ndim == 3 else 0
    return tint, {
        "peak": math.log(max(cv2.minMaxLoc(light, mask)[1], 1.0) / bright),
        "level": math.log(max(cv2.minMaxLoc(max_channel(now), mask)[1], 1.0) / bright),
        # a real spot on the edge of a white sheet could look like a ghost
        "edge": _edge(mask, _plane(now, channel), _plane(before, channel)) if may_be_ghost else math.nan,
        # a light darkens no channel, paint does
        "fall": max(0.0, float((reference_levels - levels).max())) / bright,
        "diameter": math.log(diameter / searched.diagonal),
        # many webcams show a spot as white, mosaics show its colour: only there is a single blob's colour informative
        "chroma_mosaic": min(1.0, chroma(tint) / _ONE_MOSAIC) if mosaic else math.nan,
    }


def _surroundings_of(u: float, v: float, diameter: float, searched: SearchedImage) -> Tuple[float, bool]:
    """Returns how much else changed in the image, apart from a blob and its own light, and whether it may be a ghost.

    A ghost is the trace of an object that moved away. There is none where the camera is stationary, little else changes,
    and nothing passed by recently.
    """
    changed, ghosts, block = searched.changed, searched.ghost_s > 0.0, searched.block_px
    reach = 1.25 * diameter + block
    own, around = (blocks_around(changed.shape, u, v, size, block) for size in (reach, 2.0 * reach))
    busy = math.sqrt((np.count_nonzero(changed) - np.count_nonzero(changed[own])) / changed.size)
    passed = np.count_nonzero(ghosts[around]) > np.count_nonzero(ghosts[own])
    return busy, busy >= _MIN_BUSY or passed or searched.shifted


# ------------------------------------------------------------------ colour
def planes_of(image: np.ndarray, mosaic: bool) -> Sequence[np.ndarray]:
    """Returns the plane of each channel; the four positions in a Bayer pattern count as channels."""
    if not mosaic:
        return cv2.split(image)
    even = image[: image.shape[0] & ~1, : image.shape[1] & ~1]
    return [np.ascontiguousarray(even[row::2, column::2]) for row in (0, 1) for column in (0, 1)]


def means_over(mask: np.ndarray, mosaic: bool, *images: np.ndarray) -> List[np.ndarray]:
    """Returns the mean (C,) of each channel of images over a mask (H, W), which must not be empty."""
    masks = planes_of(mask, mosaic)
    if not all(map(cv2.countNonZero, masks)):
        masks = planes_of(cv2.dilate(mask, _SQUARE), mosaic)  # nine pixels hold all four positions
    return [
        np.array([cv2.mean(plane, over)[0] for plane, over in zip(planes_of(image, mosaic), cycle(masks))], np.float32)
        for image in images
    ]


def tint_of(
    blob: np.ndarray,
    smooth: np.ndarray,
    image: np.ndarray,
    background: np.ndarray,
    level: np.ndarray,
    floor: np.ndarray,
) -> np.ndarray:
    """Returns each channel's share (C,) of a blob's light: 1 for the strongest, 1 for all if the light is white.

    White paper on a brown floor rises most in blue, and still looks white: a laser's light rises most in its own colour
    and has that colour. Where the core is white because every channel is saturated, the light around it must show
    the colour; that counts on a grey floor only, where white things rise evenly.

    Args:
        blob: (H, W) uint8 mask.
        smooth: (H, W) the rise of the brightest channel, smoothed.
        image, background: (H, W, 3) or a Bayer image's (H, W), uint8; its window starts on an even row and column.
        level, floor: their means (C,) over the blob.
    """
    mosaic = image.ndim == 2
    core = _share_of(level - floor)
    looks = 1.0 - level.min() / max(level.max(), 1.0)
    if looks < chroma(core):
        core = 1.0 - (1.0 - core) * looks / chroma(core)
    weakest = cv2.erode(image, _QUAD) if mosaic else np.minimum.reduce(cv2.split(image))
    bright = cv2.compare(smooth, 0.12 * cv2.minMaxLoc(smooth, blob)[1], cv2.CMP_GT)
    halo = cv2.bitwise_and(cv2.dilate(blob, _HALO), cv2.bitwise_and(bright, cv2.compare(weakest, _WHITE, cv2.CMP_LT)))
    if cv2.countNonZero(halo) < 6:
        return core
    level, floor = means_over(halo, mosaic, image, background)
    if floor.min() < _GRAY * floor.max():
        return core
    # in a person's shadow less is left of the floor's light, so that white light would seem to rise unevenly
    beside = cv2.compare(cv2.bitwise_or(bright, blob), 0, cv2.CMP_EQ)
    left = sum(cv2.mean(image, beside)) / max(sum(cv2.mean(background, beside)), 1.0)
    rise = level - min(1.0, left or 1.0) * floor
    rim = _share_of(rise)
    return rim if rise.max() >= 4.0 and chroma(rim) > chroma(core) else core


def _share_of(rise: np.ndarray) -> np.ndarray:
    return np.maximum(rise, 0.0) / max(rise.max(), 1.0)


def chroma(tint: np.ndarray) -> float:
    """Returns how coloured a light is: 0 for white, 1 if a channel shows nothing of it."""
    return float(1.0 - tint.min() / max(tint.max(), 1e-6))


# ------------------------------------------------------------------ shape
def _shape_of(blob: np.ndarray) -> Tuple[float, float]:
    """Returns the area [px], and the logarithm of the ratio of its axes."""
    moments = cv2.moments(blob, binaryImage=True)
    area = moments["m00"]
    # a pixel is a square with its own second moments: without them a single pixel would have no extent
    xx, yy, xy = moments["mu20"] / area + 1 / 12.0, moments["mu02"] / area + 1 / 12.0, moments["mu11"] / area
    half, mean = math.hypot((xx - yy) / 2.0, xy), (xx + yy) / 2.0
    return area, 0.5 * math.log((mean + half) / max(mean - half, 1e-3))


def _edge(mask: np.ndarray, now: np.ndarray, before: np.ndarray) -> float:
    """Returns the gradient along a blob's outline in the image, as a share of that in image and reference together.

    A ghost's outline is in the reference alone.
    """
    rim = cv2.subtract(cv2.dilate(mask, _SQUARE), cv2.erode(mask, _SQUARE))
    slope, slope_before = cv2.mean(_gradient(now), rim)[0], cv2.mean(_gradient(before), rim)[0]
    return slope / max(1e-3, slope + slope_before)


def _plane(image: np.ndarray, channel: int) -> np.ndarray:
    plane = image if image.ndim == 2 else np.ascontiguousarray(image[:, :, channel])
    return cv2.GaussianBlur(plane, (3, 3), 0)


def _gradient(plane: np.ndarray) -> np.ndarray:
    return cv2.magnitude(
        cv2.Sobel(plane, cv2.CV_32F, 1, 0, borderType=cv2.BORDER_REPLICATE),
        cv2.Sobel(plane, cv2.CV_32F, 0, 1, borderType=cv2.BORDER_REPLICATE),
    )


# ------------------------------------------------------------------ judgement
class SpotClassifier:
    """An additive logistic model with a curve for each feature.

    Args:
        curves: feature to (knots, values), both (K,); values in logits.
        intercept: [logits] of a usual spot.
    """

    def __init__(self, curves: Dict[str, Tuple[np.ndarray, np.ndarray]], intercept: float) -> None:
        self.curves, self.intercept = curves, intercept

    def classify(self, blob: Blob, expected: bool) -> Tuple[float, str]:
        """Classifies a blob by its features; one that says nothing (NaN) adds nothing.

        Args:
            expected: whether a tracked spot should be there.

        Returns:
            The probability that it is a spot, 0 ... 1, and the feature that speaks most against it.
        """
        logit, least, reason = self.intercept, math.inf, ""
        for name, value in blob.features.items():
            if name in self.curves and not math.isnan(value):
                part = float(np.interp(value, *self.curves[name]))
                if expected and name in _WAIVED_IF_EXPECTED:
                    part = max(0.0, part)
                logit += part
                if part < least:
                    least, reason = part, name
        return 1.0 / (1.0 + math.exp(-max(-50.0, min(50.0, logit)))), reason


@lru_cache(maxsize=None)
def packaged_classifier() -> SpotClassifier:
    """Returns the package's own classifier, written by bench/detection/training.py; reads it only once."""
    document = json.loads(Path(__file__).with_name("spot_classifier.json").read_text(encoding="utf-8"))
    curves = {name: (np.array(one["knots"]), np.array(one["values"])) for name, one in document["curves"].items()}
    return SpotClassifier(curves, document["intercept"])
