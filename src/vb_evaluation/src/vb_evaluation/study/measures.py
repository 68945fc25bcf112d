"""Measures a run: the paper's measures (Sect. 5.5), the boundary error, and what explains them."""
from __future__ import annotations

from typing import Dict

import numpy as np

from vb_core.geometry import chain_length
from vb_core.grid_map import FREE
from vb_evaluation import metrics
from vb_evaluation.report.data import MEASURES
from vb_evaluation.study.result import Result

FURTHER = ("outcome", "reason", "seed_is_right", "tries", "elapsed_s", "border_m", "chain_m", "vertices", "spots",
           "spots_robot", "false_spots", "robot_goals", "robot_way_m", "robot_collisions", "jaccard_enclosed")
COLUMNS = (*MEASURES, *FURTHER)


def measure(result: Result) -> Dict[str, object]:
    """All columns of a run but those that say which run it was."""
    restricted = metrics.restricted_cells(result.prior, result.posterior)
    return {
        # border points and a seed on the right side, whatever the accuracy (paper, Sect. 5.5)
        "completed": int(result.saved and result.seed_is_right),
        **times(result),
        **metrics.accuracy(result.prior, result.truth, restricted),
        **_further(result),
        # in spot cleaning the paper's people drew around 3.2 m2 and restricted the rest, which hides their drawing
        "jaccard_enclosed": round(_enclosed_index(result, restricted), 4),
    }


def _enclosed_index(result: Result, restricted: np.ndarray) -> float:
    floor = result.prior.data == FREE
    return metrics.jaccard(*(metrics.enclosed(floor, cells & floor, result.truth) for cells in (result.truth, restricted)))


def times(result: Result) -> Dict[str, object]:
    """[s] in each state and in all, over every interaction of the run: cancelled ones took time too."""
    states = ("guide", "border", "seed")
    sums = {state: sum(float(record[f"{state}_s"]) for record in result.records) for state in states}
    columns = {f"time_{state}_s": round(value, 2) for state, value in sums.items()}
    return {**columns, "time_total_s": round(sum(sums.values()), 2)}


def _further(result: Result) -> Dict[str, object]:
    records, border = result.records, result.border
    steps = np.linalg.norm(np.diff(result.path, axis=0), axis=1) if len(result.path) > 1 else np.zeros(1)
    return {
        "outcome": "saved" if result.saved else (result.outcome or "time_is_up"),
        "reason": "" if result.saved else result.reason,
        "seed_is_right": int(result.seed_is_right),
        "tries": result.tries,
        "elapsed_s": round(records[-1]["ended"] - records[0]["started"], 2) if records else 0.0,
        "border_m": round(chain_length(result.scenario.border, result.scenario.closed), 3),
        "chain_m": round(chain_length(border.points, bool(border.closed)), 3) if border is not None else "",
        "vertices": len(border.points) if border is not None else "",
        "spots": len(result.spots),
        "spots_robot": sum(spot.mobile for spot in result.spots),
        "false_spots": result.false_spots,
        "robot_goals": result.goals,
        "robot_way_m": round(float(steps.sum()), 2),
        "robot_collisions": result.collisions,
    }
