"""Spots over time: which sighting belongs to which spot, when it counts, and which is published.

The only part of the detector that knows time. A track moves on at a constant velocity, on the floor where the camera's
pose is known, else in the image; every limit is given in seconds and holds for some images at least, so that a camera
of two images a second works as one of sixty does. A track that is published stays so until it is lost.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace
from statistics import median
from typing import Any, Deque, List, NamedTuple, Optional, Sequence

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from vb_laser_detect.detection.blocks import Region
from vb_laser_detect.detector_params import DetectorParams
from vb_laser_detect.detection.features import ImageTraits, chroma

_SLACK, _SLACK_PX = 0.05, 12.0  # [m] what noise alone may move a spot between two images
_MAX_SPEED = 8.0  # [m/s] of a spot on the floor: a wrist's flick
# a spot may be hidden so long, a leg's time, and be missing in two images of any camera
_GAP_TIME, _GAP_PERIODS = (0.25, 3.5)
_RECALL_TIME = 1.0  # [s] older sightings of a spot confirmed late are not published
_DIAGONAL = 5.0  # [m] without a pose an image's diagonal counts as this much
_PERIODS = 15  # [images] whose median distance in time is the period
_VIVID = 0.4  # mean chroma of a laser's light on a floor; webcams show less, but other bright things even less
# ... of a laser on a floor that is nearly white; the mean of white glints in Bayer images over half a second is less
_PALE = 0.25
# [s] colourless light is followed for longer before it counts: a glint on a shoe, a watch or a cup lasts
# less than a step, half a second. Nothing is lost, as the spots until then are backfilled
_STEP_TIME = 0.6


@dataclass(frozen=True)
class Spot:
    """A laser spot in an image, or a rejected candidate.

    Attributes:
        u, v: [px] column and row, sub-pixel; the centre of the first pixel is 0.
        diameter: [px]
        confidence: 0 ... 1
        track: number of the spot in this camera's images; it stays while the spot is followed.
        rejection: why it is not published, or "".
        tint: what `features.tint_of` said; None: without colour.
        floor: (x, y) [m]; NaN where the pose is not known.
    """

    u: float
    v: float
    diameter: float
    confidence: float = 0.0
    track: int = 0
    rejection: str = ""
    tint: Optional[np.ndarray] = field(default=None, compare=False)
    floor: Sequence[float] = field(default=(math.nan, math.nan), compare=False)


class BackfilledSpot(NamedTuple):
    """A spot of an earlier frame that a later frame confirmed, with the earlier frame's time [s] and tag."""

    spot: Spot
    stamp: float
    tag: Any


class Expected(NamedTuple):
    """Predicted position of a confirmed spot in the next image, if it keeps moving as before.

    Attributes:
        reach: [px] about its place (u, v).
        diameter: [px] that it had.
        published: it is one of those published.
    """

    u: float
    v: float
    reach: float
    diameter: float
    published: bool

    @property
    def widest(self) -> float:
        """[px] What is wider cannot be the spot."""
        return 2.0 * self.diameter

    def holds(self, u: float, v: float) -> bool:
        """Returns whether a place [px] is within reach."""
        return math.hypot(u - self.u, v - self.v) <= self.reach

    def clip(self, region: Region) -> Region:
        """Returns the part of a region [px] that is within reach; if none is, left >= right or top >= bottom."""
        left, top, right, bottom = region
        return (
            max(left, int(self.u - self.reach)),
            max(top, int(self.v - self.reach)),
            min(right, int(self.u + self.reach) + 1),
            min(bottom, int(self.v + self.reach) + 1),
        )

    def overlaps(self, region: Region) -> bool:
        """Returns whether a part of a region is within reach."""
        left, top, right, bottom = self.clip(region)
        return left < right and top < bottom


@dataclass(eq=False)
class Track:
    """A spot that is followed.

    Attributes:
        place: (4,) u, v [px] and x, y [m], the last ones, with their velocity per second.
        created: [s] when it was seen first.
        dwell_position, dwelling_since: (2,) [px] from where it has hardly moved since then.
        unpublished: what was seen before it was confirmed, the oldest first.
    """

    number: int
    place: np.ndarray
    stamp: float
    created: float
    dwell_position: np.ndarray
    dwelling_since: float
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(4))
    hits: int = 0
    diameter: float = 0.0
    confirmed: bool = False
    published: bool = False
    light: Optional[np.ndarray] = None  # the sum of its spots' tints
    unpublished: List[BackfilledSpot] = field(default_factory=list)


