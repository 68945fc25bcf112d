"""A run: its task, its outcome, its measures (paper, Sect. 5.5), and what explains them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, Optional, Tuple

import numpy as np
from shapely.geometry import Point, Polygon

from vb_core.grid_map import FREE, GridMap
from vb_evaluation import metrics
from vb_evaluation.report.data import MEASURES, STATES, TIMES
from vb_sim.room.world import Scenario

FURTHER = tuple(
    "outcome reason seed_is_right pointed_right tries spots robot_collisions jaccard_enclosed too_bright".split()
)
COLUMNS = (*MEASURES, *FURTHER)


@dataclass(frozen=True)
class RunTask:
    """Which run it is; with the study it is all that a run depends on."""

    participant: int
    scenario: str
    method: str


@dataclass(frozen=True)
class Result:
    """The results of a run.

    Attributes:
        scenario: as it was, with this person's place to stand.
        prior, posterior: the map without and with borders.
        truth: (H, W) bool, the cells to restrict.
        records: of all interactions of the run as the interaction manager logs them, those that were cancelled too.
        seed: (x, y) [m] of the border that was saved; None if none was.
        pointed: (x, y) [m] where the person meant to point at the seed, if it came so far; a drawn mistake is in it.
        outcome, reason, tries: how it went for the person.
        spots: LaserSpot messages, every spot that a camera reported.
        path: (N, 2) [m] where the first robot was.
        collisions: of all robots.
        too_bright: whether a ceiling camera was, by the lab's own check, before anybody came.
    """

    scenario: Scenario
    prior: GridMap
    posterior: GridMap
    truth: np.ndarray
    records: Tuple[Dict[str, Any], ...]
    seed: Optional[Tuple[float, float]]
    pointed: Tuple[float, float]
    outcome: str
    reason: str
    tries: int
    spots: Tuple[Any, ...]
    path: np.ndarray
    collisions: int
    too_bright: bool

    @property
    def saved(self) -> bool:
        """Returns whether a border was saved."""
        return self.seed is not None

    @property
    def seed_is_right(self) -> bool:
        """Returns whether the saved seed point is in the region to restrict."""
        return self.seed is not None and self.is_asked_for(self.seed)

    def is_asked_for(self, place: Tuple[float, float]) -> bool:
        """Returns whether a place (x, y) [m] is in the region to restrict."""
        return bool(Polygon(self.scenario.region).contains(Point(place)))


def measure(result: Result) -> Dict[str, object]:
    """Measures all columns of a run but those that say which run it was."""
    restricted, floor = metrics.restricted_cells(result.prior, result.posterior), result.prior.data == FREE
    # in spot cleaning the paper's people drew around 3.2 m2 and restricted the rest, which hides their drawing
    enclosed = (metrics.enclosed(floor, cells & floor, result.truth) for cells in (result.truth, restricted))
    # over every interaction of the run: cancelled ones took time too
    times = [sum(float(record[f"{state}_s"]) for record in result.records) for state in STATES]
    return {
        # border points and a seed on the right side, whatever the accuracy (paper, Sect. 5.5)
        "completed": int(result.saved and result.seed_is_right),
        **{column: round(value, 2) for column, value in zip(TIMES, (*times, sum(times)))},
        **metrics.accuracy(result.prior, result.truth, restricted),
        "outcome": "saved" if result.saved else (result.outcome or "time_is_up"),
        "reason": "" if result.saved else result.reason,
        "seed_is_right": int(result.seed_is_right),
        # 0: the person was drawn to point at the wrong side
        "pointed_right": int(result.is_asked_for(result.pointed)),
        "tries": result.tries,
        "spots": len(result.spots),
        "robot_collisions": result.collisions,
        "jaccard_enclosed": round(metrics.jaccard(*enclosed), 4),
        "too_bright": int(result.too_bright),
    }
