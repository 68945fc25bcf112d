"""Measures features of an image's regions, and decides from them whether each region shows a laser spot.

`measure_blob` cuts a blob out of the rise over the reference, and measures what distinguishes light from other changes:
it is brightest in its middle, ends within some pixels and darkens nothing. An additive logistic model weighs the
features. Each has a curve, linear between knots, whose value is added to the log-odds, and which is 0 for a typical spot.
The feature with the most negative value becomes the reason for a rejection. bench/detection/training.py fits the curves.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, reduce
from itertools import compress
from pathlib import Path
from typing import Dict, List, NamedTuple, Optional, Tuple

import cv2
import numpy as np

from vb_laser_detect.detection.background import blocks_around, match_lighting
from vb_laser_detect.detection.stage_results import BLOCK, Box, Part, SearchedImage, Spot

_EDGE = 0.35  # a blob consists of the pixels whose rise exceeds this share of the peak
_MAX_ELONGATION = 2.0  # largest length of a spot, in multiples of its largest diameter; a fast spot is elongated
# chroma that counts as full in a single mosaic, where a small spot's colour depends on the pixels on which it falls
_ONE_MOSAIC = 0.75
_WHITE = 240.0  # [grey levels] of a pixel's weakest channel, above which the pixel says nothing about colour
_GRAY = 0.85  # share of the strongest channel that the weakest channel of a grey floor has at least
_MIN_BUSY = 0.02  # value of `busy` from which on there may be ghosts
# features that do not count against a spot seen where it was expected. They describe its surroundings, or its colour,
# which it has shown before, and which other light or a mosaic may hide now
_WAIVED_IF_EXPECTED = ("fall", "busy", "chroma_mosaic")
_SQUARE, _QUAD = np.ones((3, 3), np.uint8), np.ones((2, 2), np.uint8)
_HALO = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))


@dataclass(frozen=True)
class Blob:
    """A region of an image that became brighter, in the image's pixels.

    Attributes:
        u, v: [px] centroid, sub-pixel; the centre of the first pixel is 0.
        diameter: [px] of a disc of the same area.
        problem: code of the reason for a rejection by position or size alone, or "".
        features: values by name, NaN for a feature that says nothing; empty if there is a problem.
        light: the blob's light; None if there is a problem.
    """

    u: float
    v: float
    diameter: float
    problem: str = ""
    features: Dict[str, float] = field(default_factory=dict)
    light: Optional[BlobLight] = None


def examine_regions(
    searched: SearchedImage, max_diameters: Dict[Box, float], classifier: SpotClassifier, min_probability: float
) -> List[Spot]:
    """Returns a spot or a rejected candidate for each region of an image, in the regions' order.

    Args:
        max_diameters: [px] a spot's largest diameter in each box of each bright region; NaN where no floor is seen.
        min_probability: least probability of a spot, according to the classifier.
    """
    candidates = []
    for region in searched.regions:
        blob = _unmeasured(region.box, "too_dark")
        # a region may be too large because other light surrounds the expected spot
        for box in region.boxes:
            max_width = math.inf if box is region.box else region.expected.max_width
            blob = measure_blob(searched, box, max_diameters[box], max_width)
            if blob.problem != "too_large":
                break
        probability = 0.0
        rejection = blob.problem
        if not rejection:
            expected = region.expected
            is_expected = expected is not None and math.dist((blob.u, blob.v), expected.position) <= expected.reach
            probability, reason = classifier.classify(blob, is_expected)
            rejection = reason if probability < min_probability else ""
        tint = None if rejection else blob.light.tint
        candidates.append(Spot(blob.u, blob.v, blob.diameter, probability, rejection=rejection, tint=tint))
    return candidates


def _unmeasured(box: Box, problem: str) -> Blob:
    left, top, right, bottom = box
    return Blob((left + right) / 2.0, (top + bottom) / 2.0, float(right - left), problem)


def measure_blob(searched: SearchedImage, box: Box, max_diameter: float, max_width: float) -> Blob:
    """Measures the brightest blob of an image whose peak is in a box; see the blob's `problem`.

    In an image searched at half its size, a blob that is too large for a spot there is not measured at full size.

    Args:
        max_diameter: [px] a spot's largest diameter; NaN if no floor is seen there.
        max_width: [px] width above which light is a change of the room's light, and belongs to the background.
    """
    if math.isnan(max_diameter):
        return _unmeasured(box, "off_floor")
    picture = searched.picture
    scale = picture.scale
    left, top, right, bottom = box
    if scale > 1:
        small_box = left // scale, top // scale, -(-right // scale), -(-bottom // scale)
        small = picture.search_pixels
        cutout = _cut_out(small, searched.reference, 1, small_box, max_diameter / scale, max_width / scale)
        if cutout.problem == "too_large":
            return _unmeasured(box, "too_large")
    if picture.pixels[top:bottom, left:right].max() < searched.min_level:  # the whole picture is decoded only now
        return _unmeasured(box, "too_dark")
    cutout = _cut_out(picture.pixels, searched.reference, scale, box, max_diameter, max_width)
    if cutout.problem:
        return _unmeasured(box, cutout.problem)
    light = BlobLight(*cutout.images, picture.is_bayer)
    moments = cv2.moments(cv2.copyTo(light.rise, light.mask))
    u = moments["m10"] / moments["m00"] + cutout.left
    v = moments["m01"] / moments["m00"] + cutout.top
    features = {"elongation": cutout.elongation, **_features_of(light, u, v, cutout.diameter, searched)}
    return Blob(u, v, cutout.diameter, features=features, light=light)


class _Cutout(NamedTuple):
    """A blob cut out of an image, with its surroundings.

    Attributes:
        problem: as in `Blob`; if it is set, nothing else is.
        left, top: [px] where the images begin, even.
        images: the blob's mask, rise, image and floor, as in `BlobLight`.
        diameter, elongation: the blob's shape.
    """

    problem: str
    left: int = 0
    top: int = 0
    images: Tuple[np.ndarray, ...] = ()
    diameter: float = 0.0
    elongation: float = 0.0


def _cut_out(
    image: np.ndarray, reference: np.ndarray, scale: int, box: Box, max_diameter: float, max_width: float
) -> _Cutout:
    """Cuts the brightest blob whose peak is in a box out of an image, which is larger than the reference by `scale`."""
    left, top, right, bottom = box
    height, width = image.shape[:2]
    margin = 20
    missing = 1
    while missing > 0:
        # even bounds keep each pixel's position in the Bayer pattern
        x0 = max(0, left - margin) & ~1
        y0 = max(0, top - margin) & ~1
        window = slice(y0, min(bottom + margin, height)), slice(x0, min(right + margin, width))
        now = image[window]
        floor = _enlarged_part(reference, window, scale)
        if max_width < math.inf:
            floor = cv2.max(floor, match_lighting(floor, now, max_width))
        # the kernel [1 2 1] averages out noise and a Bayer image's mosaic
        rise = reduce(cv2.max, cv2.split(cv2.subtract(now, floor)))
        smooth = cv2.GaussianBlur(rise, (3, 3), 0, borderType=cv2.BORDER_REFLECT_101)
        _, peak, _, peak_pixel = cv2.minMaxLoc(smooth[top - y0 : bottom - y0, left - x0 : right - x0])
        is_blob = (smooth > _EDGE * peak).astype(np.uint8)
        _, labels, stats, _ = cv2.connectedComponentsWithStats(is_blob, connectivity=8)
        label = labels[peak_pixel[1] + top - y0, peak_pixel[0] + left - x0]
        bx, by, bw, bh, _ = stats[label].tolist()
        if peak < 4 or max(bw, bh) > _MAX_ELONGATION * max_diameter:
            return _Cutout("too_faint" if peak < 4 else "too_large")
        # the window must include the blob's surroundings
        pad = int(math.ceil(0.6 * max(bw, bh))) + 4
        window_height, window_width = now.shape[:2]
        spaces = bx, by, window_width - bx - bw, window_height - by - bh
        can_grow = x0 > 0, y0 > 0, x0 + window_width < width, y0 + window_height < height
        missing = pad - min(compress(spaces, can_grow), default=pad)
        margin += missing
    sx = max(0, bx - pad) & ~1
    sy = max(0, by - pad) & ~1
    part = slice(sy, by + bh + pad), slice(sx, bx + bw + pad)
    mask = (labels[part] == label).view(np.uint8)
    area, elongation = _shape_of(mask)
    diameter = 2.0 * math.sqrt(area / math.pi)
    if diameter > max_diameter:
        return _Cutout("too_large")
    images = mask, smooth[part], now[part], floor[part]
    return _Cutout("", x0 + sx, y0 + sy, images, diameter, elongation)


def _enlarged_part(image: np.ndarray, part: Part, scale: int) -> np.ndarray:
    """Returns a part of an image enlarged by `scale`; the part begins at even pixels."""
    if scale == 1:
        return image[part]
    rows, columns = part
    small_rows = slice(rows.start // scale, -(-rows.stop // scale))
    small_columns = slice(columns.start // scale, -(-columns.stop // scale))
    enlarged = cv2.resize(image[small_rows, small_columns], None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR)
    return enlarged[: rows.stop - rows.start, : columns.stop - columns.start]


def _features_of(light: BlobLight, u: float, v: float, diameter: float, searched: SearchedImage) -> Dict[str, float]:
    """Computes the features that say how a blob's light differs from the floor and from other changes."""
    busy, may_be_ghost = _surroundings_of(u, v, diameter, searched)
    return {
        "peak": math.log(max(cv2.minMaxLoc(light.rise, light.mask)[1], 1.0) / searched.bright_level),
        "level": math.log(max(float(light.now[light.mask > 0].max()), 1.0) / searched.bright_level),
        # a real spot on the edge of a white sheet could look like a ghost
        "edge": light.edge() if may_be_ghost else math.nan,
        # a light darkens no channel, paint does
        "fall": max(0.0, float((light.floor_levels - light.levels).max())) / searched.bright_level,
        "diameter": math.log(diameter / searched.diagonal),
        # many webcams show a spot as white, mosaics show its colour: only there is a single blob's colour informative
        "chroma_mosaic": min(1.0, chroma(light.tint) / _ONE_MOSAIC) if searched.picture.is_bayer else math.nan,
        "busy": busy,
    }


