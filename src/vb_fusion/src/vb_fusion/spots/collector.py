"""The point set of one interaction: which spots belong to it, and which are ignored and why."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import Dict, List, Optional

import numpy as np

from vb_core.parameters import Parameters, param

BORDER = "border"
SEED = "seed"


@dataclass(frozen=True)
class CollectorParams(Parameters):
    """Limits of the collection."""

    max_spots: int = param(60000, low=100, high=1000000)
    stamp_tolerance: float = param(0.05, "s", low=0.0, high=10.0)
    seen_timeout: float = param(0.5, "s", above=0.0, high=10.0)


@dataclass(frozen=True)
class FloorSpot:
    """One spot on the floor, in the map frame."""

    stamp: float  # [s] of the image
    x: float  # [m]
    y: float  # [m]
    camera: str
    confidence: float = 1.0
    mobile: bool = False  # seen by a camera on a robot


COLUMNS = 6


class SpotStore:
    """Stores spots in arrays of limited size.

    When they are full, every other spot is dropped, so that memory is bounded and no part of the drawing is lost.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._data = np.empty((min(256, limit), COLUMNS))
        self.kept = 0
        self.total = 0

    def append(self, spot: FloorSpot, camera: int) -> None:
        """Keeps a spot seen by camera number `camera`."""
        if self.kept == len(self._data):
            rows = self._data[::2] if self.kept >= self._limit else self._data
            self._data = np.empty((min(2 * self.kept, self._limit), COLUMNS))
            self._data[: len(rows)] = rows
            self.kept = len(rows)
        self._data[self.kept] = (spot.stamp, spot.x, spot.y, spot.confidence, camera, spot.mobile)
        self.kept += 1
        self.total += 1

    def clear(self) -> None:
        """Drops all."""
        self._data = np.empty((min(256, self._limit), COLUMNS))
        self.kept = self.total = 0

    @property
    def rows(self) -> np.ndarray:
        """(K, 6): stamp, x, y, confidence, camera, mobile; later spots do not change it."""
        rows = self._data[: self.kept]
        rows.flags.writeable = False
        return rows


@dataclass(frozen=True)
class Collection:
    """The spots so far; nothing that comes later changes the arrays."""

    interaction_id: str
    border: np.ndarray  # (K, 6): stamp [s], x [m], y [m], confidence, index of the camera, 1 if it is a mobile one
    seed: np.ndarray
    cameras: List[str]
    border_total: int
    seed_total: int


class Collector:
    """Collects spots in the states Border and Seed of one interaction.

    A change of state arrives late, and so do spots: what counts is the spot's own stamp against the stamps at
    which states were entered. No clock is read.
    """

    def __init__(self, params: Optional[CollectorParams] = None) -> None:
        self._params = params or CollectorParams()
        self.interaction_id = ""
        self.state = "default"
        self.ignored: Counter = Counter()
        self._entered = -math.inf
        self._cameras: List[str] = []
        self._last_seen: Dict[str, float] = {}
        self._stores = {BORDER: SpotStore(self._params.max_spots), SEED: SpotStore(self._params.max_spots)}

    def set_state(self, state: str, interaction_id: str, entered: float) -> bool:
        """Adopts a new state; returns whether a new interaction began.

        Args:
            state: "default", "border", "seed" or "guide".
            interaction_id: empty in Default. What was collected is kept until another id comes.
            entered: [s] when the state was entered.
        """
        fresh = bool(interaction_id) and interaction_id != self.interaction_id
        if fresh:
            self.interaction_id = interaction_id
            self.ignored = Counter()
            self._cameras = []
            for store in self._stores.values():
                store.clear()
        if state != self.state or fresh:
            self.state, self._entered = state, entered
        return fresh

    def add(self, spot: FloorSpot) -> str:
        """Adds a spot.

        Returns:
            "" if it was collected, else why it was ignored: "not_finite", "state" (no spots are wanted) or
            "before_state" (it was seen before the state was entered).
        """
        reason = self._rejection_reason(spot)
        # a jump back of the clock must not leave a camera seeing for ever
        self._last_seen[spot.camera] = spot.stamp
        if reason:
            self.ignored[reason] += 1
            return reason
        self.restore(self.state, spot)
        return ""

    def restore(self, state: str, spot: FloorSpot) -> None:
        """Adds a spot that was collected in "border" or "seed" before, whatever the state is now."""
        if state not in self._stores:
            return
        if spot.camera not in self._cameras:
            self._cameras.append(spot.camera)
        self._stores[state].append(spot, self._cameras.index(spot.camera))

    def _rejection_reason(self, spot: FloorSpot) -> str:
        if not all(math.isfinite(value) for value in (spot.stamp, spot.x, spot.y)):
            return "not_finite"
        if self.state not in self._stores:
            return "state"
        if spot.stamp < self._entered - self._params.stamp_tolerance:
            return "before_state"
        return ""

    def forget(self) -> None:
        """Drops all spots, but stays in the interaction."""
        for store in self._stores.values():
            store.clear()

    def cameras_seeing(self, now: float) -> List[str]:
        """Returns the names of the cameras that see the spot at a time [s]."""
        return sorted(
            camera for camera, stamp in self._last_seen.items() if abs(now - stamp) <= self._params.seen_timeout
        )

    @property
    def counts(self) -> tuple:
        """(border spots, seed spots, ignored spots)."""
        return self._stores[BORDER].total, self._stores[SEED].total, sum(self.ignored.values())

    def collection(self) -> Collection:
        """Returns what was collected so far."""
        border, seed = self._stores[BORDER], self._stores[SEED]
        return Collection(self.interaction_id, border.rows, seed.rows, list(self._cameras), border.total, seed.total)
