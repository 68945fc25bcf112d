"""The paper's questionnaire (Sect. 5.5 and 5.8.2), and the UEQ-S beside it; one CSV file.

One line per participant; the columns are `participant`, for each statement and method `s1_nrs` ... `s5_robot_only`
with whole numbers from 1 to 5, `helped` with yes or no, and, if the UEQ-S was asked, `u1_nrs` ... `u8_robot_only` with the
box that was ticked, 1 to 7 from left to right. An empty cell is a missing answer.

UEQ-S: Schrepp, Hinderks, Thomaschewski, "Design and Evaluation of a Short Version of the User Experience Questionnaire
(UEQ-S)", IJIMAI 4(6), 2017: items 1 to 4 pragmatic, 5 to 8 hedonic quality, each the mean of items scaled to -3 .. 3.
"""
from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Sequence, Tuple

import numpy as np

from vb_core.errors import CodedError
from vb_evaluation import statistics

STATEMENTS = (
    ("I had problems to define the virtual borders", "1 = big problems, 5 = no problems"),
    ("It was intuitive to define the virtual borders", "1 = not intuitive, 5 = intuitive"),
    ("It was physically or mentally demanding to define the virtual borders", "1 = hard, 5 = easy"),
    ("It was easy to learn the handling of the interaction method", "1 = hard, 5 = easy"),
    ("I liked the feedback of the system", "1 = bad/no feedback, 5 = good feedback"),
)
# (left, right) end, in the published order; 1 is the left box
UEQ_S = (("obstructive", "supportive"), ("complicated", "easy"), ("inefficient", "efficient"), ("confusing", "clear"),
         ("boring", "exciting"), ("not interesting", "interesting"), ("conventional", "inventive"), ("usual", "leading edge"))
UEQ_SCALES = (("UEQ-S, pragmatic quality", range(1, 5)), ("UEQ-S, hedonic quality", range(5, 9)), ("UEQ-S, overall", range(1, 9)))
QUESTION = "Did the smart environment support the interaction process?"
METHODS = ("nrs", "robot_only")
SCALE = (1, 5)
_YES, _NO = ("yes", "y", "1", "true", "ja"), ("no", "n", "0", "false", "nein")


@dataclass(frozen=True)
class Answers:
    """The answers of one statement, of those who answered for both methods.

    Attributes:
        first, second: (N,) for METHODS[0] and METHODS[1], as on the scale: 5 is always the good end.
    """

    statement: str
    scale: str
    first: np.ndarray
    second: np.ndarray

    @property
    def comparison(self) -> statistics.PairedComparison:
        """Wilcoxon test and effect sizes, first minus second."""
        return statistics.compare(self.first, self.second)


@dataclass(frozen=True)
class Questionnaire:
    """All answers; `helped` of `asked` said yes to the question."""

    answers: Tuple[Answers, ...]
    helped: int
    asked: int


def ueq_columns() -> List[str]:
    """The columns of the UEQ-S, which a file may leave out."""
    return [f"u{number}_{method}" for number in range(1, len(UEQ_S) + 1) for method in METHODS]


def columns() -> List[str]:
    """The columns that the CSV file must have."""
    return [
        "participant",
        *(f"s{number}_{method}" for number in range(1, len(STATEMENTS) + 1) for method in METHODS),
        "helped",
    ]


