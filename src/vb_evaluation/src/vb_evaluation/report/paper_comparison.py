"""Writes the section that puts each figure of the paper beside ours, in both directions."""

from __future__ import annotations

import math
from typing import Any, Dict, List

from vb_evaluation import statistics
from vb_evaluation.report import effect_sizes, paper
from vb_evaluation.report.blocks import Grid, Section, Text
from vb_evaluation.report.data import StudyResults, known, select
from vb_evaluation.report.paper import PAPER
from vb_evaluation.statistics import Interval


_WHY = {
    (
        "speed-up",
        "above",
    ): "The paper's people lost time with both methods alike (thinking, looking, talking), which makes a ratio "
    "smaller; here only the assumed reactions, looks and words cost time.",
    (
        "speed-up",
        "below",
    ): "The paper gives no times by method, so it is not known which state makes the difference; the hand's and "
    "the robot's speed are inputs here.",
    (
        "Jaccard",
        "above",
    ): "The simulated lab or its people are too optimistic here: tape, aim, localisation and calibration errors "
    "are assumed, the paper's truth was drawn by hand over a laser map, and extraction is this project's.",
    (
        "Jaccard",
        "below",
    ): "The people here mean, aim or close the line worse than the paper's did, or the map's errors are larger.",
    ("completed", "above"): "The share of mistakes is assumed.",
    (
        "completed",
        "below",
    ): "The share of mistakes is assumed, and a person here gives up after a fixed number of tries.",
    ("Border", "above"): "The border is drawn at assumed speeds.",
    ("Border", "below"): "The border is drawn at assumed speeds.",
}


def paper_comparison_section(study: StudyResults) -> Section:
    """Puts each figure of the paper beside ours, in both directions: being better does not count as agreement."""
    methods = ("nrs", "robot_only")
    rows: List[Dict[str, Any]] = []
    for scenario in PAPER if set(methods) <= set(study.methods) else ():
        here = select(study.runs, scenario=scenario)
        if not len(here):
            continue
        published = PAPER[scenario]
        rows.append(_compare(study, scenario, "speed-up", published.speedup, effect_sizes.ratio(here, methods), 2))
        if published.border_gain_s is not None:
            gain = effect_sizes.mean_difference(here, "time_border_s", methods[::-1])
            rows.append(_compare(study, scenario, "Border state shorter by [s]", published.border_gain_s, gain, 1))
        for method in methods:
            done = known(select(here, method=method, completed=1), "jaccard")
            rows.append(
                _compare(
                    study,
                    scenario,
                    f"Jaccard index, {paper.method_title(method).lower()}",
                    published.jaccard[method],
                    statistics.median(done),
                    3,
                )
            )
            if scenario == "corner" and here.jaccard_enclosed.notna().any():
                inside = known(select(here, method=method, completed=1), "jaccard_enclosed")
                rows.append(
                    _compare(
                        study,
                        scenario,
                        f"Jaccard index of the area drawn round, {paper.method_title(method).lower()}",
                        published.jaccard[method],
                        statistics.median(inside),
                        3,
                    )
                )
            flags = known(select(here, method=method), "completed")
            share = statistics.proportion(int(flags.sum()), len(flags)).scaled(100.0)
            name = f"completed [%], {paper.method_title(method).lower()}"
            rows.append(_compare(study, scenario, name, 100 * published.completeness, share, 1))
    if not rows:
        return Section("paper", "Beside the paper", [])
    counts = {word: sum(row["reading"].startswith(word) for row in rows) for word in ("same", "better", "worse")}
    grid = Grid(
        "beside_the_paper",
        {
            "scenario": "Scenario",
            "quantity": "Quantity",
            "paper": "Paper",
            "here": "Here [95 %]",
            "difference": "Here minus paper",
            "reading": "Reading",
            "why": "Why, as far as known",
        },
        rows,
    )
    return Section(
        "paper",
        "Beside the paper",
        [
            Text(
                (
                    f"{paper.CITATION}. It measured 15 people in a real lab.",
                    "Same: the paper's figure lies in our 95 % interval. Better and worse are both disagreement: a simulation whose "
                    "people do better than real people is wrong in that figure, too. "
                    f"Of {len(rows)} figures {counts['same']} are the same, {counts['better']} better, {counts['worse']} worse.",
                )
            ),
            grid,
            Text(
                (
                    "Spot cleaning's index can be read in two ways. As the index of the restricted floor (all but 3.2 of 40 m\u00b2), the "
                    "paper's .878 would need a border that is more than a metre off everywhere. As the index of the 3.2 m\u00b2 that its "
                    'people drew round, it needs about 11 cm. The paper\'s maps colour "the area to be specified", which makes the second '
                    "reading likelier; both are given. The paper's people had a heap of paper snippets and no line to follow; marks on the "
                    "floor are easier. In room exclusion .971 is some 30 cm along the doorway's line, or a hand-drawn ground truth that "
                    "ends 1 cm before the walls on average; then the index says nothing about people. Both methods had nearly the same "
                    "index (.971, .974), which makes the second likelier.",
                )
            ),
            Text(
                (
                    "The paper prints no intervals. Its figures come from 15 people and are uncertain themselves, so fewer figures really "
                    'differ than the table says. With few participants our intervals are wide, too, and "same" says little.',
                ),
                "caveat",
            ),
        ],
    )


def _compare(
    study: StudyResults, scenario: str, quantity: str, published: float, ours: Interval, digits: int
) -> Dict[str, Any]:
    low, high = (ours.estimate if math.isnan(limit) else limit for limit in (ours.low, ours.high))
    tolerance = 0.5 * 10.0 ** -(3 if digits == 3 else 1)  # the paper's figures are rounded
    above = ours.estimate > published
    reading = "same" if low - tolerance <= published <= high + tolerance else ("better" if above else "worse")
    if math.isnan(ours.estimate):
        reading = "unknown"
    side = "above" if above else "below"
    why = next((words for (start, which), words in _WHY.items() if quantity.startswith(start) and which == side), "")
    return {
        "scenario": study.scenario_title(scenario),
        "quantity": quantity,
        "paper": f"{published:.{digits}f}",
        "here": ours.text(digits),
        "difference": f"{ours.estimate - published:+.{digits}f}".replace("-", "\N{MINUS SIGN}"),
        "reading": reading,
        "why": why if reading in ("better", "worse") and not study.people else "",
    }
