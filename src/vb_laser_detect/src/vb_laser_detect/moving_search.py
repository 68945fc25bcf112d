"""Looks for spots in the images of a camera that moves: places that are brighter than their neighbourhood."""
from __future__ import annotations

from typing import List, Optional, Tuple

import cv2
import numpy as np

from vb_laser_detect import appearance, colour
from vb_laser_detect.appearance import Candidate, Region
from vb_laser_detect.blocks import block_maxima, max_channel
from vb_laser_detect.followed import FollowedSpot
from vb_laser_detect.judgement import Judge
from vb_laser_detect.regions import regions

LARGE = 14  # [blocks] regions that are larger are cut down to their brightest parts
_WIDEST_MEDIAN = 255  # [px] of 8-bit images, OpenCV's limit


def search_moving(
    image: np.ndarray, judge: Judge, followed: FollowedSpot, within: Optional[Tuple[slice, slice]] = None
) -> List[Candidate]:
    """The candidates of an image without a background, in all blocks or some (rows, columns).

    The median filter of each place's surroundings stands for the floor.
    """
    p = judge.params
    maxima = block_maxima(image)
    # what a block would show without a spot: the median of its neighbourhood, seven blocks wide. Each channel on its
    # own: a bright floor leaves a red spot hardly any room in red, but its white core rises in blue and green
    rise = max_channel(cv2.subtract(maxima, cv2.medianBlur(maxima, 7)))
    hot = (rise >= p.min_rise) & (max_channel(maxima) >= p.min_level)
    if within is not None:
        everywhere, hot = hot, np.zeros_like(hot)
        hot[within] = everywhere[within]
    candidates = []
    seeds = [seed for seed, _ in regions(rise, hot, p.max_candidates, LARGE)]
    for seed, metre in zip(seeds, judge.metres_in(seeds)):
        candidate = _measure(image, seed, metre, judge)
        if candidate.refusal == "too_large" and judge.least_chroma() is not None and image.ndim == 3:
            # a spot within a lamp's reflection is the coloured place in it
            candidate = _measure(image, colour.most_coloured(image, seed), metre, judge)
        candidate.refusal = candidate.refusal or judge.refusal_of(candidate, metre)
        if candidate.refusal in ("not_round", "too_long") and followed.reaches(candidate.u, candidate.v):
            # the followed spot has come to a bright line of the floor, which its outline goes on in
            core = _measure(image, seed, metre, judge, appearance.CORE)
            core.refusal = core.refusal or judge.refusal_of(core, metre)
            candidate = candidate if core.refusal else core
        candidates.append(candidate)
    return appearance.without_doubles(candidates)


def _measure(
    image: np.ndarray, seed: Region, metre: Optional[float], judge: Judge, edge: float = appearance.EDGE
) -> Candidate:
    left, top, right, bottom = seed
    # even bounds keep each pixel's place in a Bayer image's pattern
    reach = int(max(24, 1.5 * max(right - left, bottom - top)))
    x0, y0 = max(0, left - reach) & ~1, max(0, top - reach) & ~1
    window = image[y0 : bottom + reach, x0 : right + reach]
    # a median removes the spot and keeps the edges of carpets, next to which spots are drawn
    floor = cv2.medianBlur(np.ascontiguousarray(window), min(2 * reach - 7, _WIDEST_MEDIAN))
    inside = (left - x0, top - y0, right - x0, bottom - y0)
    candidate = appearance.measure(window, floor, inside, judge.largest(metre), False, judge.least_chroma(), edge)
    candidate.u += x0
    candidate.v += y0
    return candidate
