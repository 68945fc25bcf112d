"""Writes the sections on the participants and on what measuring their runs warned of."""

from __future__ import annotations

from typing import List

import pandas

from vb_evaluation import statistics
from vb_evaluation.report import effect_sizes, questionnaire
from vb_evaluation.report.page_blocks import Block, Table, columns
from vb_evaluation.report.study_files import SHEETS, WARNINGS, StudyResults, read_sheet


def participants_section(study: StudyResults) -> List[Block]:
    """Reports who took part and what they answered; empty for simulated people."""
    questionnaire_file, demographics_file = (study.folder / name for name in SHEETS)
    blocks: List[Block] = []
    if study.people and demographics_file.is_file():
        demographics = read_sheet(demographics_file, ("participant",)).drop(columns="participant")
        blocks.append(
            Table(
                "demographics",
                columns("question", "answers", answers=f"Answers of {len(demographics)} people"),
                [
                    {"question": column, "answers": _summary(answers[answers != ""])}
                    for column, answers in demographics.items()
                ],
            )
        )
    if study.people and questionnaire_file.is_file():
        replies = questionnaire.read(questionnaire_file)
        rows = [
            {
                "statement": answers.statement,
                "nrs": float(answers.first.mean()),
                "robot_only": float(answers.second.mean()),
                **effect_sizes.wilcoxon_row(statistics.compare_paired(answers.first, answers.second)),
            }
            for answers in replies.answers
        ]
        effect_sizes.add_holm(rows[: len(questionnaire.STATEMENTS)])
        effect_sizes.add_holm(rows[len(questionnaire.STATEMENTS) :])
        heads = columns(
            "statement", "nrs", "robot_only", "shift", "z", "p", "holm", "r", "n", shift="Difference", n="People"
        )
        blocks += [
            (
                "The paper's five statements (1 to 5, 5 is the good end) and the UEQ-S (−3 to 3): means, Hodges-Lehmann difference, "
                "Wilcoxon signed-rank test; Holm over the statements and over the scales."
            ),
            Table("questionnaire", heads, rows, {"z": 3}),
            f"{questionnaire.QUESTION} Yes: {replies.helped} of {replies.asked}.",
        ]
    return blocks


def _summary(answers: pandas.Series) -> str:
    """Describes answers as the paper does: years and ratings by mean, standard deviation and range, others by counts."""
    numbers = pandas.to_numeric(answers, errors="coerce")
    if len(answers) > 1 and numbers.notna().all():
        return f"M = {numbers.mean():.1f}, SD = {numbers.std():.1f}, {numbers.min():g} to {numbers.max():g}, n = {len(numbers)}"
    return "; ".join(f"{value}: {count}" for value, count in answers.value_counts().sort_index().items())


def runs_section(study: StudyResults) -> List[Block]:
    """Lists the warnings from measuring the recordings."""
    if not (study.folder / WARNINGS).is_file():
        return []
    warnings = list(read_sheet(study.folder / WARNINGS, ("warning",)).warning)
    rows = [{"warning": words} for words in warnings]
    return [Table("warnings", {"warning": f"What measuring the recordings warned of: {len(warnings)}"}, rows)]
