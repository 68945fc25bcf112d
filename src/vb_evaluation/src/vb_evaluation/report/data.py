"""Reads what a study has left in its folder. Only runs.csv must be there."""
from __future__ import annotations

import csv
import itertools
import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

from vb_core.errors import CodedError
from vb_evaluation.report import paper

RUNS, CURVES, SENSITIVITY, AGREEMENT, META = "runs.csv", "curves.csv", "sensitivity.csv", "agreement.csv", "study.json"
STATES = ("guide", "border", "seed")
TIMES = tuple(f"time_{state}_s" for state in STATES) + ("time_total_s",)
REQUIRED = ("participant", "scenario", "method", "seed", "completed", *TIMES, "jaccard")
# what says under which conditions a row was made, beside the required columns
CONDITIONS = ("participant", "scenario", "method", "seed", "sweep", "parameter", "factor", "value", "unit", "runner")
BASELINE = "robot_only"

Row = Mapping[str, str]


@dataclass(frozen=True)
class Table:
    """A CSV file as text; numbers are read where they are needed.

    Attributes:
        name: the file's name, as it is named in the report.
        columns: in the file's order.
        rows: one mapping per line.
        lines: the rows' line numbers in the file; the header is line 1.
    """

    name: str
    columns: Tuple[str, ...]
    rows: Tuple[Row, ...]
    lines: Tuple[int, ...]

    def select(self, **where: str) -> "Table":
        """The rows whose columns have these values; "a|b" stands for either."""
        wanted = {column: value.split("|") for column, value in where.items()}
        return self.keep([all(row.get(column, "") in values for column, values in wanted.items()) for row in self.rows])

    def keep(self, flags: Sequence[bool]) -> "Table":
        """The rows whose flag is set."""
        kept = [index for index, flag in enumerate(flags) if flag]
        return Table(self.name, self.columns, tuple(self.rows[i] for i in kept), tuple(self.lines[i] for i in kept))

    def distinct(self, column: str) -> List[str]:
        """The values of a column in the order in which they appear, without empty ones."""
        return [value for value in dict.fromkeys(row.get(column, "") for row in self.rows) if value != ""]


@dataclass(frozen=True)
class Study:
    """A study's folder, read and checked.

    Attributes:
        tables: by file name; runs.csv is always among them.
        meta: study.json, empty if there is none.
        scenarios: those of runs.csv; the paper's in its order, then others in that of study.json.
        methods: those of runs.csv; the baseline comes last.
    """

    folder: Path
    tables: Mapping[str, Table]
    meta: Mapping[str, Any] = field(default_factory=dict)

    @property
    def runs(self) -> Table:
        return self.tables[RUNS]

    def scenario_title(self, key: str) -> str:
        """A scenario's name for people, as study.json or else the paper has it."""
        return str((self.meta.get("scenarios") or {}).get(key) or paper.scenario_title(key))

    def method_title(self, key: str) -> str:
        """A method's name for people."""
        title = str((self.meta.get("methods") or {}).get(key) or paper.method_title(key))
        return title[:1].upper() + title[1:]

    @property
    def scenarios(self) -> List[str]:
        # each participant has another order, so that of the rows means nothing
        known = [*paper.PAPER, *(self.meta.get("scenarios") or {})]
        place = {key: known.index(key) for key in reversed(known)}
        return sorted(self.runs.distinct("scenario"), key=lambda key: place.get(key, len(known)))

    @property
    def methods(self) -> List[str]:
        found = sorted(self.runs.distinct("method"), key=lambda name: (name == BASELINE, name != "nrs", name))
        return found

    @property
    def baseline(self) -> str:
        """What the others are compared with."""
        return self.methods[-1] if self.methods else BASELINE

    @property
    def participants(self) -> List[str]:
        return self.runs.distinct("participant")

    @property
    def missing(self) -> List[Tuple[str, str, str]]:
        """(participant, scenario, method) of which other participants have a run, or this one has others."""
        there = {(row["participant"], row["scenario"], row["method"]) for row in self.runs.rows}
        every = itertools.product(self.participants, self.scenarios, self.methods)
        return [one for one in every if one not in there]

    @property
    def further_measures(self) -> List[str]:
        """Columns of numbers in runs.csv beyond the paper's measures: metrics of the user's own."""
        known = {"order", *REQUIRED, *CONDITIONS}
        return [
            column
            for column in self.runs.columns
            if column not in known
            and self.runs.rows
            and all(_is_number(row[column]) for row in self.runs.rows if row[column] != "")
            and any(row[column] != "" for row in self.runs.rows)
        ]


