"""Tracks spots over time: assigns sightings to tracks, confirms tracks, and chooses the one that is published.

A track moves on at constant velocity in the image, and along with the image when the camera turns. Limits in seconds
never span fewer than a few images, so that a camera of two images a second works like one of sixty. The published track
stays published until it is lost, or until it rests while another track moves.

A light that stays in one place is a lamp, even if it blinks. So the time for which each place was lit is counted
independently of tracks. Counting goes on while the light blinks, is crossed by another one, or is lost and found again.
A stroke lights each of its places only for a moment, and they are soon forgotten.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace
from typing import Deque, List, Optional, Sequence

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from vb_laser_detect.detection.features import chroma
from vb_laser_detect.detection.stage_results import DetectionResult, ExpectedSpot, Motion, SearchedImage, Spot

_SLACK_PX = 12.0  # [px] by which noise alone may move a spot between two images
_BLINK = 1.5  # [s] a light that is absent for no longer than this counts as having stayed in its place
_MEMORY = 10.0  # time after which a place is forgotten, in multiples of the time for which it was lit
_MAX_SPEED = 1.6  # [diagonals of the image/s] of a spot: a wrist's flick, 8 m/s where the diagonal is 5 m
# [s], [images] without a sighting; a track survives the longer of the two: a passing leg, the dark half of a pointer's
# blinking, or two missing images of any camera
_GAP_TIME, _GAP_PERIODS = 0.35, 3.5
_RECALL_TIME = 1.0  # [s] sightings older than this are not published when their track is confirmed
_PERIODS = 15  # [images] over which the period is averaged
_VIVID = 0.4  # mean chroma of a laser's light on a floor; webcams show less, but other bright things even less
# mean chroma on a nearly white floor; that of white glints in Bayer images is lower over half a second
_PALE = 0.25
# [s] for which colourless light must last to be confirmed: a glint on a shoe, a watch or a cup lasts for less than a
# step, half a second. Nothing is lost, because the track's earlier spots are then published too
_STEP_TIME = 0.6
# [px] standard deviation by which light must have moved where it need not show colour: no hand holds a pointer so still, but
# paper and reflections that came to stay move only by the noise of the camera and its compression
_MIN_SPREAD = 0.25


@dataclass(eq=False)
class Track:
    """A spot that is tracked.

    Attributes:
        pixel, velocity: (2,) last position (u, v) [px], and velocity [px/s].
        created: [s] time of the first sighting.
        lit_s: [s] time for which its present place has been lit.
        unpublished: the spots before it was confirmed, oldest first.
    """

    number: int
    pixel: np.ndarray
    stamp: float
    created: float
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(2))
    hits: int = 0
    diameter: float = 0.0
    is_confirmed: bool = False
    is_published: bool = False
    lit_s: float = 0.0
    tint_sum: Optional[np.ndarray] = None  # of all its spots
    unpublished: List[Spot] = field(default_factory=list)


class SpotTracker:
    """Tracks the spots of one camera.

    Attributes:
        confirm_frames, max_dwell_time: see config/stationary.yaml; they may be changed between images.
        may_rest: see `SpotDetector`.
    """

    def __init__(self, confirm_frames: int, max_dwell_time: float, may_rest: bool = False) -> None:
        self.confirm_frames = confirm_frames
        self.max_dwell_time = max_dwell_time
        self.may_rest = may_rest
        self._tracks: List[Track] = []
        self._last_track_number = 0
        self._periods: Deque[float] = deque(maxlen=_PERIODS)
        self._period = 0.0  # [s] mean time between the last images; 0 before the second image
        self._stamp: Optional[float] = None
        self._lit_places = np.zeros((0, 4))  # each place: u, v [px], lit for [s], last lit at [s]

    def predict(self, stamp: float, motion: Motion = None) -> List[ExpectedSpot]:
        """Predicts where confirmed spots should be in a later image. Must be called before `update`.

        Args:
            stamp: [s] of the image.
            motion: since the last image.
        """
        if self._stamp is not None:
            self._periods.append(stamp - self._stamp)
            # the mean, because images may arrive in bursts; without the longest interval, which may be a pause
            typical_periods = sorted(self._periods)[:-1] or self._periods
            self._period = sum(typical_periods) / len(typical_periods)
        self._stamp = stamp
        gap = max(_GAP_TIME, _GAP_PERIODS * self._period)
        self._tracks = [track for track in self._tracks if stamp - track.stamp <= gap]
        lit_s, lit_at = self._lit_places[:, 2:].T
        self._lit_places = self._lit_places[lit_at + _BLINK + _MEMORY * lit_s >= stamp]
        if motion is not None:
            for place in [track.pixel for track in self._tracks] + list(self._lit_places):
                place[:2] = cv2.perspectiveTransform(place[None, None, :2], motion)[0, 0]
        return [self._expect(track) for track in self._tracks if track.is_confirmed]

    def _expect(self, track: Track) -> ExpectedSpot:
        elapsed = self._since(track)
        reach = _SLACK_PX + 0.5 * elapsed * math.hypot(*track.velocity)
        return ExpectedSpot((track.pixel + track.velocity * elapsed).tolist(), reach, 2.0 * track.diameter)

    def update(self, candidates: Sequence[Spot], searched: SearchedImage) -> DetectionResult:
        """Adds the candidates of the image for which `predict` was called, each blob once, except rejected ones."""
        candidates = _without_repetitions(candidates)
        self._diagonal = searched.diagonal
        self._mosaic = searched.picture.is_bayer
        spots = sorted((spot for spot in candidates if not spot.rejection), key=lambda spot: -spot.confidence)
        lit = [(replace(spot, stamp=self._stamp), self._record_light(spot)) for spot in spots]
        lamps = [replace(spot, rejection="lamp") for spot, lit_s in lit if lit_s > self.max_dwell_time]
        published_lamps = self._end_tracks(lamps)
        followed = [(spot, lit_s) for spot, lit_s in lit if lit_s <= self.max_dwell_time]
        tracks = self._assign([spot for spot, _ in followed])
        for track, (spot, lit_s) in zip(tracks, followed):
            self._add_sighting(track, spot, lit_s)
        self._choose_published_track(tracks)
        published = []
        judged = [candidate for candidate in candidates if candidate.rejection] + lamps
        for track, (spot, _) in zip(tracks, followed):
            reason = "lower_confidence" if track.is_confirmed else "unconfirmed"
            judged.append(replace(spot, track=track.number, rejection="" if track.is_published else reason))
            if track.is_published:
                published += [*track.unpublished, judged[-1]]
                track.unpublished = []
        return DetectionResult(published, judged, published_lamps)

    def _record_light(self, spot: Spot) -> float:
        """Records light at a spot's place, and returns the time [s] for which that place has been lit."""
        distances = np.hypot(self._lit_places[:, 0] - spot.u, self._lit_places[:, 1] - spot.v)
        if not (distances <= _SLACK_PX).any():
            self._lit_places = np.vstack([self._lit_places, (spot.u, spot.v, 0.0, self._stamp)])
            distances = np.append(distances, 0.0)
        place = self._lit_places[np.argmin(distances)]
        if self._stamp - place[3] <= _BLINK:
            place[2] += self._stamp - place[3]
        place[3] = self._stamp
        return float(place[2])

    def _end_tracks(self, lamps: Sequence[Spot]) -> int:
        """Ends the tracks of lights that turned out to be lamps, and returns how many of them had been published."""
        resting = [track for track in self._tracks if track.lit_s > _STEP_TIME]
        ended = [track for track in resting if any(math.dist(track.pixel, (s.u, s.v)) <= _SLACK_PX for s in lamps)]
        self._tracks = [track for track in self._tracks if track not in ended]
        return sum(track.is_published for track in ended)

    def _since(self, track: Track) -> float:
        """Returns the time [s] since a track was seen, at least a period, because images of a burst have close stamps."""
        return max(self._stamp - track.stamp, self._period)

    def _assign(self, spots: Sequence[Spot]) -> List[Track]:
        """Returns a track for each spot: the nearest one within reach, or else a new one."""
        places = np.reshape([(spot.u, spot.v) for spot in spots], (-1, 2))
        tracks: List[Optional[Track]] = [None] * len(spots)
        if self._tracks:
            positions = np.array([track.pixel for track in self._tracks])
            elapsed = np.array([self._since(track) for track in self._tracks])
            predicted = positions + elapsed[:, None] * [track.velocity for track in self._tracks]
            within_reach = cdist(places, positions) <= _SLACK_PX + _MAX_SPEED * self._diagonal * elapsed
            for row, column in zip(*linear_sum_assignment(np.where(within_reach, cdist(places, predicted), 1e9))):
                if within_reach[row, column]:
                    tracks[row] = self._tracks[column]
        for row, place in enumerate(places):
            track = tracks[row]
            if track is None:
                self._last_track_number += 1
                tracks[row] = Track(self._last_track_number, place, self._stamp, self._stamp)
                self._tracks.append(tracks[row])
            elif self._stamp > track.stamp:
                track.velocity = (place - track.pixel) / self._since(track)
                track.pixel, track.stamp = place, self._stamp
        return tracks

    def _add_sighting(self, track: Track, spot: Spot, lit_s: float) -> None:
        track.hits += 1
        track.diameter, track.lit_s = spot.diameter, lit_s
        if spot.tint is not None:
            track.tint_sum = spot.tint if track.tint_sum is None else track.tint_sum + spot.tint
        if track.hits >= self.confirm_frames and not track.is_confirmed:
            track.is_confirmed = self._is_laser(track)
        oldest = self._stamp - max(_RECALL_TIME, (self.confirm_frames + 1) * self._period)
        track.unpublished = [earlier for earlier in track.unpublished if earlier.stamp >= oldest]
        if not track.is_confirmed:
            track.unpublished.append(replace(spot, track=track.number))

    def _is_laser(self, track: Track) -> bool:
        """Returns whether a track has shown a laser's colour; or else has lasted, and shown some colour or moved."""
        if self.confirm_frames <= 1:
            return True
        # a white glint on one pixel of a Bayer pattern looks coloured; its mean over several images does not
        mean_chroma = 0.0 if track.tint_sum is None else chroma(track.tint_sum)
        if mean_chroma >= _VIVID:
            return True
        if self._stamp - track.created < _STEP_TIME:
            return False
        if self._mosaic:
            return mean_chroma >= _PALE
        spread = np.std([(spot.u, spot.v) for spot in track.unpublished], axis=0)
        return self.may_rest or math.hypot(*spread) > _MIN_SPREAD

    def _choose_published_track(self, tracks: Sequence[Track]) -> None:
        """Chooses the confirmed track to publish: the one already published, else the most certain.

        A moving track replaces a resting one, which may be a lamp, so that a drawing hand is not kept waiting.
        """
        confirmed = [track for track in tracks if track.is_confirmed]
        published = next((track for track in self._tracks if track.is_published), None)
        # tracks that were elsewhere for most of their time
        moving = [track for track in confirmed if track.lit_s < 0.5 * (self._stamp - track.created)]
        may_change = self.confirm_frames <= 1 or bool(moving and published and published.lit_s > _STEP_TIME)
        if published and may_change:
            published.is_published = False
        if confirmed and (may_change or not published):
            (moving or confirmed)[0].is_published = True


def _without_repetitions(candidates: Sequence[Spot]) -> List[Spot]:
    """Returns the candidates, each blob only once: several regions may have led to the same blob."""
    kept: List[Spot] = []
    for spot in candidates:
        similar = (earlier for earlier in kept if bool(earlier.rejection) == bool(spot.rejection))
        if not any(math.hypot(spot.u - earlier.u, spot.v - earlier.v) < 2.0 for earlier in similar):
            kept.append(spot)
    return kept
