"""What a candidate looks like at full resolution."""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Sequence, Tuple

import cv2
import numpy as np

from vb_laser_detect.blocks import max_channel

_EDGE = 0.35  # the spot is where the rise exceeds this part of its peak
_WHITE = 240.0  # [grey levels] a pixel whose weakest channel shows more tells nothing about colour
_GREY = 0.85  # a floor is grey if its weakest channel has so much of the strongest
_SQUARE = np.ones((3, 3), np.uint8)

Region = Tuple[int, int, int, int]  # left, top, right, bottom [px]; right and bottom are excluded


@dataclass
class Candidate:
    """A place that became brighter, or in a moving camera's image one brighter than its surroundings.

    Attributes:
        u, v: [px] centroid, sub-pixel; the centre of the first pixel is 0.
        diameter: [px] of a disc of the same area.
        peak: [grey levels] the largest rise, smoothed.
        level: [grey levels] the brightest pixel itself.
        elongation: longest over shortest axis.
        compactness: area over that of the ellipse with the same second moments; 1 for discs and ellipses.
        surround: rise just outside the blob, as a part of the peak; near 0 for a spot.
        contrast: by how much it stands out of those surroundings that looked the same before, as a part of the
            rise; near 1 for a light, near 0 where an object has left, more than 1 beside something dark that came.
        likeness: part of the surroundings that looked as the blob's place did before.
        edge: the outline's gradient in the image, over that in image and background together; small for a ghost,
            whose outline is in the background alone.
        darker: part of the surroundings that became darker; near 0 for a light, more where something moves in.
        flatness: part of the blob that is nearly as bright as its peak.
        fall: [grey levels] by how much the channel that lost most became darker; a light darkens none, paint does.
        chroma: how coloured its light is; near 0 for white light and white things, 0 in images without colour.
        busy: part of the whole image that changed elsewhere.
        neighbours: blocks near it that became brighter, beyond those that its own light reaches.
        confidence: 0 ... 1.
        refusal: why it is no spot, or "".
    """

    u: float
    v: float
    diameter: float
    peak: float = 0.0
    level: float = 255.0
    elongation: float = 1.0
    compactness: float = 1.0
    surround: float = 0.0
    contrast: float = 1.0
    likeness: float = 1.0
    edge: float = 1.0
    darker: float = 0.0
    flatness: float = 0.0
    fall: float = 0.0
    chroma: float = 0.0
    busy: float = 0.0
    neighbours: int = 0
    confidence: float = 0.0
    refusal: str = ""


def measure(
    image: np.ndarray, background: np.ndarray, seed: Region, largest: float, learnt: bool = True
) -> Candidate:
    """Measures the brightest blob of a region.

    Args:
        image: (H, W) or (H, W, C) uint8.
        background: the same shape; what the place looks like without a spot.
        seed: region that holds the peak.
        largest: [px] largest extent looked for.
        learnt: whether the background was seen before; a guessed one says nothing about what was there.

    Returns:
        The candidate; its refusal is "too_large" or "too_faint" if no blob was measured.
    """
    height, width = image.shape[:2]
    left, top, right, bottom = seed
    middle = Candidate((left + right) / 2.0, (top + bottom) / 2.0, float(max(right - left, bottom - top)))
    margin = 12
    while True:
        x0, y0 = max(0, left - margin), max(0, top - margin)
        x1, y1 = min(width, right + margin), min(height, bottom + margin)
        # [1 2 1]: noise, and a Bayer image's mosaic, cancel out in it
        rise = cv2.subtract(image[y0:y1, x0:x1], background[y0:y1, x0:x1])
        smooth = cv2.GaussianBlur(max_channel(rise), (3, 3), 0, borderType=cv2.BORDER_REFLECT_101)
        _, peak, _, at = cv2.minMaxLoc(smooth[top - y0 : bottom - y0, left - x0 : right - x0])
        if peak < 4:
            middle.refusal = "too_faint"
            return middle
        _, labels, stats, _ = cv2.connectedComponentsWithStats((smooth > _EDGE * peak).astype(np.uint8), connectivity=8)
        label = labels[at[1] + top - y0, at[0] + left - x0]
        bx, by, bw, bh, _ = (int(value) for value in stats[label])
        if max(bw, bh) > largest:
            middle.refusal = "too_large"
            return middle
        # what surrounds the blob must lie in the window too
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
    sx0, sy0 = max(0, bx - pad), max(0, by - pad)
    sx1, sy1 = min(x1 - x0, bx + bw + pad), min(y1 - y0, by + bh + pad)
    part, whole = (slice(sy0, sy1), slice(sx0, sx1)), (slice(y0 + sy0, y0 + sy1), slice(x0 + sx0, x0 + sx1))
    candidate = _describe(
        labels[part] == label,
        smooth[part].astype(np.float32),
        image[whole],
        rise[part],
        background[whole],
        learnt,
    )
    candidate.u += x0 + sx0
    candidate.v += y0 + sy0
    return candidate


