"""Spots over time: which sighting belongs to which spot, when it counts, and which is published.

The only part of the detector that knows time. A track moves on at a constant velocity, on the floor where the camera's
pose is known, else in the image; every limit is given in seconds and holds for some images at least, so that a camera of
two images a second works as one of sixty does. A track that is published stays so until it is lost.
"""
from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from statistics import median
from typing import Any, Callable, Deque, List, NamedTuple, Optional, Sequence, Tuple

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

SLACK_M, SLACK_PX = 0.05, 12.0  # what noise alone may move a spot between two images
_GAP_PERIODS = 3.5  # a spot may be missing in two images of any camera
_RECALL_S = 1.0  # older sightings of a spot confirmed late are not published
_TRUST_S = 0.5  # [s] how long a spot is followed while it cannot be measured well
_MOVED_PX = 8.0  # a spot that is held still stays within this of a place
_HELD_S = 0.6  # [s] a hand that draws leaves such a place sooner
_DIAGONAL_M = 5.0  # without a pose an image's diagonal counts as this much
_PERIODS = 15  # [images] whose median distance in time is the period


class Sighting(NamedTuple):
    """What one image shows of a spot.

    Attributes:
        pixel: (u, v) [px]
        floor: (x, y) [m]; None without a pose.
        confidence: 0 ... 1, to choose among several.
        certain: False if it was taken for a spot only since one was expected there.
        proven: False on ground that was never seen without it: it may be a lamp, until it is seen on other ground.
        tint: what `colour.tint_of` said; None if its colour does not matter.
        content: anything; comes back when it is backfilled.
    """

    pixel: Tuple[float, float]
    floor: Optional[Tuple[float, float]]
    confidence: float
    certain: bool
    proven: bool
    tint: Optional[np.ndarray]
    content: Any


class Expected(NamedTuple):
    """Where a confirmed spot is in the next image if it moves on as before.

    Attributes:
        reach: [px] about its place (u, v).
        trusted: it was measured well a short time ago.
        moves: it is drawing, not held still.
        published: it is one of those published.
    """

    u: float
    v: float
    reach: float
    trusted: bool
    moves: bool
    published: bool

    def holds(self, u: float, v: float) -> bool:
        """Whether a place [px] is within reach."""
        return math.hypot(u - self.u, v - self.v) <= self.reach


class Tracked(NamedTuple):
    """A sighting's track number, whether it is confirmed and published, and what it recalls, oldest first."""

    track: int
    confirmed: bool
    published: bool
    backfilled: Tuple[Tuple[float, Any], ...]


@dataclass(eq=False)
class _Track:
    number: int
    place: np.ndarray  # in the unit of the gates
    pixel: np.ndarray
    stamp: float
    since: float
    stayed_at: np.ndarray  # [px] where it began to stay
    stayed_since: float
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(2))
    pixel_velocity: np.ndarray = field(default_factory=lambda: np.zeros(2))
    certain_at: float = -math.inf
    hits: int = 0
    proven: bool = False
    confirmed: bool = False
    published: bool = False
    tint: Optional[np.ndarray] = None  # the sum over its sightings
    waiting: Deque[Tuple[float, Any]] = field(default_factory=deque)


