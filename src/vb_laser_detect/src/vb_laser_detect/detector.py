"""Finds laser spots in a camera's images, one call per frame.

`stationary_search` or `moving_search` proposes candidates, which `appearance` measures and `judgement` judges;
`tracker` confirms them over frames.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Callable, List, Optional, Tuple

import numpy as np

from vb_core.errors import CodedError, ParameterError

from vb_laser_detect.appearance import Candidate
from vb_laser_detect.blocks import BLOCK
from vb_laser_detect.detector_params import DetectorParams
from vb_laser_detect.floor_scale import ToFloor
from vb_laser_detect.followed import FollowedSpot
from vb_laser_detect.judgement import Judge
from vb_laser_detect.moving_search import search_moving
from vb_laser_detect.stationary_search import StationarySearch
from vb_laser_detect.tracker import SLACK_M, SLACK_PX, SpotTracker


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
        tag: whatever belongs to the next frame; it comes back with those of its spots that are recalled later.
        candidates: what the last frame held, spots and refused ones, for debug images.
        recalled: spots of earlier frames that the last one confirmed, the oldest first: what a stroke began with.
    """

    def __init__(self, params: Optional[DetectorParams] = None) -> None:
        p = params or DetectorParams.stationary()
        self.tag: Any = None
        self._judge = Judge(p)
        self._tracker = SpotTracker(p.confirm_frames, p.max_speed, p.max_gap_s, SLACK_M, p.min_chroma)
        self._on_floor: Optional[bool] = None
        self.reset()

    @property
    def params(self) -> DetectorParams:
        """What a spot looks like; see `retune`."""
        return self._judge.params

    def look_from(
        self, to_floor: Optional[ToFloor], place_check: Optional[Callable[[float, float], str]] = None
    ) -> None:
        """Says where the camera of the next frames is.

        Args:
            to_floor: pixels (N, 2) to the floor [m], for sizes in millimetres and speeds in m/s. None: pixels it is.
            place_check: a pixel (u, v) to the reason why no spot can be there, or "".
        """
        self._judge.to_floor, self._judge.place_check = to_floor, place_check

    def retune(self, params: DetectorParams) -> None:
        """Goes on with other parameters; what was learnt of the scene stays.

        Raises:
            ParameterError: for another `moving_camera`, which needs another detector.
        """
        if params.moving_camera != self.params.moving_camera:
            raise ParameterError("moving_camera", "cannot be changed while the detector runs")
        self._judge.params, tracker = params, self._tracker
        tracker.confirm_frames, tracker.min_chroma = params.confirm_frames, params.min_chroma
        tracker.max_gap_s = self._followed.max_gap_s = params.max_gap_s
        if self._stationary is not None:
            self._stationary.retime()

    def reset(self) -> None:
        """Forgets the scene; the next frame is learnt as it is."""
        self.candidates: List[Candidate] = []
        self.recalled: List[Recalled] = []
        self._stamp: Optional[float] = None
        self._tracker.reset()
        self._followed = FollowedSpot(self.params.max_gap_s)
        self._stationary = None if self.params.moving_camera else StationarySearch(self._judge, self._followed)

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
        self._stamp = self._followed.now = stamp
        self._judge.diagonal = self._followed.diagonal = math.hypot(*image.shape[:2])
        if self._stationary is None:
            self.candidates = search_moving(image, self._judge, self._followed)
        else:
            # a pause must not make one frame outweigh all that was learnt before
            self.candidates = self._stationary.search(image, min(elapsed, 1.0))
        found = sorted((c for c in self.candidates if not c.refusal), key=lambda c: (not c.certain, -c.confidence))
        return self._confirm(found)

    def _confirm(self, found: List[Candidate]) -> List[Spot]:
        """The most certain of the confirmed ones; a newcomer takes nobody's place before it is confirmed."""
        spots = [Spot(c.u, c.v, c.diameter, c.confidence) for c in found]
        passed, recalled = self._track(found, spots)
        chosen = [number for number, confirmed in enumerate(passed) if confirmed][: self.params.max_spots]
        for number, candidate in enumerate(found):
            if number not in chosen:
                candidate.refusal = "less_certain" if passed[number] else "unconfirmed"
        self.recalled = [earlier for number in chosen for earlier in recalled[number]]
        if chosen:
            first = found[chosen[0]]
            self._followed.see(first.u, first.v, first.certain)
        return [spots[number] for number in chosen]

    def _track(self, found: List[Candidate], spots: List[Spot]) -> Tuple[List[bool], List[List[Recalled]]]:
        """Whether each is confirmed by now, and what is recalled with it."""
        tracker, to_floor, max_speed = self._tracker, self._judge.to_floor, self.params.max_speed
        if self.params.confirm_frames <= 1:
            tracker.reset()
            return [True] * len(found), [[]] * len(found)
        if (to_floor is not None) != self._on_floor:
            tracker.reset()
            self._on_floor = to_floor is not None
        positions = np.array([(c.u, c.v) for c in found], dtype=float).reshape(-1, 2)
        if to_floor is not None:
            tracker.max_speed, tracker.slack = max_speed, SLACK_M
            positions = to_floor(positions)[:, :2] if len(positions) else positions
        else:
            # without a pose the image's diagonal is taken for five metres
            tracker.max_speed, tracker.slack = max_speed * self._judge.diagonal / 5.0, SLACK_PX
        sightings = [Recalled(spot, self._stamp, self.tag) for spot in spots]
        tints = [c.tint for c in found] if self._judge.least_chroma() is not None else None
        return tracker.update(positions, self._stamp, sightings, tints), tracker.recalled


def _checked(image: np.ndarray) -> np.ndarray:
    image = np.asarray(image)
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (1, 3, 4)):
        raise CodedError("bad_image", f"expected 8 bit mono, Bayer or colour pixels, got {image.dtype} {image.shape}")
    if min(image.shape[:2]) < 4 * BLOCK:
        raise CodedError("bad_image", f"the image is too small: {image.shape[1]} x {image.shape[0]}")
    if image.ndim == 3 and image.shape[2] != 3:
        image = image[:, :, 0] if image.shape[2] == 1 else image[:, :, :3]
    return np.ascontiguousarray(image)
