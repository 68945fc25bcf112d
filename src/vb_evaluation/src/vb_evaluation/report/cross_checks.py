"""Computes the tables that check the findings: beside each figure of the paper, and in worlds where all assumptions differ."""

from __future__ import annotations

import math
from typing import Any, Dict, Iterator, List

from vb_evaluation import statistics
from vb_evaluation.report import paper_results
from vb_evaluation.report.comparisons import READING, speed_up
from vb_evaluation.report.paper_results import METHOD_TITLES, METHODS
from vb_evaluation.report.study_files import StudyResults, select
from vb_evaluation.statistics import Interval

# headings of columns that the findings read too
CONCLUSION, WORLDS, HOLDS, NUMBER = "Conclusion", "Worlds", "holds in [%] of worlds", "Number"
TOLERATED_CM = 2.5  # [cm] one cell of the map: no robot respects a border more exactly


def compare_with_paper(study: StudyResults) -> List[Dict[str, Any]]:
    """Compares each figure of the paper with ours, in both directions: being better does not count as agreement."""
    rows: List[Dict[str, Any]] = []
    for scenario, title in study.scenarios.items():
        if study.comparison == METHODS and scenario in paper_results.SPEED_UP:
            rows += ({"Scenario": title, **row} for row in _compare_scenario(study, scenario))
    return rows


def _compare_scenario(study: StudyResults, scenario: str) -> Iterator[Dict[str, Any]]:
    """Yields a row for each figure that the paper has of a scenario."""
    yield _compare("speed-up", paper_results.SPEED_UP[scenario], speed_up(study, scenario), digits=2, step=0.1)
    if scenario in paper_results.BORDER_GAIN_S:
        with_nrs, alone = study.pairs("time_border_s", scenario)
        gain = statistics.mean(alone - with_nrs)
        yield _compare("Border state shorter by [s]", paper_results.BORDER_GAIN_S[scenario], gain, digits=1, step=1.0)
    for method, index in zip(METHODS, paper_results.JACCARD[scenario]):
        title = METHOD_TITLES[method].lower()
        runs = select(study.runs, scenario=scenario, method=method)
        done = select(runs, completed=1)
        similarity = statistics.median(done.jaccard.dropna())
        yield _compare(f"Jaccard index, {title}", index, similarity, digits=3, step=1e-3)
        if scenario == "corner" and done.jaccard_enclosed.notna().any():
            inside = statistics.median(done.jaccard_enclosed.dropna())
            yield _compare(f"Jaccard index of the area drawn round, {title}", index, inside, digits=3, step=1e-3)
        share = statistics.percentage(runs.completed.dropna())
        yield _compare(f"completed [%], {title}", 100 * paper_results.COMPLETENESS[scenario], share, digits=1, step=0.1)


def _compare(quantity: str, published: float, ours: Interval, *, digits: int, step: float) -> Dict[str, Any]:
    """Makes the row of a figure, with so many digits. The paper's is rounded to multiples of `step`."""
    known = [value for value in ours if not math.isnan(value)]
    difference = ours.estimate - published
    reading = "better" if difference > 0 else "worse"
    if not known:
        reading = "unknown"
    elif min(known) - step / 2 <= published <= max(known) + step / 2:
        reading = "same"
    return {
        "Quantity": quantity,
        "Paper": f"{published:.{digits}f}",
        "Here [95 %]": ours.text(digits),
        "Here minus paper": statistics.format_number(difference, digits, sign="+"),
        READING: reading,
    }


def count_worlds(study: StudyResults) -> List[Dict[str, Any]]:
    """Computes the share of worlds in which each conclusion holds: of all, and of those with no camera too bright."""
    if not len(study.worlds):
        return []
    own, base = (select(study.worlds, method=method) for method in study.comparison)
    worlds = own.merge(base, on=["draw", "scenario"], suffixes=("", "_base"))
    is_faster = worlds.time_total_s < worlds.time_total_s_base
    is_much_faster = 1.5 * worlds.time_total_s < worlds.time_total_s_base
    is_as_exact = worlds.error_mean_cm <= worlds.error_mean_cm_base + TOLERATED_CM
    is_completed = worlds.completed == 1
    is_completed_base = worlds.completed_base == 1
    both = is_completed & is_completed_base
    are_timed = both & worlds.time_total_s.notna() & worlds.time_total_s_base.notna()
    are_measured = both & worlds.error_mean_cm.notna() & worlds.error_mean_cm_base.notna()
    method, baseline = (study.methods[key].lower() for key in study.comparison)
    # each conclusion: where it holds, and the worlds that it is about
    claims = {
        "faster, whether completed or not": (is_faster, worlds.completed.notna()),
        "faster (both completed)": (is_faster, are_timed),
        "at least 1.5 times as fast (both completed)": (is_much_faster, are_timed),
        f"mean boundary error at most {TOLERATED_CM} cm larger": (is_as_exact, are_measured),
        f"completed wherever {baseline} was": (is_completed, is_completed_base),
        f"completed: {method}": (is_completed, worlds.completed.notna()),
        f"completed: {baseline}": (is_completed_base, worlds.completed_base.notna()),
    }
    rows = []
    for claim, (holds, is_about) in claims.items():
        is_usable = is_about & (worlds.too_bright == 0)
        for scope, is_within in (("all", is_about), ("no camera too bright", is_usable)):
            share = statistics.percentage(holds[is_within]).text(0)
            rows.append({CONCLUSION: claim, WORLDS: scope, HOLDS: share, NUMBER: is_within.sum()})
    return rows
