"""Reads and reports what participants answered, and reports what measuring their runs warned of.

UEQ-S: Schrepp, Hinderks, Thomaschewski, "Design and Evaluation of a Short Version of the User Experience Questionnaire
(UEQ-S)", IJIMAI 4(6), 2017. Items 1 to 4 are pragmatic, 5 to 8 hedonic quality, each the mean of items in -3 .. 3.
"""

from __future__ import annotations

from pathlib import Path
from typing import List, NamedTuple

import numpy as np
import pandas

from vb_core.errors import CodedError
from vb_evaluation import statistics
from vb_evaluation.report import effect_sizes
from vb_evaluation.report.blocks import Block, Table, column_headings
from vb_evaluation.report.paper_results import METHODS
from vb_evaluation.report.study_files import QUESTIONNAIRE_FILES, WARNINGS, StudyResults, read_sheet, yes_or_no

# the paper's (Sect. 5.5 and 5.8.2)
STATEMENTS = (
    ("I had problems to define the virtual borders", "1 = big problems, 5 = no problems"),
    ("It was intuitive to define the virtual borders", "1 = not intuitive, 5 = intuitive"),
    ("It was physically or mentally demanding to define the virtual borders", "1 = hard, 5 = easy"),
    ("It was easy to learn the handling of the interaction method", "1 = hard, 5 = easy"),
    ("I liked the feedback of the system", "1 = bad/no feedback, 5 = good feedback"),
)
# (left end, right end) in the published order; 1 is the left box
UEQ_S = (
    ("obstructive", "supportive"),
    ("complicated", "easy"),
    ("inefficient", "efficient"),
    ("confusing", "clear"),
    ("boring", "exciting"),
    ("not interesting", "interesting"),
    ("conventional", "inventive"),
    ("usual", "leading edge"),
)
UEQ_SCALES = (
    ("UEQ-S, pragmatic quality", range(1, 5)),
    ("UEQ-S, hedonic quality", range(5, 9)),
    ("UEQ-S, overall", range(1, 9)),
)
QUESTION = "Did the smart environment support the interaction process?"
# the columns that the CSV file must have, and those of the UEQ-S, which it may leave out
COLUMNS = [
    "participant",
    *(f"s{number}_{method}" for number in range(1, len(STATEMENTS) + 1) for method in METHODS),
    "helped",
]
UEQ_COLUMNS = [f"u{number}_{method}" for number in range(1, len(UEQ_S) + 1) for method in METHODS]


class Answers(NamedTuple):
    """The answers to one statement or scale, by those who answered for both methods.

    Attributes:
        first, second: (N,) for METHODS[0] and METHODS[1]; the higher, the better.
    """

    statement: str
    first: np.ndarray
    second: np.ndarray


class Questionnaire(NamedTuple):
    """All answers; `helped` of `asked` said yes to the question."""

    answers: List[Answers]
    helped: int
    asked: int


def read_questionnaire(path: Path) -> Questionnaire:
    """Reads the answers from the CSV file of the paper's questionnaire, and the UEQ-S with it.

    One line per participant; the columns are `participant`, for each statement and method `s1_nrs` ... `s5_robot_only`
    with whole numbers from 1 to 5, `helped` with yes or no, and, if the UEQ-S was asked, `u1_nrs` ... `u8_robot_only`
    with the box that was ticked, 1 to 7 from left to right. An empty cell is a missing answer.

    Raises:
        CodedError: "bad_questionnaire" naming the column, or the line.
    """
    sheet = read_sheet(path, COLUMNS, "bad_questionnaire")
    for line, name in sheet.participant[sheet.participant.duplicated() | (sheet.participant == "")].items():
        reason = f"participant: expected a name that no other line has, got '{name}'"
        raise CodedError("bad_questionnaire", f"{path}, line {line}: {reason}")
    if not len(sheet):
        raise CodedError("bad_questionnaire", f"{path}: nobody has answered yet")

    def numbers(column: str, highest: int) -> List[float]:
        """Returns a column's answers, nan for each missing one. Without such a column there are none."""
        cells = sheet.get(column, pandas.Series(dtype=str))
        return [_answer(text, f"{path}, line {line}: {column}", highest) for line, text in cells.items()]

    def means(items: List[str], highest: int) -> np.ndarray:
        """Returns the means over some items, (2, N) for METHODS, of the people who answered all of them."""
        pairs = np.array([np.mean([numbers(f"{item}_{m}", highest) for item in items], axis=0) for m in METHODS])
        return pairs[:, np.isfinite(pairs).all(axis=0)]

    answers = [Answers(words, *means([f"s{number}"], 5)) for number, (words, _) in enumerate(STATEMENTS, 1)]
    for words, items in UEQ_SCALES:
        first, second = means([f"u{number}" for number in items], 7) - 4.0
        answers += [Answers(words, first, second)] if len(first) else []
    helped = []
    for line, text in sheet.helped[sheet.helped != ""].items():
        helped.append(yes_or_no(text, f"{path}, line {line}: helped", "bad_questionnaire"))
    return Questionnaire(answers, sum(helped), len(helped))


def _answer(text: str, place: str, highest: int) -> float:
    if text and not (text.isdigit() and 1 <= int(text) <= highest):
        raise CodedError("bad_questionnaire", f"{place}: expected a whole number from 1 to {highest}, got '{text}'")
    return float(text or "nan")


def participants_section(study: StudyResults) -> List[Block]:
    """Reports who took part and what they answered, nothing for simulated people."""
    questionnaire_file, demographics_file = (study.folder / name for name in QUESTIONNAIRE_FILES)
    blocks: List[Block] = []
    if study.has_people and demographics_file.is_file():
        demographics = read_sheet(demographics_file, ("participant",)).drop(columns="participant")
        heads = column_headings("question", "answers", answers=f"Answers of {len(demographics)} people")
        rows = [{"question": key, "answers": _summary(column[column != ""])} for key, column in demographics.items()]
        blocks.append(Table("demographics", heads, rows))
    if study.has_people and questionnaire_file.is_file():
        replies = read_questionnaire(questionnaire_file)
        rows = [
            {
                "statement": answers.statement,
                "nrs": float(answers.first.mean()),
                "robot_only": float(answers.second.mean()),
                **effect_sizes.wilcoxon_row(statistics.compare_paired(answers.first, answers.second)),
            }
            for answers in replies.answers
        ]
        effect_sizes.add_holm(rows[: len(STATEMENTS)])
        effect_sizes.add_holm(rows[len(STATEMENTS) :])
        heads = column_headings(
            "statement", "nrs", "robot_only", "shift", "z", "p", "holm", "r", "n", shift="Difference", n="People"
        )
        introduction = (
            "The paper's five statements (1 to 5, 5 is the good end) and the UEQ-S (−3 to 3): means, Hodges-Lehmann difference, "
            "Wilcoxon signed-rank test; Holm over the statements and over the scales."
        )
        helped = f"{QUESTION} Yes: {replies.helped} of {replies.asked}."
        blocks += [introduction, Table("questionnaire", heads, rows, {"z": 3}), helped]
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
    rows = read_sheet(study.folder / WARNINGS, ("warning",)).to_dict("records")
    return [Table("warnings", {"warning": f"What measuring the recordings warned of: {len(rows)}"}, rows)]