def read(path: Path) -> Questionnaire:
    """Reads the answers; comma or semicolon between the columns, as spreadsheets write them.

    Raises:
        CodedError: "bad_questionnaire" naming the column, or the line.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise CodedError("bad_questionnaire", f"cannot read {path}: {error}") from None
    separator = ";" if lines and lines[0].count(";") > lines[0].count(",") else ","
    reader = csv.DictReader(lines, delimiter=separator, restval="")
    missing = [column for column in columns() if column not in (reader.fieldnames or ())]
    if missing:
        raise CodedError(
            "bad_questionnaire", f"{path}: the column {missing[0]} is missing; expected are {', '.join(columns())}"
        )
    rows, seen = [], set()
    for line, row in enumerate(reader, 2):
        cells = {key: (value or "").strip() for key, value in row.items() if isinstance(key, str)}
        if not any(cells.values()):
            continue
        where = f"{path}, line {line}"
        if not cells["participant"] or cells["participant"] in seen:
            raise CodedError(
                "bad_questionnaire",
                f"{where}: participant: expected a name that no other line has, got '{cells['participant']}'",
            )
        seen.add(cells["participant"])
        rows.append({column: _answer(cells[column], f"{where}: {column}") for column in columns()[1:-1]})
        rows[-1].update({column: _answer(cells.get(column, ""), f"{where}: {column}", (1, 7)) for column in ueq_columns()})
        rows[-1]["helped"] = _flag(cells["helped"], f"{where}: helped")
    if not rows:
        raise CodedError("bad_questionnaire", f"{path}: nobody has answered yet")
    answers = []
    for number, (statement, scale) in enumerate(STATEMENTS, 1):
        pairs = np.array([[row[f"s{number}_{method}"] for method in METHODS] for row in rows])
        pairs = pairs[np.isfinite(pairs).all(axis=1)]
        answers.append(Answers(statement, scale, pairs[:, 0], pairs[:, 1]))
    for name, items in UEQ_SCALES:
        pairs = np.array([[np.mean([row[f"u{item}_{method}"] for item in items]) - 4.0 for method in METHODS] for row in rows])
        pairs = pairs[np.isfinite(pairs).all(axis=1)]
        if len(pairs):
            answers.append(Answers(name, "-3 to 3", pairs[:, 0], pairs[:, 1]))
    said = np.array([row["helped"] for row in rows])
    return Questionnaire(tuple(answers), int(np.nansum(said)), int(np.isfinite(said).sum()))


def table(found: Questionnaire) -> List[Dict[str, Any]]:
    """The paper's table: one row per statement; a number is nan where too few answered."""
    rows = []
    for number, answers in enumerate(found.answers, 1):
        result = answers.comparison
        rows.append(
            {
                "statement": number,
                "text": answers.statement,
                "scale": answers.scale,
                "n": result.n,
                **{
                    f"{name}_{method}": _moment(values, name)
                    for method, values in zip(METHODS, (answers.first, answers.second))
                    for name in ("mean", "sd", "median")
                },
                # the paper's Z is that of the smaller rank sum; the sign of the correlation says who is ahead
                "z": result.test.z,
                "p": result.test.p,
                "p_exact": result.test.p_exact,
                "r": result.r,
                "rank_biserial": result.rank_biserial,
                "shift": result.shift.estimate,
                "shift_low": result.shift.low,
                "shift_high": result.shift.high,
            }
        )
    return rows


def lines(found: Questionnaire) -> List[str]:
    """The results as the paper words them."""
    text = []
    for row in table(found):
        text.append(
            f"Statement {row['statement']}: Z = {row['z']:.3f}, p {_equals(row['p_exact'])} (exact), "
            f"asymptotic p {_equals(row['p'])}, r = {row['r']:.2f}; "
            + ", ".join(
                f"{method}: M = {row[f'mean_{method}']:.2f}, SD = {row[f'sd_{method}']:.2f}" for method in METHODS
            )
            + f" (n = {row['n']})"
        )
    text.append(f"{QUESTION} yes: {found.helped} of {found.asked}")
    return text


def write(path: Path, rows: Sequence[Dict[str, Any]]) -> None:
    """Writes the table as CSV; an unknown number is an empty cell."""
    with open(str(path), "w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(
            {key: "" if isinstance(value, float) and math.isnan(value) else value for key, value in row.items()}
            for row in rows
        )


def _moment(values: np.ndarray, name: str) -> float:
    if len(values) == 0 or (name == "sd" and len(values) < 2):
        return math.nan
    return float({"mean": np.mean, "median": np.median, "sd": lambda v: np.std(v, ddof=1)}[name](values))


def _answer(text: str, where: str, scale: Tuple[int, int] = SCALE) -> float:
    if text == "":
        return math.nan
    if not text.isdigit() or not scale[0] <= int(text) <= scale[1]:
        raise CodedError("bad_questionnaire", f"{where}: expected a whole number from {scale[0]} to {scale[1]}, got '{text}'")
    return float(text)


def _flag(text: str, where: str) -> float:
    if text == "":
        return math.nan
    if text.lower() not in _YES + _NO:
        raise CodedError("bad_questionnaire", f"{where}: expected yes or no, got '{text}'")
    return float(text.lower() in _YES)


def _equals(p: float) -> str:
    text = statistics.format_p(p)
    return text if text.startswith("<") or text == "–" else f"= {text}"