def read_study(folder: Path) -> Study:
    """Reads a study.

    Raises:
        CodedError: "bad_study" naming the file, and the line or column.
    """
    folder = Path(folder)
    if not (folder / RUNS).is_file():
        raise CodedError("bad_study", f"{folder / RUNS} is missing: run 'make study' first, or name the study's folder")
    tables = {}
    for name, conditions in (
        (RUNS, ()),
        (CURVES, ("sweep", "value")),
        (SENSITIVITY, ("parameter", "factor")),
        (AGREEMENT, ("runner",)),
    ):
        if (folder / name).is_file():
            table = read_table(folder / name, (*REQUIRED, *conditions))
            if table.rows or name == RUNS:
                tables[name] = table
    if not tables[RUNS].rows:
        raise CodedError("bad_study", f"{folder / RUNS} has no rows: no run has ended yet")
    return Study(folder, tables, _read_meta(folder / META))


def read_table(path: Path, required: Sequence[str]) -> Table:
    """Reads a CSV file with a header.

    Raises:
        CodedError: "bad_study" if a column is missing or a measure is neither a number nor empty.
    """
    try:
        with open(str(path), newline="", encoding="utf-8") as stream:
            reader = csv.DictReader(stream, restval="")
            columns = tuple(reader.fieldnames or ())
            rows = [{key: (value or "").strip() for key, value in row.items() if key is not None} for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise CodedError("bad_study", f"cannot read {path}: {error}") from None
    missing = [column for column in required if column not in columns]
    if missing:
        raise CodedError("bad_study", f"{path}: the column {missing[0]} is missing; there are {', '.join(columns)}")
    for line, row in enumerate(rows, 2):
        for column in ("completed", *TIMES, "jaccard"):
            if column in columns and not _is_number(row[column]) and row[column] != "":
                raise CodedError("bad_study", f"{path}, line {line}: {column}: expected a number, got {row[column]!r}")
        for column in ("value",) if "sweep" in columns else ("factor",) if "factor" in columns else ():
            if not _is_number(row[column]):
                raise CodedError("bad_study", f"{path}, line {line}: {column}: expected a number, got {row[column]!r}")
        if row.get("completed"):
            # one spelling of yes and no, so that they can be selected
            row["completed"] = str(int(number(row, "completed") != 0.0))
    return Table(path.name, columns, tuple(rows), tuple(range(2, len(rows) + 2)))


def write_table(path: Path, columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> None:
    """Writes a CSV file with a header; inverse of `read_table`."""
    with open(str(path), "w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, columns, lineterminator="\n", extrasaction="ignore", restval="")
        writer.writeheader()
        writer.writerows(rows)


def number(row: Row, column: str) -> float:
    """A row's number; nan where it is empty. True and False count as 1 and 0."""
    text = row.get(column, "")
    if text.lower() in ("true", "false"):
        return float(text.lower() == "true")
    return float(text) if text != "" else math.nan


def _is_number(text: Optional[str]) -> bool:
    if (text or "").lower() in ("true", "false"):
        return True
    try:
        return math.isfinite(float(text or ""))
    except ValueError:
        return False


def _read_meta(path: Path) -> Dict[str, Any]:
    if not path.is_file():
        return {}
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise CodedError("bad_study", f"cannot read {path}: {error}") from None
    if not isinstance(found, dict):
        raise CodedError("bad_study", f"{path}: expected keys and values")
    return found
