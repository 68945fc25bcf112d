"""Finds laser spots in a camera's images, one call per frame.

For a stationary camera the frame's saturating difference to a slowly learnt background is reduced to its maxima over
blocks of 8 x 8 pixels; only blocks that rose are looked at in full resolution. For a moving camera places that are
brighter than their neighbourhood take the background's part. Either way `appearance` measures each candidate, and
`refusal_of` says why it cannot be a spot.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Callable, List, Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core.errors import CodedError, ParameterError

from vb_laser_detect import appearance, colour
from vb_laser_detect.appearance import Candidate, Region
from vb_laser_detect.background import Background, is_mosaic
from vb_laser_detect.blocks import BLOCK, block_maxima, blocks_around, max_channel
from vb_laser_detect.detector_params import ALWAYS, BAYER, DetectorParams
from vb_laser_detect.followed import FollowedSpot
from vb_laser_detect.judgement import SATURATED, doubts
from vb_laser_detect.regions import regions
from vb_laser_detect.tracker import SLACK_M, SLACK_PX, SpotTracker

_SMEAR_PX = 3.0
_LARGE = 14  # [blocks] regions that are larger are cut down to their brightest parts
_NEAR = 6  # [blocks] whose changes count as nearby
_LEAST_WHITE = 128.0  # [grey levels] no camera's white is darker
_HELD = 0.5  # doubts up to which a spot that stays is kept out of the background: more, and it may be a ghost
_WIDEST_MEDIAN = 255  # [px] of 8-bit images, OpenCV's limit

# pixels (N, 2) to the floor (N, 2) [m], rows of NaN where there is none
ToFloor = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Spot:
    """A laser spot in an image.

    Attributes:
        u, v: [px] column and row, sub-pixel; the centre of the first pixel is 0.
        diameter: [px]
        confidence: 0 ... 1
    """

    u: float
    v: float
    diameter: float
    confidence: float


@dataclass(frozen=True)
class Recalled:
    """A spot of an earlier frame that a later one confirmed.

    Attributes:
        stamp: [s] of its own frame.
        tag: what `SpotDetector.tag` was then.
    """

    spot: Spot
    stamp: float
    tag: Any


class SpotDetector:
    """Finds the spots of one camera; keeps what it knows of the scene between frames.

    Attributes:
        to_floor: pixels (N, 2) to the floor [m], for sizes in millimetres and speeds in m/s. None: pixels it is.
        place_check: a pixel (u, v) to the reason why no spot can be there, or ""; asked last.
        tag: whatever belongs to the next frame; it comes back with those of its spots that are recalled later.
        candidates: what the last frame held, spots and refused ones, for debug images.
        recalled: spots of earlier frames that the last one confirmed, the oldest first: what a stroke began with.
    """

    def __init__(self, params: Optional[DetectorParams] = None) -> None:
        self.params = params or DetectorParams.stationary()
        self.to_floor: Optional[ToFloor] = None
        self.place_check: Optional[Callable[[float, float], str]] = None
        self.tag: Any = None
        self.candidates: List[Candidate] = []
        self.recalled: List[Recalled] = []
        self._background: Optional[Background] = None
        self._noise_known = False
        self._white = _LEAST_WHITE  # [grey levels] the brightest that was seen so far
        self._mosaic = False  # whether the image is a Bayer camera's
        self._followed = FollowedSpot()
        self._stamp: Optional[float] = None
        p = self.params
        self._tracker = SpotTracker(p.confirm_frames, p.max_speed, p.max_gap_s, SLACK_M, p.min_chroma)
        self._on_floor: Optional[bool] = None

    def retune(self, params: DetectorParams) -> None:
        """Goes on with other parameters; what was learnt of the scene stays.

        Raises:
            ParameterError: for another `moving_camera`, which needs another detector.
        """
        if params.moving_camera != self.params.moving_camera:
            raise ParameterError("moving_camera", "cannot be changed while the detector runs")
        self.params = params
        tracker = self._tracker
        tracker.confirm_frames, tracker.max_gap_s, tracker.min_chroma = params.confirm_frames, params.max_gap_s, params.min_chroma
        if self._background is not None:
            self._background.retime(params.cycle_s, params.absorb_s, params.hold_s)

    def reset(self) -> None:
        """Forgets the scene; the next frame is learnt as it is."""
        self._background = None
        self._white = _LEAST_WHITE
        self._followed.forget()
        self._stamp = None
        self._tracker.reset()
        self.candidates, self.recalled = [], []

    def detect(self, image: np.ndarray, stamp: float) -> List[Spot]:
        """Searches one frame.

        Args:
            image: (H, W, 3) bgr (or rgb: colours are only compared with each other) or (H, W) mono or Bayer, uint8.
            stamp: [s] when it was taken. A stamp before the last one's starts anew.

        Returns:
            Confirmed spots, the most certain first.

        Raises:
            CodedError: "bad_image" if it is no such image.
        """
        image = _checked(image)
        if self._stamp is not None and stamp < self._stamp:
            self.reset()
        elapsed = 0.0 if self._stamp is None else stamp - self._stamp
        self._stamp = stamp
        self._followed.diagonal = math.hypot(*image.shape[:2])
        if self.params.moving_camera:
            self.candidates = self._search_moving(image)
        else:
            # a pause must not make one frame outweigh all that was learnt before
            self.candidates = self._search_stationary(image, min(elapsed, 1.0))
        found = sorted((c for c in self.candidates if not c.refusal), key=lambda c: -c.confidence)
        return self._confirm(found, stamp)

    # ------------------------------------------------------------- stationary camera
    def _search_stationary(self, image: np.ndarray, elapsed: float) -> List[Candidate]:
        p = self.params
        background = self._background
        if background is None or background.image.shape != image.shape:
            self._start(image)
            return []
        rise = background.rise(image)
        if not self._noise_known:
            background.learn_noise(rise)
            self._noise_known = True
        hot = background.hot_blocks(rise, p.min_rise)
        darker = background.darker_blocks(image)
        if max(np.count_nonzero(hot), 0.5 * np.count_nonzero(darker)) > p.max_change * hot.size:
            # a light was switched, the exposure jumped or the camera was moved: nothing known holds any more;
            # somebody close to the camera darkens much of the image too, and must not become its background
            self._start(image)
            return self._search_followed(image)
        changed = hot | darker
        count = int(np.count_nonzero(changed))
        spots = np.zeros_like(hot)
        followed, others, left_out = self._seeds(image, rise, hot) if hot.any() else ([], [], [])
        seeds, candidates = followed + others, []
        for number, (seed, metre) in enumerate(zip(seeds, self._metres_in(seeds))):
            # a spot that is followed has shown its colour: whatever light falls on it now may hide it
            least = self._least_chroma() if number >= len(followed) else None
            candidate = appearance.measure(image, background.image, seed, self._largest(metre), least_chroma=least)
            candidates.append(candidate)
            if candidate.refusal:
                continue
            own = blocks_around(hot.shape, candidate.u, candidate.v, 1.25 * candidate.diameter + BLOCK)
            near = blocks_around(hot.shape, candidate.u, candidate.v, _NEAR * BLOCK)
            candidate.busy = (count - int(np.count_nonzero(changed[own]))) / hot.size
            candidate.neighbours = int(np.count_nonzero(hot[near])) - int(np.count_nonzero(hot[own]))
            candidate.refusal = self._refusal_of(candidate, metre)
            if candidate.refusal or candidate.doubt > _HELD:
                continue
            spots[own] = True
            if self._is_the_one(candidate):
                left_out += [_unmeasured(seed, "not_looked_at") for seed in seeds[number + 1 :]]
                break
        background.learn(image, rise, changed, spots, elapsed)
        return _without_doubles(candidates) + left_out

    def _is_the_one(self, c: Candidate) -> bool:
        """Whether no other spot has to be looked for: this one is followed, has shown its colour, and is drawn with."""
        only = self.params.max_spots == 1 and self._least_chroma() is not None
        return only and self._followed.moves() and self._follows(c.u, c.v)

    def _seeds(
        self, image: np.ndarray, rise: np.ndarray, hot: np.ndarray
    ) -> Tuple[List[Region], List[Region], List[Candidate]]:
        """The regions to look at closely: where the spot that is followed may be, and others; and those too dark for it."""
        seeds: Tuple[List[Region], List[Region], List[Candidate]] = ([], [], [])
        for seed, level in self._brightest(image, rise, hot):
            place = _unmeasured(seed, "too_dark")
            if level < self.params.min_level * self._white / 255.0:
                seeds[2].append(place)
            else:
                # half the gate, for the spot is not in the very middle of its blocks
                seeds[not self._follows(place.u, place.v, 0.5)].append(seed)
        return seeds

    def _brightest(self, image: np.ndarray, rise: np.ndarray, hot: np.ndarray) -> List[Tuple[Region, float]]:
        """The regions to look at closely, and the brightest pixel of each.

        A spot shows the camera's white wherever it falls; by how much it rises depends on the floor, and on a bright
        one a person beside it rises more. So white regions come first, among them those that rose most.
        """
        p, found = self.params, []
        for seed, peak in regions(rise, hot, 4 * p.max_candidates, _LARGE):
            left, top, right, bottom = seed
            part = image[top:bottom, left:right]
            # columns and channels side by side: the brightest sample is all that counts
            found.append((seed, float(cv2.minMaxLoc(part.reshape(part.shape[0], -1))[1]), peak))
        if not found:
            return []
        self._white = max(self._white, max(level for _, level, _ in found))
        found.sort(key=lambda one: (-min(one[1], SATURATED * self._white), -one[2]))
        # most of what a person's clothes leave is found too large at once, and must not use up all places
        return [(seed, level) for seed, level, _ in found[: 2 * p.max_candidates]]

    def _start(self, image: np.ndarray) -> None:
        p = self.params
        self._white = max(self._white, float(cv2.minMaxLoc(image.reshape(image.shape[0], -1))[1]))
        self._background = Background(image, p.cycle_s, p.absorb_s, p.hold_s)
        self._noise_known = False
        self._mosaic = is_mosaic(image)

    def _search_followed(self, image: np.ndarray) -> List[Candidate]:
        """The spot that was followed until now, in the first image of a scene that nothing is known of."""
        if self._followed.last is None:
            return []
        u, v, _ = self._followed.last
        blocks = (image.shape[0] // BLOCK, image.shape[1] // BLOCK)
        candidates = self._search_moving(image, blocks_around(blocks, u, v, self._followed.gate(self._stamp)))
        for candidate in candidates:
            if not self._follows(candidate.u, candidate.v):
                candidate.refusal = candidate.refusal or "scene_unknown"
            elif not candidate.refusal:
                self._background.erase(candidate.u, candidate.v, candidate.diameter)
        return candidates

    # ------------------------------------------------------------- moving camera
    def _search_moving(self, image: np.ndarray, within: Optional[Tuple[slice, slice]] = None) -> List[Candidate]:
        """Searches without a background, in all blocks or some."""
        p = self.params
        maxima = block_maxima(image)
        # what a block would show without a spot: the median of its neighbourhood, seven blocks wide. Each channel on its
        # own: a bright floor leaves a red spot hardly any room in red, but its white core rises in blue and green
        rise = max_channel(cv2.subtract(maxima, cv2.medianBlur(maxima, 7)))
        hot = (rise >= p.min_rise) & (max_channel(maxima) >= p.min_level)
        if within is not None:
            everywhere, hot = hot, np.zeros_like(hot)
            hot[within] = everywhere[within]
        candidates = []
        seeds = [seed for seed, _ in regions(rise, hot, p.max_candidates, _LARGE)]
        for seed, metre in zip(seeds, self._metres_in(seeds)):
            candidate = self._measure_moving(image, seed, metre)
            if candidate.refusal == "too_large" and self._least_chroma() is not None and image.ndim == 3:
                # a spot within a lamp's reflection is the coloured place in it
                candidate = self._measure_moving(image, colour.most_coloured(image, seed), metre)
            candidate.refusal = candidate.refusal or self._refusal_of(candidate, metre)
            candidates.append(candidate)
        return _without_doubles(candidates)

    def _measure_moving(self, image: np.ndarray, seed: Region, metre: Optional[float]) -> Candidate:
        left, top, right, bottom = seed
        # even bounds keep each pixel's place in a Bayer image's pattern
        reach = int(max(24, 1.5 * max(right - left, bottom - top)))
        x0, y0 = max(0, left - reach) & ~1, max(0, top - reach) & ~1
        window = image[y0 : bottom + reach, x0 : right + reach]
        # a median removes the spot and keeps the edges of carpets, next to which spots are drawn
        floor = cv2.medianBlur(np.ascontiguousarray(window), min(2 * reach - 7, _WIDEST_MEDIAN))
        inside = (left - x0, top - y0, right - x0, bottom - y0)
        candidate = appearance.measure(
            window, floor, inside, self._largest(metre), learnt=False, least_chroma=self._least_chroma()
        )
        candidate.u += x0
        candidate.v += y0
        return candidate

    # ------------------------------------------------------------- both
    def _least_chroma(self) -> Optional[float]:
        """How coloured a spot must be; None if this camera's images are not asked for it."""
        asked = self.params.ask_colour
        return self.params.min_chroma if asked == ALWAYS or (asked == BAYER and self._mosaic) else None

    def _follows(self, u: float, v: float, share: float = 1.0) -> bool:
        return self._followed.reaches(u, v, self._stamp, self.params.max_gap_s, share)

    def _largest_px(self) -> float:
        return self._smeared(self.params.max_diameter_share * self._followed.diagonal)

    def _smeared(self, diameter: float) -> float:
        """[px] the extent of a spot that is drawn quickly."""
        return diameter * (self.params.max_elongation if self.params.max_elongation < 3 else 2.0)

    def _metres_in(self, seeds: List[Region]) -> List[Optional[float]]:
        """[m/px] on the floor in the middle of regions; None where the floor, or the camera's pose, is not known."""
        if self.to_floor is None:
            return [None] * len(seeds)
        return metres_per_pixel(self.to_floor, [((left + right) / 2.0, (top + bottom) / 2.0) for left, top, right, bottom in seeds])

    def _largest(self, metre: Optional[float]) -> float:
        """[px] the largest extent of a spot there: what is larger, a person's clothes, is not looked at closely."""
        return self._smeared(self.params.max_diameter_mm / 1e3 / metre + _SMEAR_PX) if metre else self._largest_px()

    def _refusal_of(self, c: Candidate, metre: Optional[float]) -> str:
        """Why a measured candidate is no spot, or ""; sets its confidence. `metre`: [m/px] on the floor there."""
        p = self.params
        if c.diameter < p.min_diameter_px:
            return "too_small"
        against = doubts(c, p, 255.0 if p.moving_camera else self._white)
        if self.to_floor is not None:
            # a person's region may have its middle above the horizon, and the spot on the floor
            metre = metre or metres_per_pixel(self.to_floor, [(c.u, c.v)])[0]
            if metre is None:
                return "off_floor"
            # optics and pixels smear every spot by some pixels, whatever its size
            if (c.diameter - _SMEAR_PX) * metre > p.max_diameter_mm / 1e3:
                return "too_large"
            if c.diameter * metre < p.min_diameter_mm / 1e3:
                return "too_small"
        else:
            against["too_large"] = max(0.0, (c.diameter / (p.max_diameter_share * self._followed.diagonal) - 0.55) / 0.45)
        doubt = c.doubt = sum(against.values())
        if doubt > 1.0:
            return max(against, key=lambda reason: against[reason])
        # of two without doubts the brighter one is more likely what somebody points at
        c.confidence = (1.0 - 0.7 * doubt) * (0.7 + 0.3 * min(1.0, c.peak / 160.0))
        return self.place_check(c.u, c.v) if self.place_check is not None else ""

    def _confirm(self, found: List[Candidate], stamp: float) -> List[Spot]:
        """The most certain of the confirmed ones; a newcomer takes nobody's place before it is confirmed."""
        spots = [Spot(c.u, c.v, c.diameter, c.confidence) for c in found]
        passed, recalled = self._track(found, spots, stamp)
        chosen = [number for number, confirmed in enumerate(passed) if confirmed][: self.params.max_spots]
        for number, candidate in enumerate(found):
            if number not in chosen:
                candidate.refusal = "less_certain" if passed[number] else "unconfirmed"
        self.recalled = [earlier for number in chosen for earlier in recalled[number]]
        if chosen:
            self._followed.see(found[chosen[0]].u, found[chosen[0]].v, stamp)
        return [spots[number] for number in chosen]

    def _track(
        self, found: List[Candidate], spots: List[Spot], stamp: float
    ) -> Tuple[List[bool], List[List[Recalled]]]:
        """Whether each is confirmed by now, and what is recalled with it."""
        if self.params.confirm_frames <= 1:
            self._tracker.reset()
            return [True] * len(found), [[]] * len(found)
        positions = np.array([(c.u, c.v) for c in found], dtype=float).reshape(-1, 2)
        tracker, on_floor = self._tracker, self.to_floor is not None
        if on_floor != self._on_floor:
            tracker.reset()
            self._on_floor = on_floor
        if self.to_floor is not None:
            tracker.max_speed, tracker.slack = self.params.max_speed, SLACK_M
            positions = self.to_floor(positions)[:, :2] if len(positions) else positions
        else:
            # without a pose the image's diagonal is taken for five metres
            tracker.max_speed, tracker.slack = self.params.max_speed * self._followed.diagonal / 5.0, SLACK_PX
        sightings = [Recalled(spot, stamp, self.tag) for spot in spots]
        return tracker.update(positions, stamp, sightings, [c.tint for c in found]), tracker.recalled


