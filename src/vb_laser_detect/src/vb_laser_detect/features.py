"""What a proposal looks like at full resolution, in numbers that a classifier can weigh.

One pure function: `measure` cuts a blob out of the rise over the reference and describes it. Light falls on a floor that
goes on beside it, is brightest in its middle, ends within some pixels and darkens nothing; each number tells one of these.
"""
from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Dict, NamedTuple, Optional, Tuple

import cv2
import numpy as np

from vb_laser_detect import colour
from vb_laser_detect.blocks import Region, max_channel

EDGE = 0.35  # the blob is where the rise exceeds this part of its peak; ...
CORE, CORE_OF_MORE = 0.6, 0.75  # ... its core, where it touches a bright line, or more that became brighter with it
_SHADOW = 0.5  # part of the light that a shadow leaves at least
_SATURATED = 0.97  # of the camera's white: from here on the sensor shows no more
_SQUARE = np.ones((3, 3), np.uint8)


@dataclass(frozen=True)
class Blob:
    """A place that became brighter, in the image's pixels.

    Attributes:
        u, v: [px] centroid, sub-pixel; the centre of the first pixel is 0.
        diameter: [px] of a disc of the same area.
        peak: [grey levels] the largest rise, smoothed.
        rise: [grey levels] the largest rise of a pixel: of a spot hardly larger than one, smoothing leaves less than half.
        level: [grey levels] the brightest pixel itself.
        elongation: longest over shortest axis.
        compactness: area over that of the ellipse with the same second moments; 1 for discs and ellipses.
        flatness: part of the blob that is nearly as bright as its peak.
        surround: rise just outside the blob, as a part of the peak; near 0 for a spot.
        contrast: by how much it exceeds those surroundings that looked the same before, as a part of the rise; near 1
            for a light, near 0 where an object has left, more than 1 beside something dark that came.
        likeness: part of the surroundings that looked as the blob's place did before.
        edge: the outline's gradient in the image, over that in image and reference together; small for a ghost, whose
            outline is in the reference alone.
        darker: part of the surroundings that became darker than in a shadow; more than 0 where something moves in.
        fall: [grey levels] by how much the channel that lost most became darker; a light darkens none, paint does.
        tint: (C,) each channel's part in its light, see `colour.tint_of`; meaningless for grey images.
        cut_off: the image ends there: only part of it may be visible.
        problem: "too_large", "too_faint" or "not_coloured" if only the place was measured.
    """

    u: float
    v: float
    diameter: float
    peak: float = 0.0
    rise: float = 0.0
    level: float = 0.0
    elongation: float = 1.0
    compactness: float = 1.0
    flatness: float = 0.0
    surround: float = 0.0
    contrast: float = 1.0
    likeness: float = 1.0
    edge: float = 1.0
    darker: float = 0.0
    fall: float = 0.0
    tint: Optional[np.ndarray] = None
    cut_off: bool = False
    problem: str = ""


class Surroundings(NamedTuple):
    """What else is known of the image: parts of its blocks that changed elsewhere, blocks nearby that rose."""

    busy: float
    neighbours: int


class Camera(NamedTuple):
    """What is known of the camera: the brightest value that it shows, its images' diagonal [px], a Bayer mosaic or not.

    `moved`: the reference was warped to where the camera is now; an edge may be off by a part of a pixel.
    """

    white: float
    diagonal: float
    mosaic: bool
    moved: bool


def vector(blob: Blob, around: Surroundings, camera: Camera) -> Dict[str, float]:
    """The features of a blob by name; NaN where one says nothing. Grey levels count as parts of the camera's white."""
    white, none = camera.white, math.nan
    saturated = blob.level >= _SATURATED * white
    # three channels, or the four places of a mosaic; a grey image has neither
    coloured = blob.tint is not None and (camera.mosaic or len(blob.tint) == 3)
    chroma = colour.chroma(blob.tint) if coloured else none
    # the longer an outline, the less noise and a table's edge under the spot affect it
    large = float(np.interp(blob.diameter, (24.0, 48.0), (0.0, 1.0)))
    return {
        "peak": math.log(max(blob.peak, 1.0) / white),
        "rise": none if saturated else math.log(max(blob.rise, 1.0) / white),
        "level": blob.level / white,
        "elongation": math.log(blob.elongation),
        "compactness": blob.compactness,
        "flatness": none if saturated else blob.flatness,
        "surround": blob.surround,
        "contrast": blob.contrast,
        "likeness": blob.likeness,
        "edge": blob.edge - 0.14 * large,
        "darker": blob.darker,
        "fall": blob.fall / white,
        "diameter": math.log(blob.diameter / camera.diagonal),
        "smallness": min(blob.diameter, 6.0),
        "busy": math.sqrt(around.busy),
        "neighbours": math.sqrt(max(0, around.neighbours)),
        "cut_off": float(blob.cut_off),
        "chroma": none if camera.mosaic else chroma,
        "chroma_mosaic": chroma if camera.mosaic else none,
        "edge_moved": blob.edge if camera.moved else none,
        "contrast_moved": blob.contrast if camera.moved else none,
    }


