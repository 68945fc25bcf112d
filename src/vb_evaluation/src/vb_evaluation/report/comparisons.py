"""Computes the tables that compare the methods, paired by participant: effects, margins, and for people the paper's tests."""

from __future__ import annotations

import math
from typing import Any, Dict, List, Mapping, NamedTuple, Sequence, Tuple

import numpy as np
import pandas

from vb_evaluation import statistics
from vb_evaluation.report.study_files import StudyResults, select
from vb_evaluation.statistics import CONFIDENCE, Interval, format_number, format_p

# headings of columns that the findings read too
MEASURE, GAIN, READING = "Measure", "Gain [90 %]", "Reading"


class Measure(NamedTuple):
    """A measure by which methods are compared."""

    title: str
    digits: int
    sign: float  # 1 if larger values are better, else -1
    margin: float  # how much worse than the baseline a method may be; nan where no such question is asked


# one cell of the map is 2.5 cm; .05 is about twice the .028 that the paper calls not notable in practice
COMPARED = {
    "error_mean_cm": Measure("Mean boundary error [cm]", 1, sign=-1.0, margin=2.5),
    "time_total_s": Measure("Time [s]", 1, sign=-1.0, margin=math.nan),
    "jaccard": Measure("Jaccard index", 3, sign=1.0, margin=0.05),
}
COMPLETED = Measure("Completed [points]", 0, sign=1.0, margin=10.0)


def speed_up(study: StudyResults, scenario: str) -> Interval:
    """Computes how many times as fast the study's method is: the baseline's mean time over its own."""
    own, baseline = study.pairs("time_total_s", scenario)
    return statistics.ratio_of_means(baseline, own)


def completion_difference(study: StudyResults, runs: pandas.DataFrame, confidence: float = CONFIDENCE) -> Interval:
    """Computes by how much the method's share of completed runs is larger than the baseline's [percentage points]."""
    flags = [select(runs, method=method).completed.dropna() for method in study.comparison]
    return statistics.difference_of_proportions(*flags, confidence).scaled(100.0)


def compute_effects(study: StudyResults) -> List[Dict[str, Any]]:
    """Computes the method's effects with their intervals: a row for each scenario."""
    rows = []
    for scenario, title in study.scenarios.items():
        differences = {column: study.differences(column, scenario) for column in COMPARED}
        row: Dict[str, Any] = {"Scenario": title}
        row["Pairs"] = len(differences["time_total_s"])
        row["Pairs, accuracy"] = len(differences["error_mean_cm"])
        for column, measure in COMPARED.items():
            row[measure.title] = statistics.hodges_lehmann(differences[column]).text(measure.digits)
        row["Speed-up"] = speed_up(study, scenario).text(2)
        runs = select(study.runs, scenario=scenario)
        row[COMPLETED.title] = completion_difference(study, runs).text(COMPLETED.digits)
        rows.append(row)
    return rows


def compare_with_margins(study: StudyResults) -> List[Dict[str, Any]]:
    """Tells whether the method is worse than the baseline by a margin or more (the paper's hypotheses 3 and 4)."""
    gains: List[Tuple[str, Measure, Interval, Any]] = []
    for column in ("jaccard", "error_mean_cm"):
        for scenario, title in study.scenarios.items():
            values = COMPARED[column].sign * study.differences(column, scenario)
            gains.append((title, COMPARED[column], statistics.hodges_lehmann(values, 0.9), len(values)))
    gains.append(("all", COMPLETED, completion_difference(study, study.runs, 0.9), ""))
    rows = []
    for title, measure, gain, n in gains:
        is_not_worse = gain.low > -measure.margin
        reading = "worse" if gain.high < -measure.margin else "open"
        row = {"Scenario": title, MEASURE: measure.title, GAIN: gain.text(measure.digits)}
        row["Margin"] = f"{measure.margin:g}"
        row[READING] = "not worse" if is_not_worse else reading
        row["Equivalent"] = "yes" if is_not_worse and gain.high < measure.margin else "no"
        rows.append({**row, "Pairs": n})
    return rows


def compute_tests(study: StudyResults) -> List[Dict[str, Any]]:
    """Makes the paper's Wilcoxon tests, for studies with people only."""
    rows: List[Dict[str, Any]] = []
    for column, measure in COMPARED.items() if study.has_people else ():
        titles = [{"Measure": measure.title, "Scenario": title} for title in study.scenarios.values()]
        rows += tabulate_tests(titles, [study.differences(column, scenario) for scenario in study.scenarios])
    return rows


def tabulate_tests(rows: Sequence[Mapping[str, Any]], family: Sequence[np.ndarray]) -> List[Dict[str, Any]]:
    """Adds to each row the test of its paired differences (N,), with p also corrected over the family. Leaves out empty ones."""
    # statsmodels takes a second to import
    from statsmodels.stats.multitest import multipletests

    samples = [(row, sample) for row, sample in zip(rows, family) if len(sample)]
    tests = [statistics.signed_rank_test(sample) for _, sample in samples]
    corrected = multipletests([test.p for test in tests], method="holm")[1] if tests else ()
    return [
        {
            **row,
            "Pairs": len(sample),
            "Z": format_number(test.z, 3),
            "exact p": format_p(test.p),
            "p (Holm)": format_p(p),
            # two observations per pair (Rosenthal 1991; Field 2009, Sect. 15.4)
            "r": format_number(abs(test.z) / math.sqrt(2 * len(sample)), 2),
        }
        for (row, sample), test, p in zip(samples, tests, corrected)
    ]