def _surroundings_of(u: float, v: float, diameter: float, searched: SearchedImage) -> Tuple[float, bool]:
    """Returns how much of the image changed apart from a blob's own light, and whether the blob may be a ghost.

    A ghost is the trace of an object that moved away. There is none if the camera is stationary, little else changes,
    and nothing passed the blob recently.
    """
    changed = searched.changed
    ghosts = searched.ghost_s > 0.0
    scale = searched.picture.scale
    reach = 1.25 * diameter + BLOCK * scale
    own_blocks = blocks_around(changed.shape, u, v, reach, scale)
    blocks_nearby = blocks_around(changed.shape, u, v, 2.0 * reach, scale)
    changed_elsewhere = np.count_nonzero(changed) - np.count_nonzero(changed[own_blocks])
    busy = math.sqrt(changed_elsewhere / changed.size)
    passed = np.count_nonzero(ghosts[blocks_nearby]) > np.count_nonzero(ghosts[own_blocks])
    return busy, busy >= _MIN_BUSY or passed or searched.shifted


# ------------------------------------------------------------------ light
class BlobLight:
    """The light of a blob: a part of an image that starts on an even row and column, and the same part of the floor.

    Args:
        mask: (H, W) uint8, the blob.
        rise: (H, W) uint8, rise of the brightest channel above the floor, smoothed.
        now, before: (H, W, 3) or (H, W) uint8, image and floor.
        mosaic: whether they are Bayer images.

    Attributes:
        levels, floor_levels: (C,) means of image and floor over the blob.
    """

    def __init__(self, mask: np.ndarray, rise: np.ndarray, now: np.ndarray, before: np.ndarray, mosaic: bool) -> None:
        self.mask, self.rise = mask, rise
        self.now, self._before = now, before
        self._mosaic = mosaic
        self.levels, self.floor_levels = means_over(mask, mosaic, now, before)

    def edge(self) -> float:
        """Returns the gradient along the blob's outline in the image, as a share of that in image and floor together.

        A ghost's outline is in the floor alone.
        """
        channel = int(np.argmax(self.levels - self.floor_levels)) if self.now.ndim == 3 else 0
        rim = cv2.subtract(cv2.dilate(self.mask, _SQUARE), cv2.erode(self.mask, _SQUARE))
        slope, slope_before = (cv2.mean(_gradient(image, channel), rim)[0] for image in (self.now, self._before))
        return slope / max(1e-3, slope + slope_before)

    @cached_property
    def tint(self) -> Optional[np.ndarray]:
        """Each channel's share (C,) of the light: 1 for the strongest, or for all if it is white. None in grey images.

        Where the core is white because every channel is saturated, the light around it shows the colour.
        """
        if len(self.levels) == 1:
            return None
        core = self._core_tint()
        rise = self._halo_rise()
        if rise is None or rise.max() < 4.0:
            return core
        halo = _share_of(rise)
        return halo if chroma(halo) > chroma(core) else core

    def _core_tint(self) -> np.ndarray:
        """Returns each channel's share (C,) of the blob's rise over the floor, no more coloured than the image looks.

        White paper on a brown floor rises most in blue, and still looks white.
        """
        share = _share_of(self.levels - self.floor_levels)
        most = chroma(self.levels)
        if most >= chroma(share):
            return share
        return 1.0 - (1.0 - share) * most / chroma(share)

    def _halo_rise(self) -> Optional[np.ndarray]:
        """Returns how much the unsaturated light in and around the blob rises over the floor in each channel (C,).

        It is None without such light, or on a coloured floor, over which white things rise unevenly.
        """
        weakest = cv2.erode(self.now, _QUAD) if self._mosaic else reduce(cv2.min, cv2.split(self.now))
        bright = cv2.compare(self.rise, 0.12 * cv2.minMaxLoc(self.rise, self.mask)[1], cv2.CMP_GT)
        halo = cv2.bitwise_and(bright, cv2.compare(weakest, _WHITE, cv2.CMP_LT))
        halo = cv2.bitwise_and(cv2.dilate(self.mask, _HALO), halo)
        if cv2.countNonZero(halo) < 6:
            return None
        levels, floor_levels = means_over(halo, self._mosaic, self.now, self._before)
        if floor_levels.min() < _GRAY * floor_levels.max():
            return None
        # in a person's shadow the floor is darker, so that white light would seem to rise unevenly
        surroundings = cv2.compare(cv2.bitwise_or(bright, self.mask), 0, cv2.CMP_EQ)
        light_before = sum(cv2.mean(self._before, surroundings))
        brightness_ratio = sum(cv2.mean(self.now, surroundings)) / max(light_before, 1.0)
        return levels - min(1.0, brightness_ratio or 1.0) * floor_levels