class SpotTracker:
    """Follows the spots of one camera.

    Attributes:
        params: the detector's; they may be changed between images.
        period: [s] from one image to the next, the median of the last ones; 0 before the second.
    """

    def __init__(self, params: DetectorParams) -> None:
        self.params = params
        self._tracks: List[Track] = []
        self._numbers = 0
        self._periods: Deque[float] = deque(maxlen=_PERIODS)
        self.period = 0.0
        self._stamp: Optional[float] = None
        self._axes = slice(0, 2)  # of a place, in which spots are told apart

    def begin(self, stamp: float, camera: ImageTraits, motion: Optional[np.ndarray]) -> List[Expected]:
        """Begins the next image; call it before `update`.

        Args:
            stamp: [s] of the image, later than the last one's.
            motion: (3, 3) from the last image's pixels to this one's; None: the camera was stationary.

        Returns:
            Where confirmed spots should be by now, published ones first.
        """
        if self._stamp is not None:
            self._periods.append(stamp - self._stamp)
            self.period = median(self._periods)
        self._stamp, self._camera = stamp, camera
        gap = max(_GAP_TIME, _GAP_PERIODS * self.period)
        self._tracks = [track for track in self._tracks if stamp - track.stamp <= gap]
        for track in self._tracks if motion is not None else ():
            track.place[:2], track.dwell_position = cv2.perspectiveTransform(
                np.array([[track.place[:2], track.dwell_position]]), motion
            )[0]
        expected = [self._expect(track) for track in self._tracks if track.confirmed]
        return sorted(expected, key=lambda one: not one.published)

    def _expect(self, track: Track) -> Expected:
        elapsed = self._stamp - track.stamp
        u, v = (track.place + track.velocity * elapsed)[:2].tolist()
        reach = _SLACK_PX + 0.5 * elapsed * math.hypot(*track.velocity[:2])
        return Expected(u, v, reach, track.diameter, track.published)

    def update(self, spots: Sequence[Spot], tag: Any = None) -> List[Track]:
        """Adds the spots of the image that was begun, the most certain first; returns the track of each.

        Args:
            tag: of the image, for spots that are backfilled.
        """
        tracks = self._assign(spots)
        oldest = self._stamp - max(_RECALL_TIME, (self.params.confirm_frames + 1) * self.period)
        for spot, track in zip(spots, tracks):
            self._see(track, spot)
            track.unpublished = [earlier for earlier in track.unpublished if earlier.stamp >= oldest]
            if not track.confirmed:
                track.unpublished.append(BackfilledSpot(replace(spot, track=track.number), self._stamp, tag))
        self._choose(tracks)
        return tracks

    def _assign(self, spots: Sequence[Spot]) -> List[Track]:
        """Assigns a track to each spot: the nearest pairs within reach, else a new one."""
        if not spots:
            return []
        places = np.array([(spot.u, spot.v, *spot.floor) for spot in spots])
        axes = slice(0, 2) if math.isnan(places[0, 2]) else slice(2, 4)
        if axes != self._axes:
            self._tracks, self._axes = [], axes
        slack, speed = (
            (_SLACK, _MAX_SPEED) if axes.start else (_SLACK_PX, _MAX_SPEED * self._camera.diagonal / _DIAGONAL)
        )
        found: List[Optional[Track]] = [None] * len(spots)
        if self._tracks:
            last = np.array([track.place[axes] for track in self._tracks])
            elapsed = np.array([self._stamp - track.stamp for track in self._tracks])
            ahead = last + elapsed[:, None] * [track.velocity[axes] for track in self._tracks]
            near = cdist(places[:, axes], last) <= slack + speed * elapsed
            for row, column in zip(*linear_sum_assignment(np.where(near, cdist(places[:, axes], ahead), 1e9))):
                if near[row, column]:
                    found[row] = self._tracks[column]
        for row, place in enumerate(places):
            track = found[row]
            if track is None:
                self._numbers += 1
                found[row] = Track(self._numbers, place, self._stamp, self._stamp, place[:2].copy(), self._stamp)
                self._tracks.append(found[row])
            elif self._stamp > track.stamp:
                track.velocity = (place - track.place) / (self._stamp - track.stamp)
                track.place, track.stamp = place, self._stamp
                if math.hypot(*(place[:2] - track.dwell_position)) > _SLACK_PX:
                    track.dwell_position, track.dwelling_since = place[:2].copy(), self._stamp
        return found

    def _see(self, track: Track, spot: Spot) -> None:
        track.hits += 1
        track.diameter = spot.diameter
        if spot.tint is not None:
            track.light = spot.tint if track.light is None else track.light + spot.tint
        if track.hits < self.params.confirm_frames or track.confirmed:
            return
        # of a white glint hardly larger than a pixel one place of a Bayer pattern gets most, which looks like a colour;
        # in the mean over several images it does not
        shown = 0.0 if track.light is None else chroma(track.light)
        if self._stamp - track.created < _STEP_TIME:
            least = _VIVID
        else:
            least = _PALE if self._camera.mosaic else 0.0
        track.confirmed = self.params.confirm_frames <= 1 or shown >= least

    def _choose(self, tracks: Sequence[Track]) -> None:
        """Chooses the confirmed track to publish: the one that was, else the most certain."""
        if self.params.confirm_frames <= 1:
            for track in self._tracks:
                track.published = False
        confirmed = [track for track in tracks if track.confirmed]
        if confirmed and not any(track.published for track in self._tracks):
            confirmed[0].published = True
