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

from vb_laser_detect.detector_params import DetectorParams

_SLACK_M, _SLACK_PX = 0.05, 12.0  # what noise alone may move a spot between two images
_MAX_SPEED = 8.0  # [m/s] of a spot on the floor: a wrist's flick
_GAP_S, _GAP_PERIODS = 0.25, 3.5  # a spot may be hidden so long, a leg's time, and be missing in two images of any camera
_RECALL_S = 1.0  # older sightings of a spot confirmed late are not published
_TRUST_S = 0.5  # [s] how long a spot is followed while it cannot be measured well
_DIAGONAL_M = 5.0  # without a pose an image's diagonal counts as this much
_PERIODS = 15  # [images] whose median distance in time is the period


class Sighting(NamedTuple):
    """What one image shows of a spot.

    Attributes:
        place: (4,) u, v [px] and x, y [m] on the floor, NaN without a pose.
        confidence: 0 ... 1, to choose among several.
        certain: False if it was taken for a spot only since one was expected there.
        tint: what `features.tint_of` said; None if its colour does not matter.
        content: anything; comes back when it is backfilled.
    """

    place: np.ndarray
    confidence: float
    certain: bool
    tint: Optional[np.ndarray]
    content: Any


class Expected(NamedTuple):
    """Where a confirmed spot is in the next image if it moves on as before.

    Attributes:
        reach: [px] about its place (u, v).
        trusted: it was measured well a short time ago.
        published: it is one of those published.
    """

    u: float
    v: float
    reach: float
    trusted: bool
    published: bool

    def holds(self, u: float, v: float) -> bool:
        """Whether a place [px] is within reach."""
        return math.hypot(u - self.u, v - self.v) <= self.reach


class Tracked(NamedTuple):
    """A sighting's track number, whether it is confirmed and published, and what it recalls, oldest first."""

    track: int
    confirmed: bool
    published: bool
    backfilled: Tuple[Any, ...]


@dataclass(eq=False)
class _Track:
    number: int
    place: np.ndarray
    stamp: float
    since: float
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(4))
    certain_at: float = -math.inf
    hits: int = 0
    confirmed: bool = False
    published: bool = False
    tint: Optional[np.ndarray] = None  # the sum over its sightings
    waiting: Deque[Tuple[float, Any]] = field(default_factory=deque)