class SpotTracker:
    """Follows the spots of one camera.

    Args:
        confirm_frames: a spot must be seen in this many images; 1: each image counts by itself.
        max_speed: [m/s] of a spot on the floor.
        max_gap_s: [s] it may be hidden this long; two images in any case.
        max_spots: published at most.

    Attributes:
        period_s: [s] from one image to the next, the median of the last ones; 0 before the second.
    """

    def __init__(self, confirm_frames: int, max_speed: float, max_gap_s: float, max_spots: int) -> None:
        self._tracks: List[_Track] = []
        self._numbers = 0
        self._periods: Deque[float] = deque(maxlen=_PERIODS)
        self.period_s = 0.0
        self._stamp: Optional[float] = None
        self._metric: Optional[bool] = None
        self.retune(confirm_frames, max_speed, max_gap_s, max_spots)

    def retune(self, confirm_frames: int, max_speed: float, max_gap_s: float, max_spots: int) -> None:
        """Changes the limits."""
        self._confirm_frames, self._max_speed = confirm_frames, max_speed
        self._max_gap_s, self._max_spots = max_gap_s, max_spots

    def reset(self) -> None:
        """Forgets every spot."""
        self._tracks, self._stamp = [], None
        self._periods.clear()
        self.period_s = 0.0

    def begin(self, stamp: float, diagonal: float, motion: Optional[np.ndarray]) -> List[Expected]:
        """Begins the next image; call it before `update`.

        Args:
            stamp: [s] of the image, later than the last one's.
            diagonal: [px] of the image.
            motion: (3, 3) from the last image's pixels to this one's; None: the camera was stationary.

        Returns:
            Where confirmed spots should be by now, published ones first.
        """
        if self._stamp is not None:
            self._periods.append(stamp - self._stamp)
            self.period_s = median(self._periods)
        self._stamp, self._diagonal = stamp, diagonal
        gap = max(self._max_gap_s, _GAP_PERIODS * self.period_s)
        self._tracks = [track for track in self._tracks if stamp - track.stamp <= gap]
        expected = []
        for track in self._tracks:
            if motion is not None:
                moved = cv2.perspectiveTransform(np.array([[track.pixel, track.stayed_at]]), motion)[0]
                if not self._metric:
                    track.place = track.place + moved[0] - track.pixel
                track.pixel, track.stayed_at = moved
            if track.confirmed:
                expected.append(self._expect(track))
        return sorted(expected, key=lambda one: not one.published)

    def _expect(self, track: _Track) -> Expected:
        elapsed = self._stamp - track.stamp
        u, v = track.pixel + track.pixel_velocity * elapsed
        reach = SLACK_PX + 0.5 * elapsed * float(np.hypot(*track.pixel_velocity))
        trusted = self._stamp - track.certain_at <= max(_TRUST_S, _GAP_PERIODS * self.period_s)
        moves = track.stamp - track.stayed_since < max(_HELD_S, _GAP_PERIODS * self.period_s)
        return Expected(float(u), float(v), reach, trusted, moves, track.published)

    def update(
        self, sightings: Sequence[Sighting],
        agrees: Callable[[Sighting, Optional[np.ndarray], float], bool] = lambda *_: True,
    ) -> List[Tracked]:
        """Adds the sightings of the image that was begun.

        Args:
            agrees: asked when a track would be confirmed, with the mean tint of its sightings, and since when it is
                followed [s]: of a white glint hardly larger than a pixel one place of a Bayer pattern gets most, which
                looks like a colour; in the mean over several images it does not.

        Returns:
            One for each sighting.
        """
        metric = bool(sightings) and sightings[0].floor is not None
        if sightings and metric != self._metric:
            self._tracks, self._metric = [], metric
        tracks = self._assign(sightings)
        backfilled = []
        for sighting, track in zip(sightings, tracks):
            self._see(track, sighting)
            if not track.confirmed and track.hits >= self._confirm_frames and track.proven:
                mean = None if track.tint is None else track.tint / track.tint.max()
                track.confirmed = self._confirm_frames <= 1 or agrees(sighting, mean, self._stamp - track.since)
            oldest = self._stamp - max(_RECALL_S, (self._confirm_frames + 1) * self.period_s)
            while track.waiting and track.waiting[0][0] < oldest:
                track.waiting.popleft()
        self._choose(tracks, sightings)
        for sighting, track in zip(sightings, tracks):
            backfilled.append(())
            if track.published:
                backfilled[-1] = tuple(track.waiting)
                track.waiting.clear()
            elif not track.confirmed:
                track.waiting.append((self._stamp, sighting.content))
        return [Tracked(t.number, t.confirmed, t.published, told) for t, told in zip(tracks, backfilled)]

    def _assign(self, sightings: Sequence[Sighting]) -> List[_Track]:
        places = [np.array(s.floor if s.floor is not None else s.pixel, float) for s in sightings]
        slack, speed = (SLACK_M, self._max_speed)
        if not self._metric:
            slack, speed = SLACK_PX, self._max_speed * self._diagonal / _DIAGONAL_M
        found: List[Optional[_Track]] = [None] * len(sightings)
        if self._tracks and sightings:
            far = 1e9
            costs = np.full((len(sightings), len(self._tracks)), far)
            for column, track in enumerate(self._tracks):
                elapsed = self._stamp - track.stamp
                ahead = track.place + track.velocity * elapsed
                for row, place in enumerate(places):
                    if np.hypot(*(place - track.place)) <= slack + speed * elapsed:
                        costs[row, column] = np.hypot(*(place - ahead))
            for row, column in zip(*linear_sum_assignment(costs)):
                if costs[row, column] < far:
                    found[row] = self._tracks[column]
        for row, track in enumerate(found):
            if track is None:
                self._numbers += 1
                pixel = np.array(sightings[row].pixel, float)
                found[row] = _Track(self._numbers, places[row], pixel, self._stamp, self._stamp, pixel, -math.inf)
                self._tracks.append(found[row])
        return found

    def _see(self, track: _Track, sighting: Sighting) -> None:
        pixel = np.array(sighting.pixel, float)
        place = pixel if sighting.floor is None else np.array(sighting.floor, float)
        elapsed = self._stamp - track.stamp
        if elapsed > 0:
            track.velocity = (place - track.place) / elapsed
            track.pixel_velocity = (pixel - track.pixel) / elapsed
        track.place, track.pixel, track.stamp = place, pixel, self._stamp
        if np.hypot(*(pixel - track.stayed_at)) > _MOVED_PX:
            track.stayed_at, track.stayed_since = pixel, self._stamp
        track.proven = track.proven or sighting.proven
        if sighting.certain:
            track.certain_at = self._stamp
            track.hits += 1
            if sighting.tint is not None:
                track.tint = sighting.tint if track.tint is None else track.tint + sighting.tint

    def _choose(self, tracks: Sequence[_Track], sightings: Sequence[Sighting]) -> None:
        """Chooses the confirmed tracks to publish: those that were, then the most certain."""
        seen = sorted(zip(tracks, sightings), key=lambda both: (not both[1].certain, -both[1].confidence))
        if self._confirm_frames <= 1:
            for track in self._tracks:
                track.published = False
        told = sum(track.published for track in self._tracks)
        for track, _ in seen:
            if track.confirmed and not track.published and told < self._max_spots:
                track.published = True
                told += 1
