"""Computes a run's measures (paper, Sect. 5.5), and columns that explain them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Dict

from shapely.geometry import Point, Polygon

from vb_core.grid_map import FREE
from vb_evaluation import metrics
from vb_evaluation.report.study_files import MEASURES, STATES, TIMES

if TYPE_CHECKING:  # only running needs ROS: reading a study does not
    from vb_evaluation.simulated_study.live_run import LiveRun

FURTHER = tuple(
    "outcome reason seed_is_right pointed_right tries spots robot_collisions jaccard_enclosed too_bright".split()
)
COLUMNS = (*MEASURES, *FURTHER)


def measure(run: LiveRun) -> Dict[str, object]:
    """Computes all columns of a run except those that identify it."""
    restricted, floor = metrics.restricted_cells(run.prior, run.posterior), run.prior.data == FREE
    # in spot cleaning the paper's people drew around 3.2 m2 and restricted the rest, which hides the drawing's errors
    enclosed = (metrics.enclosed(floor, cells & floor, run.truth) for cells in (run.truth, restricted))
    # over every interaction of the run: cancelled ones took time too
    times = [sum(float(record[f"{state}_s"]) for record in run.records) for state in STATES]
    saved, asked, script = run.seed is not None, Polygon(run.scenario.region), run.script
    seed_is_right = int(saved and asked.contains(Point(run.seed)))
    return {
        # border points and a seed on the right side, whatever the accuracy (paper, Sect. 5.5)
        "completed": seed_is_right,
        **{column: round(value, 2) for column, value in zip(TIMES, (*times, sum(times)))},
        **metrics.accuracy(run.prior, run.truth, restricted),
        "outcome": "saved" if saved else (script.outcome or "time_is_up"),
        "reason": "" if saved else script.reason,
        "seed_is_right": seed_is_right,
        # 0: the person was drawn to point at the wrong side
        "pointed_right": int(asked.contains(Point(script.person.seed))),
        "tries": script.person.tries,
        "spots": len(run.spots),
        "robot_collisions": sum(robot.collisions for robot in run.lab.robots),
        "jaccard_enclosed": round(metrics.jaccard(*enclosed), 4),
        "too_bright": int(run.too_bright),
    }
