"""Confirms spots over several frames."""
from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, List, Optional, Sequence, Tuple

import numpy as np

from vb_laser_detect.colour import chroma

# [m] or [px]: what noise alone may move a spot between two frames, in the unit of the positions
SLACK_M = 0.05
SLACK_PX = 12.0
_RECALL_S = 1.0  # older sightings of what is confirmed at last are not worth telling


# tracks are told apart by what they are, not by where they lie
@dataclass(eq=False)
class _Track:
    position: np.ndarray
    stamp: float
    hits: int
    confirmed: bool = False
    tint: Optional[np.ndarray] = None  # the sum over its sightings, as far as it was measured
    waiting: List[Tuple[float, Any]] = field(default_factory=list)  # stamps and sightings that nobody was told of yet


class SpotTracker:
    """Lets a spot pass once it was seen in enough frames, without a jump that no hand can make.

    Args:
        confirm_frames: number of frames a spot must be seen in; 1 lets everything pass at once.
        max_speed: [m/s] or [px/s], in the unit of the positions: how fast a spot may move.
        max_gap_s: [s] how long a spot may be hidden without having to be confirmed again.
        slack: how far noise alone may move it.
        min_chroma: how coloured its light must be in the mean over its frames. Of a glint hardly larger than a pixel
            one place of a Bayer pattern gets most, which looks like a colour; but as it moves, another does.

    Attributes:
        recalled: of each of the last frame's N spots, the sightings of earlier frames that this frame confirmed, the
            oldest first.
    """

    def __init__(
        self, confirm_frames: int, max_speed: float, max_gap_s: float, slack: float, min_chroma: float = 0.0
    ) -> None:
        self.confirm_frames = confirm_frames
        self.max_speed = max_speed
        self.max_gap_s = max_gap_s
        self.slack = slack
        self.min_chroma = min_chroma
        self.recalled: List[List[Any]] = []
        self._tracks: List[_Track] = []

    def reset(self) -> None:
        """Forgets every spot."""
        self._tracks, self.recalled = [], []

    def update(
        self,
        positions: np.ndarray,
        stamp: float,
        sightings: Optional[Sequence[Any]] = None,
        tints: Optional[Sequence[Optional[np.ndarray]]] = None,
    ) -> List[bool]:
        """Takes in the spots of one frame.

        Args:
            positions: (N, 2) in [m] on the floor or [px], always the same unit; the most certain first.
            stamp: [s] time of the frame; one before the last frame's starts anew.
            sightings: N things, what `recalled` gives back of those that are confirmed later.
            tints: N times each channel's part in its light (`colour.tint_of`), None where it was not measured; None if
                light of every colour may be a spot.

        Returns:
            N times whether the spot is confirmed.
        """
        if any(track.stamp > stamp for track in self._tracks):
            self.reset()
        self._tracks = [track for track in self._tracks if stamp - track.stamp <= self.max_gap_s]
        self.recalled = []
        confirmed, free = [], list(self._tracks)
        for index, position in enumerate(np.asarray(positions, dtype=float).reshape(-1, 2)):
            track = self._nearest(position, stamp, free)
            if track is None:
                track = _Track(position, stamp, 0)
                self._tracks.append(track)
            else:
                free.remove(track)
            track.position, track.stamp = position, stamp
            tint = tints[index] if tints is not None else None
            if tint is not None:
                track.tint = tint if track.tint is None else track.tint + tint
            # where a confirmed spot should be colour is not asked: that confirms no other
            track.hits += tints is None or tint is not None
            track.confirmed = track.confirmed or self._enough(track)
            confirmed.append(track.confirmed)
            self.recalled.append([])
            if track.confirmed:
                self.recalled[-1] = [sighting for when, sighting in track.waiting if stamp - when <= _RECALL_S]
                track.waiting = []
            elif sightings is not None:
                track.waiting.append((stamp, sightings[index]))
        return confirmed

    def _enough(self, track: _Track) -> bool:
        coloured = track.tint is None or chroma(track.tint) >= self.min_chroma
        return track.hits >= self.confirm_frames and coloured

    def _nearest(self, position: np.ndarray, stamp: float, tracks: List[_Track]) -> Optional[_Track]:
        best, least = None, np.inf
        for track in tracks:
            distance = float(np.linalg.norm(position - track.position))
            if distance <= self.slack + self.max_speed * (stamp - track.stamp) and distance < least:
                best, least = track, distance
        return best
