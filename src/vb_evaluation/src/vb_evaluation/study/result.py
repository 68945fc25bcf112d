"""The identity and the results of a run."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, NamedTuple, Optional, Tuple

import numpy as np
from shapely.geometry import Point, Polygon

from vb_core.grid_map import GridMap
from vb_evaluation.study.people import Traits
from vb_sim.room.world import Scenario, World

FALSE_M = 0.3  # [m] from the true spot beyond which a reported one is something else


@dataclass(frozen=True)
class Task:
    """Which run it is; with the study it is all that a run depends on."""

    participant: int
    scenario: str
    method: str


class SeenSpot(NamedTuple):
    """One spot as a camera reported it."""

    stamp: float
    position: Tuple[float, float]
    camera: str
    mobile: bool


class SavedBorder(NamedTuple):
    """The saved border."""

    points: np.ndarray
    seed: Tuple[float, float]
    closed: bool


@dataclass(frozen=True)
class Result:
    """The results of a run.

    Attributes:
        task, traits: what was run, and who it was.
        world, scenario: as they were, with this person's place to stand.
        prior, posterior: maps as the recorder stores them.
        truth: (H, W) bool, the cells to restrict.
        records: of all interactions of the run as the interaction manager logs them, those that were cancelled too.
        border: what was saved; None if nothing was.
        outcome, reason, tries: how it went for the person.
        spots: every spot that a camera reported; false_spots: how many of them were farther than FALSE_M from the true one.
        left_out: images that were not sent.
        path: (N, 2) [m] where the first robot was.
        collisions, goals: of all robots.
    """

    task: Task
    traits: Traits
    world: World
    scenario: Scenario
    prior: GridMap
    posterior: GridMap
    truth: np.ndarray
    records: Tuple[Dict[str, Any], ...]
    border: Optional[SavedBorder]
    outcome: str
    reason: str
    tries: int
    spots: Tuple[SeenSpot, ...]
    false_spots: int
    left_out: int
    path: np.ndarray
    collisions: int
    goals: int

    @property
    def saved(self) -> bool:
        """Whether a border was saved."""
        return self.border is not None

    @property
    def seed_is_right(self) -> bool:
        """Whether the saved seed point is in the region to restrict."""
        return self.border is not None and bool(Polygon(self.scenario.region).contains(Point(self.border.seed)))
