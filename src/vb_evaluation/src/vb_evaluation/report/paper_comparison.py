"""Writes the section that compares each figure of the paper with ours, in both directions."""

from __future__ import annotations

import math
from typing import Any, Dict, Iterator, List, Tuple

from vb_evaluation import statistics
from vb_evaluation.report import effect_sizes, paper_results
from vb_evaluation.report.page_blocks import Block, Table, columns
from vb_evaluation.report.study_files import StudyResults, known, pairs, select
from vb_evaluation.report.paper_results import METHODS, PAPER
from vb_evaluation.statistics import Interval


def paper_comparison_section(study: StudyResults) -> List[Block]:
    """Compares each figure of the paper with ours, in both directions: being better does not count as agreement."""
    rows = [
        _compare(study, scenario, *figure)
        for scenario in (PAPER if set(METHODS) <= set(study.methods) else ())
        for figure in _figures(study, scenario)
    ]
    if not rows:
        return []
    counts = {word: sum(row["reading"].startswith(word) for row in rows) for word in ("same", "better", "worse")}
    heads = columns(
        "scenario",
        "quantity",
        "paper",
        "here",
        "difference",
        "reading",
        here="Here [95 %]",
        difference="Here minus paper",
    )
    return [
        f"{paper_results.CITATION}. It measured 15 people in a real lab.",
        (
            "Same: the paper's figure lies in our 95 % interval. Better and worse are both disagreement: a simulation whose "
            "people do better than real people is wrong in that figure, too. "
            f"Of {len(rows)} figures {counts['same']} are the same, {counts['better']} better, {counts['worse']} worse."
        ),
        Table("beside_the_paper", heads, rows),
    ]


def _figures(study: StudyResults, scenario: str) -> Iterator[Tuple[str, float, Interval, int, float]]:
    """Yields (quantity, the paper's figure, ours, digits, the paper's rounding step) of a scenario, if it was run."""
    here, published = select(study.runs, scenario=scenario), PAPER[scenario]
    if not len(here):
        return
    yield "speed-up", published.speedup, effect_sizes.ratio(here, METHODS), 2, 0.1
    if published.border_gain_s is not None:
        with_nrs, alone = pairs(here, "time_border_s", METHODS)
        yield "Border state shorter by [s]", published.border_gain_s, statistics.mean(alone - with_nrs), 1, 1.0
    for method in METHODS:
        title, runs = paper_results.method_title(method).lower(), select(here, method=method)
        done = select(runs, completed=1)
        yield f"Jaccard index, {title}", published.jaccard[method], statistics.median(known(done, "jaccard")), 3, 1e-3
        if scenario == "corner" and here.jaccard_enclosed.notna().any():
            inside = statistics.median(known(done, "jaccard_enclosed"))
            yield f"Jaccard index of the area drawn round, {title}", published.jaccard[method], inside, 3, 1e-3
        flags = known(runs, "completed")
        share = statistics.proportion(int(flags.sum()), len(flags)).scaled(100.0)
        yield f"completed [%], {title}", 100 * published.completeness, share, 1, 0.1


def _compare(
    study: StudyResults, scenario: str, quantity: str, published: float, ours: Interval, digits: int, step: float
) -> Dict[str, Any]:
    low, high = (ours.estimate if math.isnan(limit) else limit for limit in (ours.low, ours.high))
    tolerance = 0.5 * step
    above = ours.estimate > published
    reading = "same" if low - tolerance <= published <= high + tolerance else ("better" if above else "worse")
    difference = f"{ours.estimate - published:+.{digits}f}".replace("-", "\N{MINUS SIGN}")
    if math.isnan(ours.estimate):
        reading, difference = "unknown", ours.text(digits)
    return {
        "scenario": study.scenario_title(scenario),
        "quantity": quantity,
        "paper": f"{published:.{digits}f}",
        "here": ours.text(digits),
        "difference": difference,
        "reading": reading,
    }