def means_over(mask: np.ndarray, mosaic: bool, *images: np.ndarray) -> List[np.ndarray]:
    """Returns the mean (C,) of each channel of images over a mask (H, W), which must not be empty.

    The four positions in a Bayer pattern count as channels.
    """
    if not mosaic:
        count = 3 if images[0].ndim == 3 else 1
        return [np.array(cv2.mean(image, mask)[:count], np.float32) for image in images]
    masks = _positions_of(mask)
    if not all(map(cv2.countNonZero, masks)):
        masks = _positions_of(cv2.dilate(mask, _SQUARE))  # nine pixels hold all four positions
    planes = (zip(_positions_of(image), masks) for image in images)
    return [np.array([cv2.mean(plane, mask)[0] for plane, mask in pairs], np.float32) for pairs in planes]


def _positions_of(image: np.ndarray) -> List[np.ndarray]:
    """Returns the pixels at each of the four positions in a Bayer pattern."""
    even = image[: image.shape[0] & ~1, : image.shape[1] & ~1]
    return [np.ascontiguousarray(even[row::2, column::2]) for row in (0, 1) for column in (0, 1)]


def _share_of(rise: np.ndarray) -> np.ndarray:
    return np.maximum(rise, 0.0) / max(rise.max(), 1.0)


def chroma(tint: np.ndarray) -> float:
    """Returns how coloured light is: 0 for white, 1 if a channel shows none of it."""
    return float(1.0 - tint.min() / max(tint.max(), 1e-6))