class SpotTracker:
    """Follows the spots of one camera.

    Attributes:
        params: the detector's; they may be changed between images.
        period_s: [s] from one image to the next, the median of the last ones; 0 before the second.
    """

    def __init__(self, params: DetectorParams) -> None:
        self.params = params
        self._tracks: List[_Track] = []
        self._numbers = 0
        self._periods: Deque[float] = deque(maxlen=_PERIODS)
        self.period_s = 0.0
        self._stamp: Optional[float] = None
        self._axes = slice(0, 2)  # of a place, in which spots are told apart

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
        gap = max(_GAP_S, _GAP_PERIODS * self.period_s)
        self._tracks = [track for track in self._tracks if stamp - track.stamp <= gap]
        if motion is not None:
            for track in self._tracks:
                moved = cv2.perspectiveTransform(track.place[None, None, :2], motion)[0, 0]
                track.place = np.concatenate([moved, track.place[2:]])
        expected = [self._expect(track) for track in self._tracks if track.confirmed]
        return sorted(expected, key=lambda one: not one.published)

    def _expect(self, track: _Track) -> Expected:
        elapsed = self._stamp - track.stamp
        u, v = (track.place + track.velocity * elapsed)[:2].tolist()
        reach = _SLACK_PX + 0.5 * elapsed * math.hypot(*track.velocity[:2])
        trusted = self._stamp - track.certain_at <= max(_TRUST_S, _GAP_PERIODS * self.period_s)
        return Expected(u, v, reach, trusted, track.published)

    def update(
        self, sightings: Sequence[Sighting],
        agrees: Callable[[Optional[np.ndarray], float], bool] = lambda *_: True,
    ) -> List[Tracked]:
        """Adds the sightings of the image that was begun.

        Args:
            agrees: asked when a track would be confirmed, with the mean tint of its sightings, and since when it
                is followed [s]: of a white glint hardly larger than a pixel one place of a Bayer pattern gets most, which
                looks like a colour; in the mean over several images it does not.

        Returns:
            One for each sighting.
        """
        if sightings:
            axes = slice(0, 2) if np.isnan(sightings[0].place[2]) else slice(2, 4)
            if axes != self._axes:
                self._tracks, self._axes = [], axes
        tracks = self._assign(sightings)
        oldest = self._stamp - max(_RECALL_S, (self.params.confirm_frames + 1) * self.period_s)
        for sighting, track in zip(sightings, tracks):
            self._see(track, sighting)
            if not track.confirmed and track.hits >= self.params.confirm_frames:
                mean = None if track.tint is None else track.tint / track.tint.max()
                track.confirmed = self.params.confirm_frames <= 1 or agrees(mean, self._stamp - track.since)
            while track.waiting and track.waiting[0][0] < oldest:
                track.waiting.popleft()
        self._choose(tracks, sightings)
        result = []
        for sighting, track in zip(sightings, tracks):
            backfilled = tuple(content for _, content in track.waiting) if track.published else ()
            if track.published:
                track.waiting.clear()
            elif not track.confirmed:
                track.waiting.append((self._stamp, sighting.content))
            result.append(Tracked(track.number, track.confirmed, track.published, backfilled))
        return result

    def _assign(self, sightings: Sequence[Sighting]) -> List[_Track]:
        """The track of each sighting; the nearest pairs within reach, else a new one."""
        slack, speed = (_SLACK_M, _MAX_SPEED) if self._axes.start else (
            _SLACK_PX, _MAX_SPEED * self._diagonal / _DIAGONAL_M)
        found: List[Optional[_Track]] = [None] * len(sightings)
        if self._tracks and sightings:
            places = np.array([s.place[self._axes] for s in sightings])[:, None]
            last = np.array([track.place[self._axes] for track in self._tracks])
            elapsed = np.array([[self._stamp - track.stamp] for track in self._tracks])
            ahead = last + elapsed * [track.velocity[self._axes] for track in self._tracks]
            near = np.linalg.norm(places - last, axis=2) <= slack + speed * elapsed[:, 0]
            costs = np.where(near, np.linalg.norm(places - ahead, axis=2), 1e9)
            for row, column in zip(*linear_sum_assignment(costs)):
                if near[row, column]:
                    found[row] = self._tracks[column]
        for row, track in enumerate(found):
            if track is None:
                self._numbers += 1
                found[row] = _Track(self._numbers, sightings[row].place, self._stamp, self._stamp)
                self._tracks.append(found[row])
        return found

    def _see(self, track: _Track, sighting: Sighting) -> None:
        elapsed = self._stamp - track.stamp
        if elapsed > 0:
            track.velocity = (sighting.place - track.place) / elapsed
        track.place, track.stamp = sighting.place, self._stamp
        if sighting.certain:
            track.certain_at = self._stamp
            track.hits += 1
            if sighting.tint is not None:
                track.tint = sighting.tint if track.tint is None else track.tint + sighting.tint

    def _choose(self, tracks: Sequence[_Track], sightings: Sequence[Sighting]) -> None:
        """Chooses the confirmed tracks to publish: those that were, then the most certain."""
        if self.params.confirm_frames <= 1:
            for track in self._tracks:
                track.published = False
        left = self.params.max_spots - sum(track.published for track in self._tracks)
        for track, _ in sorted(zip(tracks, sightings), key=lambda both: (not both[1].certain, -both[1].confidence)):
            if track.confirmed and not track.published and left > 0:
                track.published = True
                left -= 1
