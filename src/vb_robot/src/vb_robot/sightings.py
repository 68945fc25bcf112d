"""What is known about the spot in the interaction that goes on: where it is, which way it moves, who saw it."""
from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Deque, Dict, Iterable, Optional, Set, Tuple

import numpy as np

DEFAULT, BORDER, SEED, GUIDE = range(4)  # the values of vb_msgs/InteractionState
RUN_GAP = 2.0  # [s] a robot that has not seen the spot for so long does not lead any more


@dataclass(frozen=True)
class Sighting:
    """One spot: when [s], where (x, y) [m] in the map frame, which camera, whether that camera is on a robot."""

    stamp: float
    position: Tuple[float, float]
    camera: str
    mobile: bool


class Sightings:
    """Collects the sightings of one interaction.

    Args:
        window_s: [s] how long a sighting counts for the spot's present place.
        mobile_cameras: names known to be cameras on robots, before any of them has seen a spot.
    """

    def __init__(self, window_s: float = 1.0, mobile_cameras: Iterable[str] = ()) -> None:
        self._window = window_s
        self._mobile_names: Set[str] = set(mobile_cameras)
        self._recent: Deque[Sighting] = deque(maxlen=400)
        # by camera on a robot: since when and until when it sees the spot [s]
        self._runs: Dict[str, Tuple[float, float]] = {}
        self._interaction = ""
        self._entered = 0.0
        self.state = DEFAULT
        self.stationary_seen = False
        self.first_mobile: Optional[float] = None

    @property
    def key(self) -> Tuple[str, int]:
        """Changes with every change of interaction or state."""
        return self._interaction, self.state

    def set_state(self, state: int, interaction: str, entered: float) -> bool:
        """Takes over the interaction's state; gives whether it changed."""
        changed = (state, interaction) != (self.state, self._interaction)
        if interaction != self._interaction or state == DEFAULT:
            self.stationary_seen = False
            self.first_mobile = None
        if changed:
            self._recent.clear()
            self._runs.clear()
        self.state, self._interaction, self._entered = state, interaction, entered
        return changed

    def add(self, sighting: Sighting) -> None:
        """Takes a sighting; those from before the present state began, and those in Default, do not count."""
        if sighting.mobile:
            self._mobile_names.add(sighting.camera)
        if self.state == DEFAULT or sighting.stamp < self._entered:
            return
        self._recent.append(sighting)
        if not sighting.mobile:
            self.stationary_seen = True
            return
        if self.first_mobile is None:
            self.first_mobile = sighting.stamp
        since, until = self._runs.get(sighting.camera, (sighting.stamp, sighting.stamp))
        if abs(sighting.stamp - until) > RUN_GAP:
            since = sighting.stamp
        self._runs[sighting.camera] = (since, max(until, sighting.stamp) if since < sighting.stamp else sighting.stamp)

    def leader(self, now: float) -> Optional[str]:
        """The camera on a robot that has seen the spot longest without a pause: two robots do not follow one spot."""
        seeing = {camera: run for camera, run in self._runs.items() if abs(now - run[1]) <= RUN_GAP}
        return min(seeing, key=lambda camera: (seeing[camera][0], camera)) if seeing else None

    def contributed(self, cameras: Iterable[str]) -> None:
        """Learns of the cameras that contributed before this program was started."""
        if self.state != DEFAULT and any(camera not in self._mobile_names for camera in cameras):
            self.stationary_seen = True

    def forget_after(self, now: float) -> None:
        """Drops sightings from the future: time has jumped back."""
        self._recent = deque((s for s in self._recent if s.stamp <= now + 1.0), maxlen=self._recent.maxlen)

    def newest(self) -> Optional[Sighting]:
        """The newest sighting of any camera in this state."""
        return max(self._recent, key=lambda s: s.stamp) if self._recent else None

    def watched(self, now: float, patience: float = 3.0) -> bool:
        """Whether a stationary camera sees the spot, or did when it was seen last.

        The seed does not move: once seen is enough. A border's spot that nobody sees any more, for longer than a
        patience [s], is not watched.
        """
        newest = self.newest()
        stamps = [s.stamp for s in self._recent if not s.mobile]
        if newest is None or not stamps:
            return False
        return self.state == SEED or (newest.stamp - max(stamps) <= self._window and now - newest.stamp <= patience)

    def gone_on(self, now: float, speed: float, most: float) -> float:
        """[m] by which a border's spot that nobody sees any more has probably moved on since it was seen last.

        Cameras lose a spot that leaves their image, so the place where it was last is one that they see well.

        Args:
            speed: [m/s] at which people draw; most: [m]
        """
        newest = self.newest()
        if newest is None or self.state != BORDER or now - newest.stamp < 0.5 * self._window:
            return 0.0
        return min(speed * (now - newest.stamp), most)

    def target(self, min_sightings: int = 3) -> Optional[np.ndarray]:
        """(2,) [m] where the spot was last: the median of the last window before the newest sighting.

        None before there are `min_sightings` of them: one false spot sends no robot.
        """
        newest = self.newest()
        if newest is None:
            return None
        last = [s.position for s in self._recent if s.stamp >= newest.stamp - 0.3 * self._window]
        if len(last) < min_sightings:
            last = [s.position for s in self._recent if s.stamp >= newest.stamp - self._window]
        return np.median(np.array(last), axis=0) if len(last) >= min_sightings else None

    def direction(self, min_speed: float = 0.05) -> Optional[np.ndarray]:
        """(2,) unit vector along which the spot moved over the window; None if it moved too little to tell."""
        newest = self.newest()
        if newest is None:
            return None
        recent = [s for s in self._recent if s.stamp >= newest.stamp - self._window]
        times = np.array([s.stamp for s in recent])
        if len(recent) < 6 or np.ptp(times) < 0.3 * self._window:
            return None
        middle = np.median(times)
        places = np.array([s.position for s in recent])
        early, late = times <= middle, times > middle
        if not late.any():
            return None
        step = np.median(places[late], axis=0) - np.median(places[early], axis=0)
        seconds = float(np.median(times[late]) - np.median(times[early]))
        length = float(np.linalg.norm(step))
        return step / length if seconds > 0 and length / seconds >= min_speed else None