# ------------------------------------------------------------------ shape
def _shape_of(blob: np.ndarray) -> Tuple[float, float]:
    """Returns a blob's area [px], and the logarithm of the ratio of its axes."""
    moments = cv2.moments(blob, binaryImage=True)
    area = moments["m00"]
    # a pixel is a square with its own second moments: without them a single pixel would have no extent
    xx = moments["mu20"] / area + 1 / 12.0
    yy = moments["mu02"] / area + 1 / 12.0
    half = math.hypot((xx - yy) / 2.0, moments["mu11"] / area)
    mean = (xx + yy) / 2.0
    return area, 0.5 * math.log((mean + half) / max(mean - half, 1e-3))


def _gradient(image: np.ndarray, channel: int) -> np.ndarray:
    """Returns the size of a smoothed channel's gradient at each pixel (H, W)."""
    plane = image if image.ndim == 2 else cv2.extractChannel(image, channel)
    smooth = cv2.GaussianBlur(plane, (3, 3), 0)
    slopes = (cv2.Sobel(smooth, cv2.CV_32F, x, 1 - x, borderType=cv2.BORDER_REPLICATE) for x in (1, 0))
    return cv2.magnitude(*slopes)


# ------------------------------------------------------------------ judgement
@dataclass(frozen=True, eq=False)
class SpotClassifier:
    """An additive logistic model with a curve for each feature."""

    curves: Dict[str, Tuple[np.ndarray, np.ndarray]]  # knots and values [logits], both (K,), by feature
    intercept: float  # [logits] log-odds of a typical spot

    def classify(self, blob: Blob, expected: bool) -> Tuple[float, str]:
        """Returns the probability that a blob is a spot, 0 ... 1, and the feature that speaks most against it.

        A feature that says nothing (NaN) adds nothing. `expected`: whether a tracked spot should be there.
        """
        logit = self.intercept
        smallest_part, reason = math.inf, ""
        for name, curve in self.curves.items():
            value = blob.features[name]
            if not math.isnan(value):
                part = float(np.interp(value, *curve))
                if expected and name in _WAIVED_IF_EXPECTED:
                    part = max(0.0, part)
                logit += part
                if part < smallest_part:
                    smallest_part, reason = part, name
        return 1.0 / (1.0 + math.exp(-max(-50.0, min(50.0, logit)))), reason


@lru_cache(maxsize=None)
def packaged_classifier() -> SpotClassifier:
    """Returns the packaged classifier, which bench/detection/training.py wrote. It is read only once."""
    document = json.loads(Path(__file__).with_name("spot_classifier.json").read_text(encoding="utf-8"))
    entries = document["curves"].items()
    curves = {name: (np.array(entry["knots"]), np.array(entry["values"])) for name, entry in entries}
    return SpotClassifier(curves, document["intercept"])
