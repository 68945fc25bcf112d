"""Reads and reports what participants answered."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, List

import pandas

from vb_evaluation.report.comparisons import tabulate_tests
from vb_evaluation.report.paper_results import METHOD_TITLES, METHODS
from vb_evaluation.report.study_files import QUESTIONNAIRE_FILES, StudyResults, read_flags, read_sheet, refuse_cells
from vb_evaluation.statistics import format_number, hodges_lehmann, paired_differences

# the paper's (Sect. 5.5 and 5.8.2)
STATEMENTS = (
    ("I had problems to define the virtual borders", "1 = big problems, 5 = no problems"),
    ("It was intuitive to define the virtual borders", "1 = not intuitive, 5 = intuitive"),
    ("It was physically or mentally demanding to define the virtual borders", "1 = hard, 5 = easy"),
    ("It was easy to learn the handling of the interaction method", "1 = hard, 5 = easy"),
    ("I liked the feedback of the system", "1 = bad/no feedback, 5 = good feedback"),
)
QUESTION = "Did the smart environment support the interaction process?"
RATINGS = [f"s{number}_{method}" for number in range(1, len(STATEMENTS) + 1) for method in METHODS]
COLUMNS = ["participant", *RATINGS, "helped"]


def read_questionnaire(path: Path) -> pandas.DataFrame:
    """Reads the answers to the paper's questionnaire from a CSV file with COLUMNS and one line per participant.

    Returns:
        The columns as numbers, nan for a missing answer: ratings 1 .. 5, `helped` 1 or 0.

    Raises:
        CodedError: "bad_questionnaire" naming the column, or the line.
    """
    sheet = read_sheet(path, COLUMNS, "bad_questionnaire")
    names = sheet.participant
    is_wrong = names.duplicated() | (names == "")
    refuse_cells(names, is_wrong, path, "a name that no other line has", "bad_questionnaire")
    answers = pandas.DataFrame(index=sheet.index)
    for column in RATINGS:
        cells = sheet[column]
        refuse_cells(cells, ~cells.isin(["", *"12345"]), path, "a whole number from 1 to 5", "bad_questionnaire")
        answers[column] = pandas.to_numeric(cells)
    answers["helped"] = read_flags(sheet.helped, path, "bad_questionnaire").astype(float)
    return answers


def compare_ratings(study: StudyResults) -> List[Dict[str, Any]]:
    """Compares the methods' ratings by the people who gave both, a row for each statement. None for simulated people."""
    path = study.folder / QUESTIONNAIRE_FILES[0]
    if not (study.has_people and path.is_file()):
        return []
    answers = read_questionnaire(path)
    rows = []
    differences = []
    for number, (statement, _) in enumerate(STATEMENTS, 1):
        ratings = answers[[f"s{number}_{method}" for method in METHODS]].dropna()
        means = [format_number(mean, 2) for mean in ratings.mean()]
        differences.append(paired_differences(*ratings.to_numpy().T))
        shift = hodges_lehmann(differences[-1]).text(2)
        rows.append({"Statement": statement, **dict(zip(METHOD_TITLES.values(), means)), "Difference": shift})
    helped = f"yes: {answers.helped.sum():.0f} of {answers.helped.count()}"
    return [*tabulate_tests(rows, differences), {"Statement": QUESTION, METHOD_TITLES["nrs"]: helped}]


def summarize_demographics(study: StudyResults) -> List[Dict[str, Any]]:
    """Describes who took part, none for simulated people."""
    path = study.folder / QUESTIONNAIRE_FILES[1]
    if not (study.has_people and path.is_file()):
        return []
    people = read_sheet(path, ("participant",)).drop(columns="participant")
    heading = f"Answers of {len(people)} people"
    return [{"Question": key, heading: _summarize(answers[answers != ""])} for key, answers in people.items()]


def _summarize(answers: pandas.Series) -> str:
    """Describes answers as the paper does: years and ratings by mean, standard deviation and range, others by counts."""
    numbers = pandas.to_numeric(answers, errors="coerce")
    if len(answers) > 1 and numbers.notna().all():
        extent = f"{numbers.min():g} to {numbers.max():g}"
        return f"M = {numbers.mean():.1f}, SD = {numbers.std():.1f}, {extent}, n = {len(numbers)}"
    return "; ".join(f"{value}: {count}" for value, count in answers.value_counts().sort_index().items())
