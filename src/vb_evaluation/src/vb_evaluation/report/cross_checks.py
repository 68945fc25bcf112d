"""Writes the sections that check the findings: beside each figure of the paper, and in worlds where all assumptions differ."""

from __future__ import annotations

import math
from typing import Any, Dict, Iterator, List, Tuple

import pandas

from vb_evaluation import statistics
from vb_evaluation.report import effect_sizes, paper_results
from vb_evaluation.report.blocks import Block, Table, column_headings
from vb_evaluation.report.paper_results import METHODS, PAPER
from vb_evaluation.report.study_files import DRAWS, WORLDS, StudyResults, known_values, pairs, read_sheet, select
from vb_evaluation.statistics import Interval

TOLERATED_CM = 2.5  # [cm] one cell of the map: no robot respects a border more exactly


def paper_comparison_section(study: StudyResults) -> List[Block]:
    """Compares each figure of the paper with ours, in both directions: being better does not count as agreement."""
    rows = [
        {"scenario": study.scenario_title(scenario), **row}
        for scenario in PAPER
        for row in _compare_scenario(study, scenario)
    ]
    if not rows:
        return []
    counts = {word: sum(row["reading"].startswith(word) for row in rows) for word in ("same", "better", "worse")}
    heads = column_headings(*rows[0], here="Here [95 %]", difference="Here minus paper")
    readings = (
        "Same: the paper's figure lies in our 95 % interval. Better and worse are both disagreement: a simulation whose "
        "people do better than real people is wrong in that figure, too. "
        f"Of {len(rows)} figures {counts['same']} are the same, {counts['better']} better, {counts['worse']} worse."
    )
    source = f"{paper_results.CITATION}. It measured 15 people in a real lab."
    return [source, readings, Table("beside_the_paper", heads, rows)]


def _compare_scenario(study: StudyResults, scenario: str) -> Iterator[Dict[str, Any]]:
    """Yields a row for each figure that the paper has of a scenario; none if it was not run with both methods."""
    scenario_runs = select(study.runs, scenario=scenario)
    published = PAPER[scenario]
    if not len(scenario_runs) or not set(METHODS) <= set(study.methods):
        return
    yield _compare("speed-up", published.speedup, effect_sizes.ratio(scenario_runs, METHODS), digits=2, step=0.1)
    if published.border_gain_s is not None:
        with_nrs, alone = pairs(scenario_runs, "time_border_s", METHODS)
        gain = statistics.mean(alone - with_nrs)
        yield _compare("Border state shorter by [s]", published.border_gain_s, gain, digits=1, step=1.0)
    for method in METHODS:
        title = paper_results.method_title(method).lower()
        runs = select(scenario_runs, method=method)
        done = select(runs, completed=1)
        index = published.jaccard[method]
        similarity = statistics.median(known_values(done, "jaccard"))
        yield _compare(f"Jaccard index, {title}", index, similarity, digits=3, step=1e-3)
        if scenario == "corner" and scenario_runs.jaccard_enclosed.notna().any():
            inside = statistics.median(known_values(done, "jaccard_enclosed"))
            yield _compare(f"Jaccard index of the area drawn round, {title}", index, inside, digits=3, step=1e-3)
        flags = known_values(runs, "completed")
        share = statistics.proportion(int(flags.sum()), len(flags)).scaled(100.0)
        yield _compare(f"completed [%], {title}", 100 * published.completeness, share, digits=1, step=0.1)


def _compare(quantity: str, published: float, ours: Interval, *, digits: int, step: float) -> Dict[str, Any]:
    """Makes the row of a figure, with so many digits. The paper's is rounded to multiples of `step`."""
    paper = f"{published:.{digits}f}"
    here = ours.text(digits)
    low, high = (ours.estimate if math.isnan(limit) else limit for limit in (ours.low, ours.high))
    tolerance = 0.5 * step
    reading = "better" if ours.estimate > published else "worse"
    if low - tolerance <= published <= high + tolerance:
        reading = "same"
    difference = f"{ours.estimate - published:+.{digits}f}".replace("-", "\N{MINUS SIGN}")
    if math.isnan(ours.estimate):
        reading = "unknown"
        difference = here
    return {"quantity": quantity, "paper": paper, "here": here, "difference": difference, "reading": reading}


def plausible_worlds_section(study: StudyResults) -> List[Block]:
    """Reports the conclusions over worlds in which all assumptions differ at once.

    Empty where draws.csv or worlds.csv is missing.
    """
    if WORLDS not in study.tables or len(study.methods) < 2 or not (study.folder / DRAWS).is_file():
        return []
    inputs = read_sheet(study.folder / DRAWS, ("draw",)).columns[1:]
    table, (first, baseline) = study.tables[WORLDS], study.comparison
    baseline_rows = select(table, method=baseline)
    paired_rows = select(table, method=first).merge(baseline_rows, on=["draw", "scenario"], suffixes=("", "_base"))
    introduction = (
        f"All {len(inputs)} assumptions vary together over their plausible ranges: a Latin hypercube of "
        f"{table.draw.nunique()} draws."
    )
    heads = column_headings("conclusion", "worlds", "holds", "n", holds="holds in [%] of worlds", n="Number")
    explanation = (
        "Wilson's 95 % intervals. The ranges are assumed, too: a share of worlds is no probability that a conclusion is "
        "true. A world is a draw of all assumptions, with one person who tries both methods. "
        "Too bright: the lab's own check of the cameras asks for a shorter exposure before anybody draws."
    )
    return [introduction, Table("worlds", heads, conclusions(study, paired_rows), {"holds": 0}, explanation)]


def _completed(rows: pandas.DataFrame, column: str) -> Tuple[pandas.Series, pandas.Series]:
    """Returns a measure with either method, nan unless both were completed."""
    done = (rows.completed == 1) & (rows.completed_base == 1) & rows[column].notna() & rows[f"{column}_base"].notna()
    return rows[column].where(done), rows[f"{column}_base"].where(done)


def conclusions(study: StudyResults, worlds: pandas.DataFrame) -> List[Dict[str, Any]]:
    """Computes the share of worlds in which each conclusion holds: of all, and of those with no camera too bright."""
    time, time_base = _completed(worlds, "time_total_s")
    error, error_base = _completed(worlds, "error_mean_cm")
    claims = {
        "faster, whether completed or not": (worlds.time_total_s < worlds.time_total_s_base, worlds.completed.notna()),
        "faster (both completed)": (time < time_base, time.notna()),
        "at least 1.5 times as fast (both completed)": (1.5 * time < time_base, time.notna()),
        f"mean boundary error at most {TOLERATED_CM} cm larger": (error <= error_base + TOLERATED_CM, error.notna()),
        "completed wherever robot only was": (worlds.completed == 1, worlds.completed_base == 1),
        **{
            f"completed: {paper_results.method_title(method).lower()}": (column == 1, column.notna())
            for method, column in zip(study.comparison, (worlds.completed, worlds.completed_base))
        },
    }
    scopes = {"all": True, "no camera too bright": worlds.too_bright == 0}
    rows = []
    for claim, (holds, is_known) in claims.items():
        for scope, within in scopes.items():
            outcomes = holds[is_known & within]
            share = statistics.proportion(int(outcomes.sum()), len(outcomes)).scaled(100.0)
            rows.append({"conclusion": claim, "worlds": scope, "n": len(outcomes), "holds": share})
    return rows