def _describe(
    blob: np.ndarray, smooth: np.ndarray, image: np.ndarray, rise: np.ndarray, background: np.ndarray, learnt: bool
) -> Candidate:
    rows, columns = np.nonzero(blob)
    weights = smooth[blob]
    total, peak = float(weights.sum()), float(weights.max())
    u, v = float((weights * columns).sum()) / total, float((weights * rows).sum()) / total
    area = len(rows)
    long, short = _axes(columns, rows)
    candidate = Candidate(
        u=u,
        v=v,
        diameter=2.0 * math.sqrt(area / math.pi),
        peak=peak,
        level=float(max_channel(image)[blob].max()),
        elongation=long / short,
        compactness=area / (4.0 * math.pi * long * short),
        flatness=float((weights > 0.8 * peak).mean()),
    )
    ring = _ring(blob, candidate.diameter)
    candidate.surround = float(smooth[ring].mean()) / peak if ring.any() else 1.0
    channels = [rise] if rise.ndim == 2 else cv2.split(rise)
    rises = [float(channel[blob].mean()) for channel in channels]
    best = int(np.argmax(rises))
    rose = max(rises[best], 1.0)
    if len(channels) > 1:
        levels, floors = cv2.split(image), cv2.split(background)
        candidate.fall = max(float(floor[blob].mean()) - float(level[blob].mean()) for floor, level in zip(floors, levels))
        candidate.chroma = _chroma(blob, smooth, levels, floors)
    now = _plane(image, best)
    inside = float(now[blob].mean())
    like = ring
    if learnt:
        before = _plane(background, best)
        # a light falls on a floor that goes on beside it; where an object has left, the background still shows
        # the object, and nothing beside it looks the same
        tolerance = max(12.0, 0.25 * rose)
        like = ring & (np.abs(before - np.median(before[blob])) < tolerance)
        candidate.darker = float(((before - now)[ring] > tolerance).mean()) if ring.any() else 0.0
        mask = blob.astype(np.uint8)
        rim = (cv2.dilate(mask, _SQUARE) - cv2.erode(mask, _SQUARE)) > 0
        slope, slope_before = float(_gradient(now)[rim].mean()), float(_gradient(before)[rim].mean())
        candidate.edge = slope / max(1e-3, slope + slope_before)
        candidate.likeness = float(like.sum()) / max(1, int(ring.sum()))
    candidate.contrast = (inside - float(now[like].mean())) / rose if like.any() else 0.0
    return candidate


def _chroma(blob: np.ndarray, smooth: np.ndarray, levels: Sequence[np.ndarray], floors: Sequence[np.ndarray]) -> float:
    """How coloured the light is.

    White paper on a brown floor rises most in blue, and still looks white: a laser's light rises most in its own colour
    and has that colour. Where the core is white, since it saturates every channel, the light round it has to show the
    colour; that counts on a grey floor only, where white things rise evenly.
    """
    rise, level, _ = _color_over(blob, levels, floors)
    best = int(np.argmax(rise))
    core = min((rise[best] - min(rise)) / max(rise[best], 1.0), (level[best] - min(level)) / max(level[best], 1.0))
    weakest = np.minimum.reduce(levels)
    halo = (cv2.dilate(blob.astype(np.uint8), _disc(2)) > 0) & (weakest < _WHITE) & (smooth > 0.12 * smooth[blob].max())
    if np.count_nonzero(halo) < 6:
        return core
    rise, level, floor = _color_over(halo, levels, floors)
    if min(floor) < _GREY * max(floor):
        return core
    return max(core, (max(rise) - min(rise)) / max(max(rise), 1.0) if max(rise) > 4.0 else 0.0)


def _color_over(mask: np.ndarray, levels: Sequence[np.ndarray], floors: Sequence[np.ndarray]) -> Tuple[List[float], ...]:
    """Mean rise, level and floor of each channel."""
    level = [float(channel[mask].mean()) for channel in levels]
    floor = [float(channel[mask].mean()) for channel in floors]
    return [max(0.0, a - b) for a, b in zip(level, floor)], level, floor


def _axes(columns: np.ndarray, rows: np.ndarray) -> Tuple[float, float]:
    # a pixel is a square with second moments of its own: without them a single pixel would have no extent
    xx, yy = float(columns.var()) + 1 / 12.0, float(rows.var()) + 1 / 12.0
    xy = float(((columns - columns.mean()) * (rows - rows.mean())).mean())
    half, mean = math.hypot((xx - yy) / 2.0, xy), (xx + yy) / 2.0
    return math.sqrt(mean + half), math.sqrt(max(mean - half, 1e-3))


def _ring(blob: np.ndarray, diameter: float) -> np.ndarray:
    gap, thick = max(2, int(round(0.2 * diameter))), max(2, int(round(0.35 * diameter)))
    inner = cv2.dilate(blob.astype(np.uint8), _disc(gap))
    return (cv2.dilate(inner, _disc(thick)) > 0) & (inner == 0)


def _disc(radius: int) -> np.ndarray:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))


def _plane(image: np.ndarray, channel: int) -> np.ndarray:
    plane = image if image.ndim == 2 else np.ascontiguousarray(image[:, :, channel])
    return cv2.GaussianBlur(plane, (3, 3), 0).astype(np.float32)


def _gradient(plane: np.ndarray) -> np.ndarray:
    return cv2.magnitude(
        cv2.Sobel(plane, cv2.CV_32F, 1, 0, borderType=cv2.BORDER_REPLICATE),
        cv2.Sobel(plane, cv2.CV_32F, 0, 1, borderType=cv2.BORDER_REPLICATE),
    )
