"""Records where cameras saw the spot in an interaction, and decides whether a robot follows it or is sent to it.

A robot's driver follows the spot; the dispatcher sends robots to it. Both decide by this class, from the same
sightings, so that they never act at the same time and never wait for each other.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Deque, Dict, Iterable, List, NamedTuple, Optional, Set, Tuple

import numpy as np

from vb_core.interaction_tables import BORDER, DEFAULT, SEED, State

TARGET_WINDOW = 0.3  # [s] of sightings that give the spot's position
MIN_TARGET_SIGHTINGS = 3  # so that one false spot does not move a robot
SPARSE_TARGET_WINDOW = 3.0  # [s] from which the newest MIN_TARGET_SIGHTINGS count if TARGET_WINDOW has fewer
STATIONARY_RECENCY = 1.0  # [s] a stationary camera whose last sighting is this much older than the newest still sees it
LOST_TIMEOUT = 0.7  # [s] without a sighting after which the spot is lost; cameras miss single images
MIN_STRAIGHTNESS = 0.7  # cosine of the largest turn that still counts as straight
VELOCITY_WINDOW = 0.6  # [s] of sightings that give the direction in which the line continues
MIN_VELOCITY_SIGHTINGS = 6  # two in each third of VELOCITY_WINDOW, so that one false spot has no effect
MIN_SPEED = 0.1  # [m/s] below which a spot counts as resting
RUN_GAP = 2.0  # [s] without the spot after which another robot's camera may take over
MIN_CONFIDENCE = 0.4  # of a spot on which robots act; the laser has 0.6 and more, reflections have 0.3
FOLLOW_DELAY = 1.0  # [s] in which a stationary camera may see the spot too; if none does, the robot follows it


class Sighting(NamedTuple):
    """A sighting: time [s], the spot's position (x, y) [m] in the map frame, camera, whether on a robot, confidence."""

    stamp: float
    position: Tuple[float, float]
    camera: str
    mobile: bool
    confidence: float = 1.0


