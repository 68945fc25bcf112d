"""The paper's questionnaire (Sect. 5.5 and 5.8.2), and the UEQ-S beside it; one CSV file.

One line per participant; the columns are `participant`, for each statement and method `s1_nrs` ... `s5_robot_only`
with whole numbers from 1 to 5, `helped` with yes or no, and, if the UEQ-S was asked, `u1_nrs` ... `u8_robot_only` with
the box that was ticked, 1 to 7 from left to right. An empty cell is a missing answer.

UEQ-S: Schrepp, Hinderks, Thomaschewski, "Design and Evaluation of a Short Version of the User Experience Questionnaire
(UEQ-S)", IJIMAI 4(6), 2017: items 1 to 4 pragmatic, 5 to 8 hedonic quality, each the mean of items scaled to -3 .. 3.
"""

from __future__ import annotations

from pathlib import Path
from typing import List, NamedTuple

import numpy as np
import pandas

from vb_core.errors import CodedError
from vb_evaluation.report.study_files import read_sheet, yes_or_no
from vb_evaluation.report.paper_results import METHODS

STATEMENTS = (
    ("I had problems to define the virtual borders", "1 = big problems, 5 = no problems"),
    ("It was intuitive to define the virtual borders", "1 = not intuitive, 5 = intuitive"),
    ("It was physically or mentally demanding to define the virtual borders", "1 = hard, 5 = easy"),
    ("It was easy to learn the handling of the interaction method", "1 = hard, 5 = easy"),
    ("I liked the feedback of the system", "1 = bad/no feedback, 5 = good feedback"),
)
# (left, right) end, in the published order; 1 is the left box
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


def read(path: Path) -> Questionnaire:
    """Reads the answers.

    Raises:
        CodedError: "bad_questionnaire" naming the column, or the line.
    """
    sheet = read_sheet(path, COLUMNS, "bad_questionnaire")
    for line, name in sheet.participant[sheet.participant.duplicated() | (sheet.participant == "")].items():
        raise CodedError(
            "bad_questionnaire",
            f"{path}, line {line}: participant: expected a name that no other line has, got '{name}'",
        )
    if not len(sheet):
        raise CodedError("bad_questionnaire", f"{path}: nobody has answered yet")
    numbers = {
        column: [
            _answer(text, f"{path}, line {line}: {column}", most)
            for line, text in sheet.get(column, pandas.Series(dtype=str)).items()
        ]
        for most, names in ((5, COLUMNS[1:-1]), (7, UEQ_COLUMNS))
        for column in names
    }
    parts = [(words, [f"s{number}"], 0.0) for number, (words, _) in enumerate(STATEMENTS, 1)]
    parts += [(words, [f"u{number}" for number in items], 4.0) for words, items in UEQ_SCALES]
    answers = []
    for words, items, middle in parts:
        pairs = np.array(
            [np.mean([numbers[f"{item}_{method}"] for item in items], axis=0) - middle for method in METHODS]
        )
        pairs = pairs[:, np.isfinite(pairs).all(axis=0)]
        if pairs.shape[1] or not middle:
            answers.append(Answers(words, *pairs))
    helped = [
        yes_or_no(text, f"{path}, line {line}: helped", "bad_questionnaire")
        for line, text in sheet.helped.items()
        if text
    ]
    return Questionnaire(answers, sum(helped), len(helped))


def _answer(text: str, where: str, most: int) -> float:
    if text and not (text.isdigit() and 1 <= int(text) <= most):
        raise CodedError("bad_questionnaire", f"{where}: expected a whole number from 1 to {most}, got '{text}'")
    return float(text or "nan")
