"""The point set of one interaction: which spots belong to it, and which are ignored and why."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, replace
from typing import Dict, List, Optional, Set, Tuple

import numpy as np

from vb_core.interaction_tables import BORDER, DEFAULT, STATES, State, SEED

MAX_SPOTS = 60_000  # spots kept per state, as many as four cameras at 25 Hz see in ten minutes
STAMP_TOLERANCE = 0.05  # [s] by which a spot may be older than the state, about one frame of a camera
CLOCK_STEP = 2.0  # [s] a camera's spots arrive in order: if its stamps go back by more, its clock was set back
MAX_CLOCK_ERROR = 60.0  # [s] a camera whose clock is off by more is reported here, smaller errors by camera_poses


@dataclass(frozen=True)
class FloorSpot:
    """One spot on the floor, in the map frame."""

    stamp: float  # [s] of the image
    x: float  # [m]
    y: float  # [m]
    camera: str
    confidence: float = 1.0
    mobile: bool = False  # seen by a camera on a robot


# how spots are stored: the columns have the names of `extract_border`'s arguments, and a camera is an index
SPOT = np.dtype([("points", float, 2), ("stamps", float), ("cameras", int), ("confidences", float), ("mobile", bool)])


class SpotStore:
    """Stores at most MAX_SPOTS spots.

    When it is full, it drops every other spot of each camera. So no part of the drawing and no camera is lost.
    """

    def __init__(self) -> None:
        self.total = 0  # spots that were appended
        self._spots = np.empty(MAX_SPOTS, SPOT)
        self._count = 0

    def append(self, spot: FloorSpot, camera: int) -> None:
        """Keeps a spot seen by the camera of this index."""
        if self._count == len(self._spots):
            self._drop_every_other()
        self._spots[self._count] = ((spot.x, spot.y), spot.stamp, camera, spot.confidence, spot.mobile)
        self._count += 1
        self.total += 1

    def _drop_every_other(self) -> None:
        kept = np.ones(len(self._spots), dtype=bool)
        for camera in np.unique(self._spots["cameras"]):
            kept[np.flatnonzero(self._spots["cameras"] == camera)[1::2]] = False
        self._count = np.count_nonzero(kept)
        self._spots[: self._count] = self._spots[kept]

    @property
    def spots(self) -> np.ndarray:
        """A copy (K,) of the type SPOT, in the order of arrival. Later spots do not change it."""
        return self._spots[: self._count].copy()


@dataclass(frozen=True)
class CollectedSpots:
    """The spots of an interaction so far. Later spots do not change the arrays.

    Attributes:
        state: the interaction's state.
        border, seed: (K,) of the type SPOT, in the order of their arrival.
        cameras: names of the cameras, by their indices.
        counts, may_clear: those of the `SpotCollector`.
    """

    interaction_id: str
    state: State
    border: np.ndarray
    seed: np.ndarray
    cameras: List[str]
    counts: Tuple[int, int, int]
    may_clear: bool


class CameraClocks:
    """Corrects the stamps of cameras whose clocks are set back while somebody draws, in one state of the interaction."""

    def __init__(self) -> None:
        self._set_back: Dict[str, float] = {}  # [s] by how much each camera's clock was set back
        self._previous: Dict[str, float] = {}  # [s] each camera's last stamp
        self._newest: Dict[str, float] = {}  # [s] the corrected stamp of each camera's last collected spot

    def correct(self, camera: str, stamp: float) -> Optional[float]:
        """Returns the stamp that the camera's clock would have given if it had not been set back.

        Returns None if it is well before the camera's previous stamp, as in an old message or just after a setback.
        """
        previous = self._previous.get(camera, -math.inf)
        self._previous[camera] = stamp
        if stamp < previous - CLOCK_STEP:
            return None
        set_back = self._set_back.get(camera, 0.0)
        setbacks = self._set_back.values()
        newest_of_all = max(self._newest.values(), default=-math.inf)
        step = self._newest.get(camera, newest_of_all) - stamp
        was_set_back_further = step - set_back > CLOCK_STEP
        if was_set_back_further and camera in self._newest:
            # cameras on one computer share its clock, and the camera with the newest spot gives the best estimate
            similar = [setback for setback in setbacks if abs(setback - step) < CLOCK_STEP]
            set_back = max([step, *similar])
        elif was_set_back_further:
            # it is the camera's first spot, but other cameras have later stamps: its clock was set back as theirs were
            sufficient = [setback for setback in setbacks if setback > step - CLOCK_STEP]
            set_back = min(sufficient, default=set_back)
        self._set_back[camera] = set_back
        return stamp + set_back

    def record_stamp(self, camera: str, corrected_stamp: float) -> None:
        """Remembers the corrected stamp of a spot that was collected. Later stamps continue from it."""
        self._newest[camera] = corrected_stamp


class SpotCollector:
    """Collects spots in the states Border and Seed of one interaction.

    Changes of state arrive late, and so do spots. Therefore each spot's own stamp is compared with the time at which
    the state was entered. If a clock is set back while somebody draws, the later stamps are corrected. A camera whose
    clock is off is ignored and reported.

    Attributes:
        is_incomplete: whether a part of the drawing is missing, so that its border would differ from what was drawn.
        may_clear: whether the drawing is over and was not saved, so that its spots may be dropped.
        ignored: number of ignored spots, by the reason.
        faults: pairs of the code of a fault and the camera that has it.
    """

    def __init__(self) -> None:
        self.state = DEFAULT
        self.is_incomplete = False
        self._heard_state = False
        self._entered = -math.inf
        self._last_seen: Dict[str, float] = {}
        self._clocks = CameraClocks()
        self._begin("")

    def set_state(self, state: State, interaction_id: str, entered: float, outcome: str = "") -> bool:
        """Adopts a new state, and returns whether a new interaction began.

        Args:
            interaction_id: empty in Default. What was collected is kept until another id arrives.
            entered: [s] time at which the state was entered.
            outcome: outcome of the last interaction that ended.
        """
        is_new = bool(interaction_id) and interaction_id != self.interaction_id
        if is_new:
            self.is_incomplete = not self._heard_state  # the interaction began before this collector existed
            self._begin(interaction_id)
        self._heard_state = True
        if state != self.state or is_new:
            self.may_clear = False
            if state == DEFAULT:
                # every interaction that ends has an outcome, unless the interaction manager restarted during it
                self.is_incomplete = any(self.counts[:2]) and not outcome
                self.may_clear = self.is_incomplete or outcome not in ("", "saved")
            self.state = state
            self._entered = entered
            self._clocks = CameraClocks()
        return is_new

    def _begin(self, interaction_id: str) -> None:
        self.interaction_id = interaction_id
        self.ignored: Counter = Counter()
        self.faults: Set[Tuple[str, str]] = set()
        self._cameras: Dict[str, int] = {}  # index by name
        self.clear()

    def ignore_frame(self, camera: str) -> None:
        """Counts a camera's spot that is not in the map frame."""
        self.faults.add(("spots_wrong_frame", camera))
        self._ignore("frame")

    def _ignore(self, reason: str) -> str:
        self.ignored[reason] += 1
        return reason

    def add(self, spot: FloorSpot, now: float = math.nan) -> str:
        """Adds a spot that arrives at the time `now` [s].

        Returns:
            "" if it was collected, else why it was ignored: "not_finite", "state" (no spots are wanted), "clock" (its
            stamp is far later than its arrival, or well before the camera's previous stamp) or "before_state" (it was
            seen before the state was entered).
        """
        # an ignored spot counts too, or a camera whose clock was set back would count as seeing the spot for ever
        self._last_seen[spot.camera] = spot.stamp
        if not all(math.isfinite(value) for value in (spot.stamp, spot.x, spot.y)):
            return self._ignore("not_finite")
        if not self.state.collects:
            return self._ignore("state")
        if spot.stamp > now + MAX_CLOCK_ERROR:
            self.faults.add(("camera_clock_off", spot.camera))
            return self._ignore("clock")
        stamp = self._clocks.correct(spot.camera, spot.stamp)
        if stamp is None:
            return self._ignore("clock")
        if stamp < self._entered - STAMP_TOLERANCE:
            if now - spot.stamp > MAX_CLOCK_ERROR:
                self.faults.add(("camera_clock_off", spot.camera))
            return self._ignore("before_state")
        self._clocks.record_stamp(spot.camera, stamp)
        camera = self._cameras.setdefault(spot.camera, len(self._cameras))
        self._stores[self.state.collects].append(replace(spot, stamp=stamp), camera)
        return ""

    def clear(self) -> None:
        """Drops all spots, but stays in the interaction."""
        self.may_clear = False
        self._stores = {state.collects: SpotStore() for state in STATES.values() if state.collects}

    def cameras_seeing(self, now: float, timeout: float) -> List[str]:
        """Returns the names of the cameras that saw the spot within `timeout` [s] of the time `now` [s]."""
        return sorted(camera for camera, stamp in self._last_seen.items() if abs(now - stamp) <= timeout)

    @property
    def counts(self) -> Tuple[int, int, int]:
        """The numbers of border spots and of seed spots, stored or not, and the number of ignored spots."""
        border, seed = self._stores[BORDER.collects], self._stores[SEED.collects]
        return border.total, seed.total, sum(self.ignored.values())

    def snapshot(self) -> CollectedSpots:
        """Returns the spots collected so far."""
        border, seed = (self._stores[state.collects].spots for state in (BORDER, SEED))
        cameras = list(self._cameras)
        return CollectedSpots(self.interaction_id, self.state, border, seed, cameras, self.counts, self.may_clear)
