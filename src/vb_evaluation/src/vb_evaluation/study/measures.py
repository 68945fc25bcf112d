"""What is measured of a run: the paper's measures, and columns of one's own (paper, Sect. 5.5)."""
from __future__ import annotations

from pathlib import Path
from typing import Callable, Dict, Optional, Sequence

import numpy as np

from vb_core.geometry import chain_length
from vb_evaluation import metrics
from vb_evaluation.study.cameras import spot_counts
from vb_evaluation.study.registry import Registry
from vb_evaluation.study.runner import Result
from vb_map_integration import map_files

Measure = Callable[[Result], object]

# of one's own: @measures.register("name"), and the name in the configuration's list `measures`
measures: Registry[Measure] = Registry("measures")

PAPER = ("completed", "time_guide_s", "time_border_s", "time_seed_s", "time_total_s", "jaccard")
FURTHER = ("outcome", "reason", "seed_is_right", "tries", "elapsed_s", "border_m", "chain_m", "vertices", "spots",
           "spots_robot", "robot_goals", "robot_way_m", "robot_collisions", "map")


def measure(result: Result, maps: Optional[Path], names: Sequence[str] = ()) -> Dict[str, object]:
    """All columns of a run but those that say which run it was.

    Args:
        maps: folder for the map that came out; None stores none. Its parent is what the column `map` is relative to.
        names: of further measures.
    """
    posterior, file = result.posterior, ""
    if maps is not None and result.saved:
        task = result.task
        path = map_files.write_map(maps / f"p{task.participant:02d}_{task.scenario}_{task.method}", posterior)[1]
        posterior, file = map_files.read_map(path), str(path.relative_to(maps.parent))
    columns: Dict[str, object] = {
        # border points and a seed on the right side, whatever the accuracy (paper, Sect. 5.5)
        "completed": int(result.saved and result.seed_is_right),
        **times(result),
        "jaccard": _rounded(metrics.jaccard(result.truth, metrics.restricted_cells(result.prior, posterior)), 4),
        **_further(result, file),
    }
    columns.update({name: _rounded(measures.get(name)(result), 4) for name in names})
    return columns


def times(result: Result) -> Dict[str, float]:
    """[s] in each state and in all, over every interaction of the run: what was cancelled was spent all the same."""
    states = ("guide", "border", "seed")
    sums = {state: sum(getattr(record, f"{state}_s") for record in result.records) for state in states}
    columns = {f"time_{state}_s": _rounded(value, 2) for state, value in sums.items()}
    return {**columns, "time_total_s": _rounded(sum(sums.values()), 2)}


def _further(result: Result, file: str) -> Dict[str, object]:
    person, records, border = result.script.person, result.records, result.border
    counts = spot_counts(result.spots)
    mobile = {spot.camera for spot in result.spots if spot.mobile}
    steps = np.linalg.norm(np.diff(result.way, axis=0), axis=1) if len(result.way) > 1 else np.zeros(1)
    return {
        "outcome": "saved" if result.saved else (result.script.outcome or "time_is_up"),
        "reason": "" if result.saved else result.script.reason,
        "seed_is_right": int(result.seed_is_right),
        "tries": person.tries,
        "elapsed_s": _rounded(records[-1].ended - records[0].started, 2) if records else 0.0,
        "border_m": _rounded(chain_length(result.scenario.border, result.scenario.closed), 3),
        "chain_m": _rounded(chain_length(border.points, bool(border.closed)), 3) if border is not None else "",
        "vertices": len(border.points) if border is not None else "",
        "spots": sum(counts.values()),
        "spots_robot": sum(counts[name] for name in mobile),
        "robot_goals": result.goals,
        "robot_way_m": _rounded(float(steps.sum()), 2),
        "robot_collisions": result.collisions,
        "map": file,
    }


def _rounded(value: object, digits: int) -> object:
    # the last bits differ between processors and libraries, and mean nothing
    return round(float(value), digits) if isinstance(value, (float, np.floating)) else value