def metres_per_pixel(to_floor: ToFloor, pixels: Sequence[Tuple[float, float]]) -> List[Optional[float]]:
    """[m/px] floor length of each of N pixels (u, v), the mean over directions; None where the floor is not seen."""
    if not len(pixels):
        return []
    corners = np.asarray(pixels, dtype=float)[:, None] + np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
    points = np.asarray(to_floor(corners.reshape(-1, 2)), dtype=float)[:, :2].reshape(-1, 3, 2)
    (ax, ay), (bx, by) = (points[:, 1] - points[:, 0]).T, (points[:, 2] - points[:, 0]).T
    areas = np.abs(ax * by - ay * bx)
    return [math.sqrt(area) if math.isfinite(area) and area > 0 else None for area in areas.tolist()]


def _unmeasured(seed: Region, refusal: str) -> Candidate:
    left, top, right, bottom = seed
    return Candidate((left + right) / 2.0, (top + bottom) / 2.0, float(right - left), refusal=refusal)


def _without_doubles(candidates: List[Candidate]) -> List[Candidate]:
    """Two regions can lead to the same blob; the first stays."""
    kept: List[Candidate] = []
    for c in candidates:
        if not any(math.hypot(c.u - k.u, c.v - k.v) < 2.0 and k.refusal == c.refusal for k in kept):
            kept.append(c)
    return kept


def _checked(image: np.ndarray) -> np.ndarray:
    image = np.asarray(image)
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (1, 3, 4)):
        raise CodedError("bad_image", f"expected 8 bit mono, Bayer or colour pixels, got {image.dtype} {image.shape}")
    if min(image.shape[:2]) < 4 * BLOCK:
        raise CodedError("bad_image", f"the image is too small: {image.shape[1]} x {image.shape[0]}")
    if image.ndim == 3 and image.shape[2] != 3:
        image = image[:, :, 0] if image.shape[2] == 1 else image[:, :, :3]
    return np.ascontiguousarray(image)
