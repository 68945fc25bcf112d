"""Writes the section on plausible worlds: whether the findings hold where all assumptions differ."""

from __future__ import annotations

from typing import Any, Dict, List, Tuple

import pandas

from vb_evaluation import statistics
from vb_evaluation.report import paper_results
from vb_evaluation.report.page_blocks import Block, Table, columns
from vb_evaluation.report.study_files import DRAWS, WORLDS, StudyResults, read_sheet, select

TOLERATED_CM = 2.5  # [cm] one cell of the map: no robot respects a border more exactly


def plausible_worlds_section(study: StudyResults) -> List[Block]:
    """Reports the conclusions over worlds in which all assumptions differ at once.

    Empty where draws.csv or worlds.csv is missing.
    """
    if WORLDS not in study.tables or len(study.methods) < 2 or not (study.folder / DRAWS).is_file():
        return []
    inputs = read_sheet(study.folder / DRAWS, ("draw",)).columns[1:]
    table, (first, baseline) = study.tables[WORLDS], study.comparison
    both = select(table, method=first).merge(
        select(table, method=baseline), on=["draw", "scenario"], suffixes=("", "_base")
    )
    return [
        (
            f"All {len(inputs)} assumptions vary together over their plausible ranges: a Latin hypercube of "
            f"{table.draw.nunique()} draws."
        ),
        Table(
            "worlds",
            columns("conclusion", "worlds", "holds", "n", holds="holds in [%] of worlds", n="Number"),
            conclusions(study, both),
            {"holds": 0},
            words="Wilson's 95 % intervals. The ranges are assumed, too: a share of worlds is no probability that a conclusion is "
            "true. A world is a draw of all assumptions, with one person who tries both methods. "
            "Too bright: the lab's own check of the cameras asks for a shorter exposure before anybody draws.",
        ),
    ]


def _completed(both: pandas.DataFrame, column: str) -> Tuple[pandas.Series, pandas.Series]:
    """Returns a measure with either method, nan unless both were completed."""
    done = (both.completed == 1) & (both.completed_base == 1) & both[column].notna() & both[f"{column}_base"].notna()
    return both[column].where(done), both[f"{column}_base"].where(done)


def conclusions(study: StudyResults, both: pandas.DataFrame) -> List[Dict[str, Any]]:
    """Computes the share of worlds in which each conclusion holds: of all, and of those with no camera too bright."""
    (time, time_base), (error, error_base) = (_completed(both, column) for column in ("time_total_s", "error_mean_cm"))
    claims = {
        "faster, whether completed or not": (both.time_total_s < both.time_total_s_base, both.completed.notna()),
        "faster (both completed)": (time < time_base, time.notna()),
        "at least 1.5 times as fast (both completed)": (1.5 * time < time_base, time.notna()),
        f"mean boundary error at most {TOLERATED_CM} cm larger": (error <= error_base + TOLERATED_CM, error.notna()),
        "completed wherever robot only was": (both.completed == 1, both.completed_base == 1),
        **{
            f"completed: {paper_results.method_title(method).lower()}": (column == 1, column.notna())
            for method, column in zip(study.comparison, (both.completed, both.completed_base))
        },
    }
    scopes = {"all": True, "no camera too bright": both.too_bright == 0}
    rows = []
    for claim, (holds, is_known) in claims.items():
        for scope, within in scopes.items():
            outcomes = holds[is_known & within]
            rows.append(
                {
                    "conclusion": claim,
                    "worlds": scope,
                    "n": len(outcomes),
                    "holds": statistics.proportion(int(outcomes.sum()), len(outcomes)).scaled(100.0),
                }
            )
    return rows