class SpotSightings:
    """Collects the sightings of one interaction, and decides which robot acts on them and how.

    In Guide, only one robot acts: that whose camera has seen the spot longest without a pause follows it. In Border and
    Seed, a robot is sent once a stationary camera has seen the spot in this interaction. Until then, it follows.

    Args:
        mobile_cameras: names of cameras on robots, known before any of them has seen a spot.
    """

    def __init__(self, mobile_cameras: Iterable[str] = ()) -> None:
        self._mobile_names: Set[str] = set(mobile_cameras)
        self._recent: Deque[Sighting] = deque(maxlen=400)
        self._interaction = ""
        self._entered = 0.0
        self.state = DEFAULT
        self.has_stationary_sighting = False
        self.first_mobile_stamp: Optional[float] = None
        # for each robot's camera: start and end [s] of its last sightings without a pause, in this state
        self._runs: Dict[str, Tuple[float, float]] = {}
        self._follower: Optional[str] = None  # the camera of the robot that followed last in this state

    @property
    def key(self) -> Tuple[str, State]:
        """A key that changes with every change of interaction or state."""
        return self._interaction, self.state

    def set_state(self, state: State, interaction: str, entered: float) -> None:
        """Sets the interaction's state."""
        if interaction != self._interaction or state == DEFAULT:
            self.has_stationary_sighting = False
            self.first_mobile_stamp = None
        if (interaction, state) != self.key:
            self._recent.clear()
            self._runs.clear()
            self._follower = None
        self.state, self._interaction, self._entered = state, interaction, entered

    def add(self, sighting: Sighting) -> bool:
        """Adds a sighting. Returns whether it counts: it must be confident and from this state, in which robots act."""
        if sighting.mobile:
            self._mobile_names.add(sighting.camera)
        if not self.state.robots_act or sighting.stamp < self._entered or sighting.confidence < MIN_CONFIDENCE:
            return False
        self._recent.append(sighting)
        if not sighting.mobile:
            self.has_stationary_sighting = True
            return True
        if self.first_mobile_stamp is None:
            self.first_mobile_stamp = sighting.stamp
        since, until = self._runs.get(sighting.camera, (sighting.stamp, sighting.stamp))
        if abs(sighting.stamp - until) > RUN_GAP:
            since = until = sighting.stamp  # the spot was lost, or time has jumped back
        self._runs[sighting.camera] = min(since, sighting.stamp), max(until, sighting.stamp)
        self._update_follower(sighting.stamp)
        return True

    def should_dispatch(self) -> bool:
        """Returns whether to send a robot to a position from which its camera sees the spot."""
        return bool(self.state.collects) and self.has_stationary_sighting

    def should_follow(self, camera: str, now: float) -> bool:
        """Returns whether the robot with this camera should follow the spot."""
        if self._update_follower(now) != camera or not self.state.robots_act:
            return False
        if self.state.guides:
            return True
        if self.has_stationary_sighting or self.first_mobile_stamp is None:
            return False
        return now - self.first_mobile_stamp >= FOLLOW_DELAY

    def _update_follower(self, now: float) -> Optional[str]:
        """Returns the robot camera that has seen the spot longest without a pause. If none sees it, returns the last.

        The images' own times count, not when they arrive, so that all robots' drivers choose the same camera.
        """
        seeing = {camera: run for camera, run in self._runs.items() if abs(now - run[1]) <= RUN_GAP}
        if seeing:
            self._follower = min(seeing, key=lambda camera: (seeing[camera][0], camera))
        return self._follower

    def add_contributors(self, interaction: str, cameras: Iterable[str]) -> None:
        """Adds cameras that contributed to an interaction, even before this program started."""
        is_current = interaction == self._interaction and self.state != DEFAULT
        if is_current and not self._mobile_names.issuperset(cameras):
            self.has_stationary_sighting = True

    def forget_after(self, now: float) -> None:
        """Removes sightings from after time `now` [s], which are left when time jumps back."""
        remaining = [sighting for sighting in self._recent if sighting.stamp <= now + 1.0]
        self._recent = deque(remaining, maxlen=self._recent.maxlen)

    def newest(self) -> Optional[Sighting]:
        """Returns the newest sighting of any camera in this state, or None before the first."""
        return max(self._recent, key=lambda sighting: sighting.stamp) if self._recent else None

    def _since(self, stamp: float) -> List[Sighting]:
        """Returns the sightings from a time [s] on, in the order of their arrival."""
        return [sighting for sighting in self._recent if sighting.stamp >= stamp]

    def seen_by_stationary(self, now: float) -> bool:
        """Returns whether a stationary camera sees the spot. In Seed, one sighting is enough, as the seed is still."""
        newest = self.newest()
        stamps = [sighting.stamp for sighting in self._recent if not sighting.mobile]
        if newest is None or not stamps:
            return False
        if self.state == SEED:
            return True
        is_recent = newest.stamp - max(stamps) <= STATIONARY_RECENCY
        return is_recent and self.time_since_seen(now) <= LOST_TIMEOUT

    def time_since_seen(self, now: float) -> float:
        """Returns the time [s] since a camera last saw a border's spot: 0 before the first sighting, and for a seed."""
        newest = self.newest()
        if newest is None or self.state != BORDER:
            return 0.0
        return max(0.0, now - newest.stamp)

    def target(self) -> Optional[np.ndarray]:
        """Returns the spot's last position (2,) [m], the median of its last sightings, or None if there are too few."""
        newest = self.newest()
        if newest is None:
            return None
        sightings = self._since(newest.stamp - TARGET_WINDOW)
        if len(sightings) < MIN_TARGET_SIGHTINGS:
            longer = self._since(newest.stamp - SPARSE_TARGET_WINDOW)
            sightings = sorted(longer, key=lambda sighting: sighting.stamp)[-MIN_TARGET_SIGHTINGS:]
        if len(sightings) < MIN_TARGET_SIGHTINGS:
            return None
        return np.median([sighting.position for sighting in sightings], axis=0)

    def velocity(self) -> Optional[np.ndarray]:
        """Measures the spot's velocity (2,) [m/s] over VELOCITY_WINDOW. Returns None if it rests or has just turned.

        Only the camera that saw the spot last counts, because the positions from two cameras differ by centimetres.
        """
        newest = self.newest()
        if newest is None:
            return None
        recent = self._since(newest.stamp - VELOCITY_WINDOW)
        samples = [(sighting.stamp, *sighting.position) for sighting in recent if sighting.camera == newest.camera]
        if len(samples) < MIN_VELOCITY_SIGHTINGS:
            return None
        parts = np.array_split(np.array(sorted(samples)), 3)
        thirds = np.array([np.median(part, axis=0) for part in parts])  # (3, 3) of [s], [m], [m]
        first, second = np.diff(thirds[:, 1:], axis=0)
        seconds, *displacement = thirds[2] - thirds[0]
        if math.hypot(*displacement) < MIN_SPEED * max(seconds, 0.5 * VELOCITY_WINDOW):
            return None
        lengths = np.linalg.norm(first) * np.linalg.norm(second)
        is_straight = np.dot(first, second) >= MIN_STRAIGHTNESS * lengths
        return np.array(displacement) / seconds if is_straight else None
