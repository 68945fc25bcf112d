"""Reads and reports what participants answered, and reports what measuring their runs warned of.

UEQ-S: Schrepp, Hinderks, Thomaschewski, "Design and Evaluation of a Short Version of the User Experience Questionnaire
(UEQ-S)", IJIMAI 4(6), 2017. Items 1 to 4 are pragmatic, 5 to 8 hedonic quality, each the mean of items in -3 .. 3.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, List, Mapping

import numpy as np
import pandas

from vb_core.errors import CodedError
from vb_evaluation.report import effect_sizes
from vb_evaluation.report.paper_results import METHOD_TITLES, METHODS
from vb_evaluation.report.study_files import (
    QUESTIONNAIRE_FILES,
    WARNINGS,
    StudyResults,
    read_sheet,
    refuse_cells,
    yes_or_no,
)
from vb_evaluation.report.table import Table
from vb_evaluation.statistics import paired_differences

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
UEQ_SCALES = {
    "UEQ-S, pragmatic quality": range(1, 5),
    "UEQ-S, hedonic quality": range(5, 9),
    "UEQ-S, overall": range(1, 9),
}
QUESTION = "Did the smart environment support the interaction process?"
# the columns that the CSV file must have, and those of the UEQ-S, which it may leave out
COLUMNS = [
    "participant",
    *(f"s{number}_{method}" for number in range(1, len(STATEMENTS) + 1) for method in METHODS),
    "helped",
]
UEQ_COLUMNS = [f"u{number}_{method}" for number in range(1, len(UEQ_S) + 1) for method in METHODS]


def read_questionnaire(path: Path) -> pandas.DataFrame:
    """Reads the answers from the CSV file of the paper's questionnaire, and the UEQ-S with it.

    One line per participant; the columns are `participant`, for each statement and method `s1_nrs` ... `s5_robot_only`
    with whole numbers from 1 to 5, `helped` with yes or no, and, if the UEQ-S was asked, `u1_nrs` ... `u8_robot_only`
    with the box that was ticked, 1 to 7 from left to right. An empty cell is a missing answer.

    Returns:
        The columns as numbers, nan for a missing answer; `helped` 1 or 0.

    Raises:
        CodedError: "bad_questionnaire" naming the column, or the line.
    """
    sheet = read_sheet(path, COLUMNS, "bad_questionnaire")
    if not len(sheet):
        raise CodedError("bad_questionnaire", f"{path}: nobody has answered yet")
    names = sheet.participant
    is_wrong = names.duplicated() | (names == "")
    refuse_cells(names, is_wrong, path, "a name that no other line has", "bad_questionnaire")
    answers = pandas.DataFrame(index=sheet.index)
    for column in COLUMNS[1:-1] + UEQ_COLUMNS:
        highest = 5 if column.startswith("s") else 7
        cells = sheet.get(column, pandas.Series("", sheet.index, name=column))
        is_wrong = ~cells.isin(["", *map(str, range(1, highest + 1))])
        refuse_cells(cells, is_wrong, path, f"a whole number from 1 to {highest}", "bad_questionnaire")
        answers[column] = pandas.to_numeric(cells)
    flags = []
    for line, text in sheet.helped.items():
        flags.append(yes_or_no(text, f"{path}, line {line}: helped", "bad_questionnaire"))
    answers["helped"] = np.array(flags, float)
    return answers


def demographics_table(study: StudyResults) -> Table:
    """Reports who took part, nothing for simulated people."""
    path = study.folder / QUESTIONNAIRE_FILES[1]
    rows = []
    if study.has_people and path.is_file():
        people = read_sheet(path, ("participant",)).drop(columns="participant")
        heading = f"Answers of {len(people)} people"
        rows = [{"Question": key, heading: _summary(answers[answers != ""])} for key, answers in people.items()]
    return Table("demographics", "People", "", rows)


def _summary(answers: pandas.Series) -> str:
    """Describes answers as the paper does: years and ratings by mean, standard deviation and range, others by counts."""
    numbers = pandas.to_numeric(answers, errors="coerce")
    if len(answers) > 1 and numbers.notna().all():
        mean = f"M = {numbers.mean():.1f}, SD = {numbers.std():.1f}"
        extent = f"{numbers.min():g} to {numbers.max():g}"
        return f"{mean}, {extent}, n = {len(numbers)}"
    counts = answers.value_counts().sort_index()
    return "; ".join(f"{value}: {count}" for value, count in counts.items())


def questionnaire_table(study: StudyResults) -> Table:
    """Reports what people answered, nothing for simulated people."""
    path = study.folder / QUESTIONNAIRE_FILES[0]
    rows: List[Dict[str, Any]] = []
    helped = ""
    if study.has_people and path.is_file():
        answers = read_questionnaire(path)
        statements = {words: [f"s{number}"] for number, (words, _) in enumerate(STATEMENTS, 1)}
        scales = {words: [f"u{number}" for number in items] for words, items in UEQ_SCALES.items()}
        rows = [*_compare_answers(answers, statements), *_compare_answers(answers - 4.0, scales)]
        helped = f"{QUESTION} Yes: {answers.helped.sum():.0f} of {answers.helped.count()}."
    text = (
        "The paper's five statements (1 to 5, 5 is the good end) and the UEQ-S (−3 to 3): means, Hodges-Lehmann difference, "
        f"Wilcoxon signed-rank test; Holm over the statements and over the scales.\n\n{helped}"
    )
    return Table("questionnaire", "Experience", text, rows, {"Z": 3})


def _compare_answers(answers: pandas.DataFrame, families: Mapping[str, List[str]]) -> List[Dict[str, Any]]:
    """Compares the means over some items, of the people who answered all of them for both methods: a row for each name."""
    means = {}
    differences = {}
    for name, items in families.items():
        scores = pandas.DataFrame()
        for method in METHODS:
            columns = [f"{item}_{method}" for item in items]
            scores[METHOD_TITLES[method]] = answers[columns].mean(axis=1, skipna=False)
        scores = scores.dropna()
        means[name] = scores.mean().to_dict()
        differences[name] = paired_differences(*scores.to_numpy().T)
    tests = effect_sizes.wilcoxon_rows(differences)
    return [{"Statement": name, **means[name], **test} for name, test in tests.items()]


def warnings_table(study: StudyResults) -> Table:
    """Lists the warnings from measuring the recordings."""
    path = study.folder / WARNINGS
    warnings = read_sheet(path, ("warning",)).warning if path.is_file() else []
    return Table("warnings", "Warnings", "From measuring the recordings.", [{"Warning": text} for text in warnings])
