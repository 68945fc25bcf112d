"""Computes the effects that tables report: differences and ratios of two methods, paired by participant, and their tests."""

from __future__ import annotations

from typing import Any, Dict, Mapping, Tuple

import numpy as np
import pandas

from vb_evaluation import statistics
from vb_evaluation.report.study_files import pairs, select
from vb_evaluation.statistics import CONFIDENCE, Interval


def speed_up(runs: pandas.DataFrame, methods: Tuple[str, str]) -> Interval:
    """Computes how many times as fast the first method is: the second's mean time over its own."""
    first, second = pairs(runs, "time_total_s", methods)
    return statistics.ratio_of_means(second, first)


def completion_difference(runs: pandas.DataFrame, methods: Tuple[str, str], confidence: float = CONFIDENCE) -> Interval:
    """Computes by how much the first method's share of completed runs is larger [percentage points]."""
    first = select(runs, method=methods[0]).completed.dropna()
    second = select(runs, method=methods[1]).completed.dropna()
    return statistics.difference_of_proportions(first, second, confidence).scaled(100.0)


def wilcoxon_rows(family: Mapping[str, np.ndarray]) -> Dict[str, Dict[str, Any]]:
    """Tests a family of paired differences (N,) by name, with p also corrected over the family. Returns the tests' cells."""
    tests = {name: statistics.signed_rank_test(differences) for name, differences in family.items() if len(differences)}
    corrected = statistics.holm([test.p_exact for test in tests.values()])
    rows = {}
    for (name, test), p in zip(tests.items(), corrected):
        rows[name] = {
            "Pairs": test.n,
            "Z": test.z,
            "exact p": statistics.format_p(test.p_exact),
            "p (Holm)": statistics.format_p(p),
            "r": test.r,
            "rank-biserial": test.rank_biserial,
            "Difference": test.shift,
        }
    return rows
