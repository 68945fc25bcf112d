"""Looks for spots in the images of a camera that does not move."""
from __future__ import annotations

from typing import List, Optional, Tuple

import cv2
import numpy as np

from vb_laser_detect import appearance
from vb_laser_detect.appearance import Candidate, Region
from vb_laser_detect.background import Background, is_mosaic
from vb_laser_detect.blocks import BLOCK, blocks_around
from vb_laser_detect.followed import FollowedSpot
from vb_laser_detect.judgement import SATURATED, Judge
from vb_laser_detect.moving_search import LARGE, search_moving
from vb_laser_detect.regions import regions

_NEAR = 6  # [blocks] whose changes count as nearby
_LEAST_WHITE = 128.0  # [grey levels] no camera's white is darker
_HELD = 0.5  # doubts up to which a spot that stays is kept out of the background: more, and it may be a ghost


class StationarySearch:
    """Candidates in what rose above a slowly learnt background.

    The saturating difference to it is reduced to its maxima over blocks of 8 x 8 pixels; only blocks that rose are
    looked at in full resolution.
    """

    def __init__(self, judge: Judge, followed: FollowedSpot) -> None:
        self._judge, self._followed = judge, followed
        judge.white = _LEAST_WHITE  # until something brighter was seen
        self._background: Optional[Background] = None
        self._noise_known = False

    def retime(self) -> None:
        """Goes on with the judge's parameters; what was learnt of the scene stays."""
        p = self._judge.params
        if self._background is not None:
            self._background.retime(p.cycle_s, p.absorb_s, p.hold_s)

    def search(self, image: np.ndarray, elapsed: float) -> List[Candidate]:
        """The candidates of an image that was taken so long [s] after the last one; the first image is learnt."""
        p, background = self._judge.params, self._background
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
        changed, spots = hot | darker, np.zeros_like(hot)
        candidates = self._look(image, rise, hot, changed, spots) if hot.any() else []
        background.learn(image, rise, changed, spots, elapsed)
        return candidates

    def _look(
        self, image: np.ndarray, rise: np.ndarray, hot: np.ndarray, changed: np.ndarray, spots: np.ndarray
    ) -> List[Candidate]:
        """The candidates among the hot blocks; marks the blocks of `spots` that the background must not learn."""
        judge, count, candidates = self._judge, int(np.count_nonzero(changed)), []
        followed, others, left_out = self._seeds(image, rise, hot)
        seeds = followed + others
        for number, (seed, metre) in enumerate(zip(seeds, judge.metres_in(seeds))):
            measure = self._measure_followed if number < len(followed) else self._measure
            candidate = measure(image, seed, judge.largest(metre))
            candidates.append(candidate)
            if candidate.refusal:
                continue
            own = blocks_around(hot.shape, candidate.u, candidate.v, 1.25 * candidate.diameter + BLOCK)
            near = blocks_around(hot.shape, candidate.u, candidate.v, _NEAR * BLOCK)
            candidate.busy = (count - int(np.count_nonzero(changed[own]))) / hot.size
            candidate.neighbours = int(np.count_nonzero(hot[near])) - int(np.count_nonzero(hot[own]))
            candidate.refusal = judge.refusal_of(candidate, metre)
            if candidate.refusal and self._followed.trusted() and self._followed.expected_at(candidate.u, candidate.v):
                candidate.refusal, candidate.certain = judge.refusal_of(candidate, metre, expected=True), False
            if candidate.refusal or candidate.doubt > _HELD or not candidate.certain:
                continue
            spots[own] = True
            if self._is_the_one(candidate):
                left_out += [appearance.unmeasured(seed, "not_looked_at") for seed in seeds[number + 1 :]]
                break
        return appearance.without_doubles(candidates) + left_out

    def _is_the_one(self, c: Candidate) -> bool:
        """Whether no other spot has to be looked for: this one is followed, has shown its colour, and is drawn with."""
        only = self._judge.params.max_spots == 1 and self._judge.least_chroma() is not None
        return only and self._followed.moves() and self._followed.expected_at(c.u, c.v)

    def _seeds(
        self, image: np.ndarray, rise: np.ndarray, hot: np.ndarray
    ) -> Tuple[List[Region], List[Region], List[Candidate]]:
        """The regions to look at closely: where the followed spot should be, and others; and those too dark for it."""
        seeds: Tuple[List[Region], List[Region], List[Candidate]] = ([], [], [])
        for seed, level in self._brightest(image, rise, hot):
            if level < self._judge.params.min_level * self._judge.white / 255.0:
                seeds[2].append(appearance.unmeasured(seed, "too_dark"))
            else:
                seeds[self._followed.expected_in(seed) is None].append(seed)
        return seeds

    def _brightest(self, image: np.ndarray, rise: np.ndarray, hot: np.ndarray) -> List[Tuple[Region, float]]:
        """The regions to look at closely, and the brightest pixel of each.

        A spot shows the camera's white wherever it falls; by how much it rises depends on the floor, and on a bright
        one a person beside it rises more. So white regions come first, among them those that rose most.
        """
        p, found = self._judge.params, []
        for seed, peak in regions(rise, hot, 4 * p.max_candidates, LARGE):
            left, top, right, bottom = seed
            part = image[top:bottom, left:right]
            # columns and channels side by side: the brightest sample is all that counts
            found.append((seed, float(cv2.minMaxLoc(part.reshape(part.shape[0], -1))[1]), peak))
        if not found:
            return []
        self._judge.white = max(self._judge.white, max(level for _, level, _ in found))
        found.sort(key=lambda one: (-min(one[1], SATURATED * self._judge.white), -one[2]))
        # most of what a person's clothes leave is found too large at once, and must not use up all places
        return [(seed, level) for seed, level, _ in found[: 2 * p.max_candidates]]

    def _measure(self, image: np.ndarray, seed: Region, largest: float) -> Candidate:
        return appearance.measure(image, self._background.image, seed, largest, least_chroma=self._judge.least_chroma())

    def _measure_followed(self, image: np.ndarray, seed: Region, largest: float) -> Candidate:
        """Measures a region where the followed spot should be.

        It has shown its colour: whatever light falls on it now may hide that. Where it is a part of something larger
        that became brighter, as at the edge of a sun patch, it is the core of that, and nobody can say where it ends.
        """
        candidate = appearance.measure(image, self._background.image, seed, largest)
        if candidate.refusal == "too_large" and self._followed.trusted():
            near = self._followed.expected_in(seed)
            core = appearance.measure(image, self._background.image, near, largest, edge=appearance.CORE_OF_MORE)
            if not core.refusal and self._followed.expected_at(core.u, core.v):
                core.certain = False
                return core
        exempt = self._judge.least_chroma() is None or self._followed.expected_at(candidate.u, candidate.v)
        return candidate if exempt else self._measure(image, seed, largest)

    def _start(self, image: np.ndarray) -> None:
        p = self._judge.params
        self._judge.white = max(self._judge.white, float(cv2.minMaxLoc(image.reshape(image.shape[0], -1))[1]))
        self._judge.mosaic = is_mosaic(image)
        self._background = Background(image, p.cycle_s, p.absorb_s, p.hold_s)
        self._noise_known = False

    def _search_followed(self, image: np.ndarray) -> List[Candidate]:
        """The spot that was followed until now, in the first image of a scene that nothing is known of."""
        if self._followed.last is None:
            return []
        u, v, _ = self._followed.last
        blocks = (image.shape[0] // BLOCK, image.shape[1] // BLOCK)
        within = blocks_around(blocks, u, v, self._followed.gate())
        candidates = search_moving(image, self._judge, self._followed, within)
        for candidate in candidates:
            if not self._followed.reaches(candidate.u, candidate.v):
                candidate.refusal = candidate.refusal or "scene_unknown"
            elif not candidate.refusal:
                self._background.erase(candidate.u, candidate.v, candidate.diameter)
        return candidates
