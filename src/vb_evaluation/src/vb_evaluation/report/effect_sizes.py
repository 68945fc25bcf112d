"""Computes the effects that sections report: differences and ratios of two methods, paired by participant."""

from __future__ import annotations

from typing import List, Tuple

import numpy as np
import pandas

from vb_evaluation import statistics
from vb_evaluation.report.blocks import Block, Table, column_headings
from vb_evaluation.report.study_files import StudyResults, known_values, pairs, select
from vb_evaluation.statistics import CONFIDENCE, Interval


def paired_shift(
    table: pandas.DataFrame,
    column: str,
    methods: Tuple[str, str],
    completed: bool = False,
    confidence: float = CONFIDENCE,
) -> Interval:
    """Computes the Hodges-Lehmann difference, without an interval where there are too few pairs for one of 90 %."""
    first, second = pairs(table, column, methods, completed)
    # 0.3 - 0.1 and 0.4 - 0.2 are a tie that floating point does not see
    interval = statistics.hodges_lehmann(np.round(first - second, 9), confidence)
    return interval if interval.confidence >= 0.89 else Interval(interval.estimate)


def ratio(table: pandas.DataFrame, methods: Tuple[str, str]) -> Interval:
    """Computes the speed-up of the first method."""
    first, second = pairs(table, "time_total_s", methods)
    return statistics.ratio_of_means(second, first)


def completed_more(table: pandas.DataFrame, methods: Tuple[str, str], confidence: float = CONFIDENCE) -> Interval:
    """Computes by how much the first method's share of completed runs is larger [percentage points]."""
    flags = (known_values(select(table, method=method), "completed") for method in methods)
    return statistics.difference_of_proportions(*flags, confidence).scaled(100.0)


def wilcoxon_blocks(study: StudyResults, column: str, unit: str, completed: bool) -> List[Block]:
    """Reports the paper's Wilcoxon test, for studies with people only."""
    if not study.has_people or len(study.methods) < 2:
        return []
    rows = []
    for title, runs in study.by_scenario():
        samples = pairs(runs, column, study.comparison, completed)
        if len(samples[0]):
            rows.append({"scenario": title, **wilcoxon_row(statistics.compare_paired(*samples))})
    add_holm(rows)
    keys = ("scenario", "n", "z", "p", "holm", "r", "rank_biserial", "shift")
    explanation = (
        "Wilcoxon signed-rank test: Z as SPSS gives it (zero differences left out, ties corrected, no continuity correction), "
        "exact p over all signs, r = |Z| / √(2 × pairs), Hodges-Lehmann difference. Holm: corrected over this table."
    )
    heads = column_headings(*keys, shift=f"Difference {f'[{unit}]' if unit else ''}")
    return [Table(f"test_{column}", heads, rows, {"z": 3, "shift": 3}, explanation=explanation)] if rows else []


def wilcoxon_row(comparison: statistics.PairedComparison) -> dict:
    """Returns the cells of a Wilcoxon test's row."""
    return {
        "n": comparison.n,
        "z": comparison.test.z,
        "p": statistics.format_p(comparison.test.p_exact),
        "p_value": comparison.test.p_exact,
        "r": comparison.r,
        "rank_biserial": comparison.rank_biserial,
        "shift": comparison.shift,
    }


def add_holm(rows: List[dict]) -> None:
    """Adds the p corrected by Holm's method to the rows of one family of tests, each with its `p_value`."""
    for row, p in zip(rows, statistics.holm([row["p_value"] for row in rows])):
        row["holm"] = statistics.format_p(p)
