"""Writes the sections on what is behind the figures: order, people, the runs."""

from __future__ import annotations

from typing import Any, Dict, List

import numpy as np
import pandas

from vb_evaluation import statistics
from vb_evaluation.report import effect_sizes, questionnaire
from vb_evaluation.report.blocks import Block, Grid, Text
from vb_evaluation.report.data import WARNINGS, StudyResults, read_sheet


def order_section(study: StudyResults) -> List[Block]:
    """Tests whether it matters which method came first (a two-period crossover), and whether people learn."""
    rows: List[Dict[str, Any]] = []
    for column, words, digits in (("time_total_s", "time [s]", 1), ("error_mean_cm", "mean boundary error [cm]", 2)):
        groups = _by_first(study, column) if len(study.methods) == 2 else []
        if len(groups) != 2 or min(map(len, groups)) < 2:
            continue
        first, second = groups
        # Hills & Armitage 1979: halves of the difference tell the period, sums what is carried over
        for effect, a, b in (
            ("period: second minus first", (second[:, 0] - second[:, 1]) / 2, (first[:, 0] - first[:, 1]) / 2),
            ("carry-over", first.sum(axis=1), second.sum(axis=1)),
        ):
            p, shift = statistics.compare_unpaired(a, b)
            rows.append(
                {
                    "measure": words,
                    "effect": effect,
                    "difference": shift.text(digits),
                    "p": statistics.format_p(p) if study.people else "",
                    "groups": f"{len(first)} + {len(second)}",
                }
            )
    if not rows:
        return []
    words = (
        "Half of the people began with one method, half with the other. Differences between the two groups, Hodges-Lehmann with "
        "95 % interval, means over each person's scenarios. The test of carry-over is weak: not finding any does not rule it out."
    )
    if not study.people:
        words += " Simulated people neither learn nor tire: an interval without 0 would be chance or a fault."
    columns = {"measure": "Measure", "effect": "Effect", "difference": "Difference", "groups": "People"}
    return [Text(words), Grid("order", {**columns, "p": "p (Mann-Whitney)"} if study.people else columns, rows)]


def _by_first(study: StudyResults, column: str) -> List[np.ndarray]:
    """Returns means (N, 2) of each person with the first method and the baseline, for those who began with either."""
    runs = study.runs.dropna(subset=["order"])
    first = runs.loc[runs.groupby("participant").order.idxmin()].set_index("participant").method
    means = study.runs.pivot_table(index="participant", columns="method", values=column, aggfunc="mean")
    means = means.reindex(columns=list(study.comparison)).dropna()
    return [
        group.to_numpy()
        for group in (means[means.index.map(first) == method] for method in study.comparison)
        if len(group)
    ]


def participants_section(study: StudyResults) -> List[Block]:
    """Says who took part and what they answered; empty for simulated people."""
    path, about = study.folder / "questionnaire.csv", study.folder / "demographics.csv"
    blocks: List[Block] = []
    if study.people and about.is_file():
        asked = read_sheet(about, ("participant",)).drop(columns="participant")
        blocks.append(
            Grid(
                "demographics",
                {"question": "Question", "answers": f"Answers of {len(asked)} people"},
                [
                    {"question": column, "answers": _summary(answers[answers != ""])}
                    for column, answers in asked.items()
                ],
            )
        )
    if study.people and path.is_file():
        found = questionnaire.read(path)
        rows = [
            {
                "statement": answers.statement,
                "nrs": effect_sizes.mean(answers.first),
                "robot_only": effect_sizes.mean(answers.second),
                **effect_sizes.test_row(answers.comparison),
            }
            for answers in found.answers
        ]
        effect_sizes.add_holm(rows[: len(questionnaire.STATEMENTS)])
        effect_sizes.add_holm(rows[len(questionnaire.STATEMENTS) :])
        columns = {
            "statement": "Statement",
            "nrs": "Network robot system",
            "robot_only": "Robot only",
            "shift": "Difference",
            "z": "Z",
            "p": "exact p",
            "holm": "p (Holm)",
            "r": "r",
            "n": "People",
        }
        blocks += [
            Text(
                "The paper's five statements (1 to 5, 5 is the good end) and the UEQ-S (−3 to 3): means, Hodges-Lehmann difference, "
                "Wilcoxon signed-rank test; Holm over the statements and over the scales."
            ),
            Grid("questionnaire", columns, rows, {"z": 3}),
            Text(f"{questionnaire.QUESTION} Yes: {found.helped} of {found.asked}."),
        ]
    return blocks


def _summary(answers: pandas.Series) -> str:
    """Describes answers as the paper does: years and ratings by mean, standard deviation and range, others by counts."""
    numbers = pandas.to_numeric(answers, errors="coerce")
    if len(answers) > 1 and numbers.notna().all():
        return f"M = {numbers.mean():.1f}, SD = {numbers.std():.1f}, {numbers.min():g} to {numbers.max():g}, n = {len(numbers)}"
    return "; ".join(f"{value}: {count}" for value, count in answers.value_counts().sort_index().items())


def runs_section(study: StudyResults) -> List[Block]:
    """Says how a row is made again, and what measuring warned of."""
    blocks: List[Block] = []
    if study.meta.get("rerun"):
        blocks.append(
            Text(f"A row again, alone, with its own columns in place of the names in braces: {study.meta['rerun']}")
        )
    if (study.folder / WARNINGS).is_file():
        found = list(read_sheet(study.folder / WARNINGS, ("warning",)).warning)
        rows = [{"warning": words} for words in found]
        blocks.append(Grid("warnings", {"warning": f"What measuring the recordings warned of: {len(found)}"}, rows))
    return blocks