def measure(
    image: np.ndarray,
    background: np.ndarray,
    seed: Region,
    largest: float,
    edge: float = EDGE,
    least_chroma: Optional[float] = 0.0,
) -> Blob:
    """Measures the brightest blob of a region.

    Args:
        image: (H, W) or (H, W, C) uint8.
        background: the same shape; what the place looks like without a spot. A Bayer image's starts on an even row and
            column.
        seed: region that holds the peak.
        largest: [px] largest extent looked for.
        edge: the part of the peak that the rise exceeds in the blob.
        least_chroma: less coloured blobs are not described: most of what rises is white or grey, and describing
            it is most of the work. None: colour is not checked.

    Returns:
        The blob; see its `problem`.
    """
    height, width = image.shape[:2]
    left, top, right, bottom = seed
    middle = Blob((left + right) / 2.0, (top + bottom) / 2.0, float(max(right - left, bottom - top)))
    margin = 12
    while True:
        # even bounds keep each pixel's place in a Bayer image's pattern
        x0, y0 = max(0, left - margin) & ~1, max(0, top - margin) & ~1
        x1, y1 = min(width, right + margin), min(height, bottom + margin)
        # [1 2 1]: noise, and a Bayer image's mosaic, cancel out in it
        rise = cv2.subtract(image[y0:y1, x0:x1], background[y0:y1, x0:x1])
        smooth = cv2.GaussianBlur(max_channel(rise), (3, 3), 0, borderType=cv2.BORDER_REFLECT_101)
        _, peak, _, at = cv2.minMaxLoc(smooth[top - y0 : bottom - y0, left - x0 : right - x0])
        if peak < 4:
            return replace(middle, problem="too_faint")
        _, labels, stats, _ = cv2.connectedComponentsWithStats((smooth > edge * peak).astype(np.uint8), connectivity=8)
        label = labels[at[1] + top - y0, at[0] + left - x0]
        bx, by, bw, bh, _ = (int(value) for value in stats[label])
        if max(bw, bh) > largest:
            return replace(middle, problem="too_large")
        # the blob's surroundings must be in the window too
        pad = int(math.ceil(0.6 * max(bw, bh))) + 4
        missing = max(
            pad - bx if x0 > 0 else 0,
            pad - by if y0 > 0 else 0,
            pad - (x1 - x0 - bx - bw) if x1 < width else 0,
            pad - (y1 - y0 - by - bh) if y1 < height else 0,
        )
        if missing <= 0:
            break
        margin += missing
    sx0, sy0 = max(0, bx - pad) & ~1, max(0, by - pad) & ~1
    sx1, sy1 = min(x1 - x0, bx + bw + pad), min(y1 - y0, by + bh + pad)
    part, whole = (slice(sy0, sy1), slice(sx0, sx1)), (slice(y0 + sy0, y0 + sy1), slice(x0 + sx0, x0 + sx1))
    mask, light = (labels[part] == label).view(np.uint8), smooth[part].astype(np.float32)
    tint = None if least_chroma is None else colour.tint_of(mask, light, image[whole], background[whole])
    if least_chroma and colour.chroma(tint) < least_chroma:
        return replace(middle, u=x0 + bx + bw / 2.0, v=y0 + by + bh / 2.0, diameter=float(max(bw, bh)), problem="not_coloured")
    cut_off = x0 + bx == 0 or y0 + by == 0 or x0 + bx + bw == width or y0 + by + bh == height
    return _describe(mask, light, image[whole], rise[part], background[whole], (x0 + sx0, y0 + sy0), tint, cut_off)


