"""Makes the tables that check the findings: beside each figure of the paper, and in worlds where all assumptions differ."""

from __future__ import annotations

import math
from typing import Any, Dict, Iterator, List

from vb_evaluation import statistics
from vb_evaluation.report import effect_sizes, paper_results
from vb_evaluation.report.paper_results import METHODS, PAPER
from vb_evaluation.report.study_files import DRAWS, StudyResults, pairs, read_sheet, select
from vb_evaluation.report.table import Table
from vb_evaluation.statistics import Interval

TOLERATED_CM = 2.5  # [cm] one cell of the map: no robot respects a border more exactly


def paper_table(study: StudyResults) -> Table:
    """Compares each figure of the paper with ours, in both directions: being better does not count as agreement."""
    rows: List[Dict[str, Any]] = []
    for scenario in PAPER:
        if study.comparison == METHODS and scenario in study.scenarios:
            title = study.scenario_title(scenario)
            rows += ({"Scenario": title, **row} for row in _compare_scenario(study, scenario))
    counts = {word: sum(row["Reading"] == word for row in rows) for word in ("same", "better", "worse")}
    text = (
        f"{paper_results.CITATION}. It measured 15 people in a real lab.\n\n"
        "Same: the paper's figure lies in our 95 % interval. Better and worse are both disagreement: a simulation whose "
        "people do better than real people is wrong in that figure, too. "
        f"Of {len(rows)} figures {counts['same']} are the same, {counts['better']} better, {counts['worse']} worse."
    )
    return Table("beside_the_paper", "Beside the paper", text, rows)


def _compare_scenario(study: StudyResults, scenario: str) -> Iterator[Dict[str, Any]]:
    """Yields a row for each figure that the paper has of a scenario."""
    scenario_runs = select(study.runs, scenario=scenario)
    published = PAPER[scenario]
    yield _compare("speed-up", published.speedup, effect_sizes.speed_up(scenario_runs, METHODS), digits=2, step=0.1)
    if published.border_gain_s is not None:
        with_nrs, alone = pairs(scenario_runs, "time_border_s", METHODS)
        gain = statistics.mean(alone - with_nrs)
        yield _compare("Border state shorter by [s]", published.border_gain_s, gain, digits=1, step=1.0)
    for method in METHODS:
        title = paper_results.method_title(method).lower()
        runs = select(scenario_runs, method=method)
        done = select(runs, completed=1)
        index = published.jaccard[method]
        similarity = statistics.median(done.jaccard.dropna())
        yield _compare(f"Jaccard index, {title}", index, similarity, digits=3, step=1e-3)
        if scenario == "corner" and scenario_runs.jaccard_enclosed.notna().any():
            inside = statistics.median(done.jaccard_enclosed.dropna())
            yield _compare(f"Jaccard index of the area drawn round, {title}", index, inside, digits=3, step=1e-3)
        share = statistics.percentage(runs.completed.dropna())
        yield _compare(f"completed [%], {title}", 100 * published.completeness, share, digits=1, step=0.1)


def _compare(quantity: str, published: float, ours: Interval, *, digits: int, step: float) -> Dict[str, Any]:
    """Makes the row of a figure, with so many digits. The paper's is rounded to multiples of `step`."""
    low = ours.estimate if math.isnan(ours.low) else ours.low
    high = ours.estimate if math.isnan(ours.high) else ours.high
    tolerance = 0.5 * step
    difference = ours.estimate - published
    reading = "better" if difference > 0 else "worse"
    if low - tolerance <= published <= high + tolerance:
        reading = "same"
    elif math.isnan(difference):
        reading = "unknown"
    return {
        "Quantity": quantity,
        "Paper": f"{published:.{digits}f}",
        "Here [95 %]": ours.text(digits),
        "Here minus paper": statistics.format_number(difference, digits, sign="+"),
        "Reading": reading,
    }


def worlds_table(study: StudyResults) -> Table:
    """Reports the conclusions over worlds in which all assumptions differ at once, if there are any."""
    draws_file = study.folder / DRAWS
    if not len(study.worlds) or not draws_file.is_file():
        return Table("worlds", "Plausible worlds", "", [])
    inputs = read_sheet(draws_file, ("draw",)).columns[1:]
    text = (
        f"All {len(inputs)} assumptions vary together over their plausible ranges: a Latin hypercube of "
        f"{study.worlds.draw.nunique()} draws. Wilson's 95 % intervals. The ranges are assumed, too: a share of worlds is no "
        "probability that a conclusion is true. A world is a draw of all assumptions, with one person who tries both "
        "methods. Too bright: the lab's own check of the cameras asks for a shorter exposure before anybody draws."
    )
    return Table("worlds", "Plausible worlds", text, _conclusions(study), {"holds in [%] of worlds": 0})


def _conclusions(study: StudyResults) -> List[Dict[str, Any]]:
    """Computes the share of worlds in which each conclusion holds: of all, and of those with no camera too bright."""
    method, baseline = study.comparison
    titles = [paper_results.method_title(key).lower() for key in study.comparison]
    ours = select(study.worlds, method=method)
    worlds = ours.merge(select(study.worlds, method=baseline), on=["draw", "scenario"], suffixes=("", "_base"))
    is_faster = worlds.time_total_s < worlds.time_total_s_base
    is_much_faster = 1.5 * worlds.time_total_s < worlds.time_total_s_base
    is_as_exact = worlds.error_mean_cm <= worlds.error_mean_cm_base + TOLERATED_CM
    is_completed = worlds.completed == 1
    is_completed_base = worlds.completed_base == 1
    both = is_completed & is_completed_base
    are_timed = both & worlds.time_total_s.notna() & worlds.time_total_s_base.notna()
    are_measured = both & worlds.error_mean_cm.notna() & worlds.error_mean_cm_base.notna()
    # each conclusion: where it holds, and the worlds that it is about
    claims = {
        "faster, whether completed or not": (is_faster, worlds.completed.notna()),
        "faster (both completed)": (is_faster, are_timed),
        "at least 1.5 times as fast (both completed)": (is_much_faster, are_timed),
        f"mean boundary error at most {TOLERATED_CM} cm larger": (is_as_exact, are_measured),
        "completed wherever robot only was": (is_completed, is_completed_base),
        f"completed: {titles[0]}": (is_completed, worlds.completed.notna()),
        f"completed: {titles[1]}": (is_completed_base, worlds.completed_base.notna()),
    }
    rows = []
    for claim, (holds, is_about) in claims.items():
        is_usable = is_about & (worlds.too_bright == 0)
        for scope, is_within in (("all", is_about), ("no camera too bright", is_usable)):
            share = statistics.percentage(holds[is_within])
            row = {"Conclusion": claim, "Worlds": scope, "holds in [%] of worlds": share, "Number": is_within.sum()}
            rows.append(row)
    return rows
