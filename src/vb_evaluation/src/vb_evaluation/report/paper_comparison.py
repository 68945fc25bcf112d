"""Writes the section that puts each figure of the paper beside ours, in both directions."""

from __future__ import annotations

import math
from typing import Any, Dict, Iterator, List, Tuple

from vb_evaluation import statistics
from vb_evaluation.report import effect_sizes, paper
from vb_evaluation.report.blocks import Block, Grid, Text
from vb_evaluation.report.data import StudyResults, known, select
from vb_evaluation.report.paper import PAPER
from vb_evaluation.statistics import Interval

METHODS = ("nrs", "robot_only")
# by how a quantity's name begins: why ours is above the paper's, why below
_WHY = {
    "speed-up": (
        "The paper's people lost time with both methods alike (thinking, looking, talking), which makes a ratio smaller; here only the "
        "assumed reactions, looks and words cost time.",
        "The paper gives no times by method, so it is not known which state makes the difference; the hand's and the robot's speed are "
        "inputs here.",
    ),
    "Jaccard": (
        "The simulated lab or its people are too optimistic here: tape, aim, localisation and calibration errors are assumed, the "
        "paper's truth was drawn by hand over a laser map, and extraction is this project's.",
        "The people here mean, aim or close the line worse than the paper's did, or the map's errors are larger.",
    ),
    "completed": (
        "The share of mistakes is assumed.",
        "The share of mistakes is assumed, and a person here gives up after a fixed number of tries.",
    ),
    "Border": ("The border is drawn at assumed speeds.", "The border is drawn at assumed speeds."),
}


def paper_comparison_section(study: StudyResults) -> List[Block]:
    """Puts each figure of the paper beside ours, in both directions: being better does not count as agreement."""
    rows = [
        _compare(study, scenario, *figure)
        for scenario in (PAPER if set(METHODS) <= set(study.methods) else ())
        for figure in _figures(study, scenario)
    ]
    if not rows:
        return []
    counts = {word: sum(row["reading"].startswith(word) for row in rows) for word in ("same", "better", "worse")}
    columns = {
        "scenario": "Scenario",
        "quantity": "Quantity",
        "paper": "Paper",
        "here": "Here [95 %]",
        "difference": "Here minus paper",
        "reading": "Reading",
        "why": "Why, as far as known",
    }
    return [
        Text(f"{paper.CITATION}. It measured 15 people in a real lab."),
        Text(
            "Same: the paper's figure lies in our 95 % interval. Better and worse are both disagreement: a simulation whose "
            "people do better than real people is wrong in that figure, too. "
            f"Of {len(rows)} figures {counts['same']} are the same, {counts['better']} better, {counts['worse']} worse."
        ),
        Grid("beside_the_paper", columns, rows),
        Text(
            "Spot cleaning's index can be read in two ways. As the index of the restricted floor (all but 3.2 of 40 m\u00b2), the "
            "paper's .878 would need a border that is more than a metre off everywhere. As the index of the 3.2 m\u00b2 that its "
            'people drew round, it needs about 11 cm. The paper\'s maps colour "the area to be specified", which makes the second '
            "reading likelier; both are given. The paper's people had a heap of paper snippets and no line to follow; marks on the "
            "floor are easier. In room exclusion .971 is some 30 cm along the doorway's line, or a hand-drawn ground truth that "
            "ends 1 cm before the walls on average; then the index says nothing about people. Both methods had nearly the same "
            "index (.971, .974), which makes the second likelier."
        ),
        Text(
            "The paper prints no intervals. Its figures come from 15 people and are uncertain themselves, so fewer figures really "
            'differ than the table says. With few participants our intervals are wide, too, and "same" says little.',
            caveat=True,
        ),
    ]


def _figures(study: StudyResults, scenario: str) -> Iterator[Tuple[str, float, Interval, int]]:
    """Yields (quantity, the paper's figure, ours, digits) of a scenario, if it was run."""
    here, published = select(study.runs, scenario=scenario), PAPER[scenario]
    if not len(here):
        return
    yield "speed-up", published.speedup, effect_sizes.ratio(here, METHODS), 2
    if published.border_gain_s is not None:
        gain = effect_sizes.mean_difference(here, "time_border_s", METHODS[::-1])
        yield "Border state shorter by [s]", published.border_gain_s, gain, 1
    for method in METHODS:
        title, runs = paper.method_title(method).lower(), select(here, method=method)
        done = select(runs, completed=1)
        yield f"Jaccard index, {title}", published.jaccard[method], statistics.median(known(done, "jaccard")), 3
        if scenario == "corner" and here.jaccard_enclosed.notna().any():
            inside = statistics.median(known(done, "jaccard_enclosed"))
            yield f"Jaccard index of the area drawn round, {title}", published.jaccard[method], inside, 3
        flags = known(runs, "completed")
        share = statistics.proportion(int(flags.sum()), len(flags)).scaled(100.0)
        yield f"completed [%], {title}", 100 * published.completeness, share, 1


def _compare(
    study: StudyResults, scenario: str, quantity: str, published: float, ours: Interval, digits: int
) -> Dict[str, Any]:
    low, high = (ours.estimate if math.isnan(limit) else limit for limit in (ours.low, ours.high))
    tolerance = 0.5 * 10.0 ** -(3 if digits == 3 else 1)  # the paper's figures are rounded
    above = ours.estimate > published
    reading = "same" if low - tolerance <= published <= high + tolerance else ("better" if above else "worse")
    if math.isnan(ours.estimate):
        reading = "unknown"
    why = next((words[not above] for start, words in _WHY.items() if quantity.startswith(start)), "")
    return {
        "scenario": study.scenario_title(scenario),
        "quantity": quantity,
        "paper": f"{published:.{digits}f}",
        "here": ours.text(digits),
        "difference": f"{ours.estimate - published:+.{digits}f}".replace("-", "\N{MINUS SIGN}"),
        "reading": reading,
        "why": why if reading in ("better", "worse") and not study.people else "",
    }