def _describe(
    blob: np.ndarray, smooth: np.ndarray, image: np.ndarray, rise: np.ndarray, background: np.ndarray,
    corner: Tuple[int, int], tint: Optional[np.ndarray], cut_off: bool,
) -> Blob:
    # cv2 with masks, not numpy with indices: on patches this small the calls take the time
    peak = float(cv2.minMaxLoc(smooth, blob)[1])
    light = cv2.moments(cv2.copyTo(smooth, blob))
    area, long, short = _axes(blob)
    diameter = 2.0 * math.sqrt(area / math.pi)
    ring = _ring(blob, diameter)
    around = cv2.countNonZero(ring)
    rises = cv2.mean(rise, blob)[: 1 if rise.ndim == 2 else 3]
    best = int(np.argmax(rises))
    rose = max(rises[best], 1.0)
    _, level, floor = colour.means_over(blob, image, background)
    now, before = _plane(image, best), _plane(background, best)
    # a light falls on a floor that goes on beside it; where an object has left, the background still shows the object,
    # and nothing beside it looks the same
    off = cv2.absdiff(before, colour.middle_of(before[blob > 0]))
    like = cv2.bitwise_and(ring, cv2.compare(off, max(12.0, 0.25 * rose), cv2.CMP_LT))
    alike = cv2.countNonZero(like)
    # a shadow that passes over a spot leaves about half of the light; what hides the floor is an object
    hidden = cv2.compare(now, cv2.addWeighted(before, _SHADOW, before, 0.0, -4.0), cv2.CMP_LT)
    rim = cv2.subtract(cv2.dilate(blob, _SQUARE), cv2.erode(blob, _SQUARE))
    slope, slope_before = cv2.mean(_gradient(now), rim)[0], cv2.mean(_gradient(before), rim)[0]
    return Blob(
        u=light["m10"] / light["m00"] + corner[0],
        v=light["m01"] / light["m00"] + corner[1],
        diameter=diameter,
        peak=peak,
        rise=float(cv2.minMaxLoc(max_channel(rise), blob)[1]),
        level=float(cv2.minMaxLoc(max_channel(image), blob)[1]),
        elongation=long / short,
        compactness=area / (4.0 * math.pi * long * short),
        flatness=cv2.countNonZero(cv2.bitwise_and(cv2.compare(smooth, 0.8 * peak, cv2.CMP_GT), blob)) / area,
        surround=cv2.mean(smooth, ring)[0] / peak if around else 1.0,
        contrast=(cv2.mean(now, blob)[0] - cv2.mean(now, like)[0]) / rose if alike else 0.0,
        likeness=alike / around if around else 1.0,
        edge=slope / max(1e-3, slope + slope_before),
        darker=cv2.countNonZero(cv2.bitwise_and(hidden, ring)) / around if around else 0.0,
        fall=max(0.0, float((floor - level).max())),
        tint=tint,
        cut_off=cut_off,
    )


def _axes(blob: np.ndarray) -> Tuple[float, float, float]:
    """Area [px] and the two axes, as standard deviations [px]."""
    moments = cv2.moments(blob, binaryImage=True)
    area = moments["m00"]
    # a pixel is a square with its own second moments: without them a single pixel would have no extent
    xx, yy, xy = moments["mu20"] / area + 1 / 12.0, moments["mu02"] / area + 1 / 12.0, moments["mu11"] / area
    half, mean = math.hypot((xx - yy) / 2.0, xy), (xx + yy) / 2.0
    return area, math.sqrt(mean + half), math.sqrt(max(mean - half, 1e-3))


def _ring(blob: np.ndarray, diameter: float) -> np.ndarray:
    gap, thick = max(2, int(round(0.2 * diameter))), max(2, int(round(0.35 * diameter)))
    # dilating with a disc would cost its area for each pixel, a hundred times more for a person's clothes
    away = cv2.distanceTransform(cv2.compare(blob, 0, cv2.CMP_EQ), cv2.DIST_L2, cv2.DIST_MASK_5)
    return cv2.inRange(away, gap + 0.5, gap + thick + 0.5)


def _plane(image: np.ndarray, channel: int) -> np.ndarray:
    plane = image if image.ndim == 2 else np.ascontiguousarray(image[:, :, channel])
    return cv2.GaussianBlur(plane, (3, 3), 0).astype(np.float32)


def _gradient(plane: np.ndarray) -> np.ndarray:
    return cv2.magnitude(
        cv2.Sobel(plane, cv2.CV_32F, 1, 0, borderType=cv2.BORDER_REPLICATE),
        cv2.Sobel(plane, cv2.CV_32F, 0, 1, borderType=cv2.BORDER_REPLICATE),
    )
