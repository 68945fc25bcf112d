"""Reads the files in a study's folder. Only runs.csv must be there; nothing here knows a simulator."""
from __future__ import annotations

import csv
import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Dict, Iterator, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from vb_core.errors import CodedError
from vb_evaluation.metrics import ERRORS
from vb_evaluation.report import paper

RUNS, CURVES, WORLDS, UNGATED, DRAWS, META = "runs.csv", "curves.csv", "worlds.csv", "ungated.csv", "draws.csv", "study.json"
STATES = ("guide", "border", "seed")
TIMES = tuple(f"time_{state}_s" for state in STATES) + ("time_total_s",)
KEY = ("participant", "scenario", "method", "seed")
# the paper's measures come first and in this order: other programs read them
REQUIRED = (*KEY, "completed", *TIMES, "jaccard")
MEASURES = ("completed", *TIMES, "jaccard", *ERRORS)
BASELINE = "robot_only"
_NUMBERS = {"value", "draw"}
_YES, _NO = ("yes", "y", "1", "true", "ja"), ("no", "n", "0", "false", "nein")

Row = Mapping[str, str]


@dataclass(frozen=True)
class Table:
    """Rows of a CSV file as text; numbers are read where they are needed.

    Attributes:
        lines: the rows' line numbers in the file; the header is line 1.
    """

    name: str
    columns: Tuple[str, ...]
    rows: Tuple[Row, ...]
    lines: Tuple[int, ...]

    def select(self, **where: object) -> "Table":
        """The rows whose columns have these values."""
        wanted = {column: str(value) for column, value in where.items()}
        return self.keep([all(row.get(key, "") == wanted[key] for key in wanted) for row in self.rows])

    def keep(self, flags: Sequence[bool]) -> "Table":
        """The rows whose flag is set."""
        kept = [i for i, flag in enumerate(flags) if flag]
        return Table(self.name, self.columns, tuple(self.rows[i] for i in kept), tuple(self.lines[i] for i in kept))

    def distinct(self, column: str) -> List[str]:
        """The values of a column in the order in which they appear, without empty ones."""
        return [value for value in dict.fromkeys(row.get(column, "") for row in self.rows) if value != ""]

    def numbers(self, column: str) -> np.ndarray:
        """(N,) the known numbers of a column."""
        found = np.array([number(row, column) for row in self.rows], dtype=float)
        return found[np.isfinite(found)]

    def pairs(self, column: str, methods: Tuple[str, str], completed: bool = False) -> Tuple[np.ndarray, np.ndarray]:
        """Two (N,) samples of a column, one for each method, paired by participant.

        Args:
            completed: uses only those who completed both.
        """
        found: Dict[str, Dict[str, float]] = {}
        for row in self.rows:
            value = number(row, column)
            if math.isfinite(value) and (not completed or row.get("completed") == "1"):
                found.setdefault(row["participant"], {})[row["method"]] = value
        both = [values for values in found.values() if set(methods) <= set(values)]
        return tuple(np.array([values[method] for values in both], dtype=float) for method in methods)  # type: ignore


@dataclass(frozen=True)
class Cell:
    """The runs of one scenario with one method; `published` are the paper's figures if it has them."""

    method: str
    title: str
    runs: Table
    published: Optional[paper.Published]


@dataclass(frozen=True)
class Study:
    """A study's folder, read and checked.

    Attributes:
        tables: by file name; runs.csv is always among them.
        meta: study.json, empty if there is none.
    """

    folder: Path
    tables: Mapping[str, Table]
    meta: Mapping[str, Any] = field(default_factory=dict)

    @property
    def runs(self) -> Table:
        return self.tables[RUNS]

    @property
    def people(self) -> bool:
        """Whether people took part."""
        return bool(self.meta.get("people", False))

    def scenario_title(self, key: str) -> str:
        """A scenario's name for people, as study.json or else the paper has it."""
        return str((self.meta.get("scenarios") or {}).get(key) or paper.scenario_title(key))

    @property
    def scenarios(self) -> List[str]:
        """Those of runs.csv; the paper's in its order, then others in that of study.json."""
        # each participant has another order, so that of the rows means nothing
        known = [*paper.PAPER, *(self.meta.get("scenarios") or {})]
        place = {key: known.index(key) for key in reversed(known)}
        return sorted(self.runs.distinct("scenario"), key=lambda key: place.get(key, len(known)))

    @property
    def methods(self) -> List[str]:
        """Those of runs.csv; the baseline comes last."""
        return sorted(self.runs.distinct("method"), key=lambda name: (name == BASELINE, name != "nrs", name))

    @property
    def comparison(self) -> Tuple[str, str]:
        """(method, baseline) that are compared; the same one twice if there is no other."""
        return self.methods[0], self.methods[-1]

    def cells(self, **where: object) -> Iterator[Tuple[str, List[Cell]]]:
        """(scenario's title, its runs by method) of each scenario; only the runs with these values."""
        for scenario in self.scenarios:
            published = paper.PAPER.get(scenario)
            yield self.scenario_title(scenario), [
                Cell(method, paper.method_title(method), self.runs.select(scenario=scenario, method=method, **where),
                     published if published is not None and method in published.jaccard else None) for method in self.methods]

    @property
    def missing(self) -> List[str]:
        """Runs that others have and this participant has not, in words."""
        there = {(row["participant"], row["scenario"], row["method"]) for row in self.runs.rows}
        return [
            f"{person}, {self.scenario_title(scenario)}, {paper.method_title(method)}"
            for person in self.runs.distinct("participant") for scenario in self.scenarios for method in self.methods
            if (person, scenario, method) not in there
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
    for name, conditions in ((RUNS, ()), (CURVES, ("sweep", "value")), (WORLDS, ("draw",)), (UNGATED, ())):
        if (folder / name).is_file():
            table = read_table(folder / name, (*REQUIRED, *conditions))
            if table.rows or name == RUNS:
                tables[name] = table
    planned = [row.get("as_planned", "1") != "0" for row in tables[RUNS].rows]
    deviating = planned.count(False)
    tables[RUNS] = tables[RUNS].keep(planned)
    if not tables[RUNS].rows:
        raise CodedError("bad_study", f"{folder / RUNS} has no rows: no run has ended yet")
    return Study(folder, tables, {**read_meta(folder / META), "deviating": deviating})


def read_sheet(path: Path, required: Sequence[str], code: str = "bad_study") -> Table:
    """Reads a CSV file with a header, comma or semicolon between the columns, as spreadsheets write it; without empty rows.

    Raises:
        CodedError: `code` if it cannot be read or a column is missing.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise CodedError(code, f"cannot read {path}: {error}") from None
    separator = ";" if lines and lines[0].count(";") > lines[0].count(",") else ","
    reader = csv.DictReader(lines, delimiter=separator, restval="")
    columns = tuple(reader.fieldnames or ())
    missing = [column for column in required if column not in columns]
    if missing:
        raise CodedError(code, f"{path}: the column {missing[0]} is missing; there are {', '.join(columns)}")
    rows = [(line, {key: (value or "").strip() for key, value in row.items() if key is not None}) for line, row in enumerate(reader, 2)]
    rows = [(line, row) for line, row in rows if any(row.values())]
    return Table(path.name, columns, tuple(row for _, row in rows), tuple(line for line, _ in rows))


def yes_or_no(text: str, where: str, code: str) -> Optional[bool]:
    """What a person noted; None for nothing."""
    if text.lower() not in ("", *_YES, *_NO):
        raise CodedError(code, f"{where}: expected yes or no or nothing, got '{text}'")
    return text.lower() in _YES if text else None


def read_table(path: Path, required: Sequence[str]) -> Table:
    """Reads a study's CSV file.

    Raises:
        CodedError: "bad_study" if a column is missing or a measure is neither a number nor empty.
    """
    table = read_sheet(path, required)
    for line, row in zip(table.lines, table.rows):
        for column in (*MEASURES, *(_NUMBERS & set(required))):
            text = row.get(column, "")
            if (text != "" or column in _NUMBERS) and column in table.columns and not math.isfinite(_number(text)):
                raise CodedError("bad_study", f"{path}, line {line}: {column}: expected a number, got {text!r}")
        if row.get("completed"):
            # one spelling of yes and no, so that they can be selected
            row["completed"] = str(int(number(row, "completed") != 0.0))  # type: ignore[index]
    return table


def write_table(path: Path, columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> None:
    """Writes a CSV file with a header; inverse of `read_table`."""
    with open(str(path), "w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, columns, lineterminator="\n", extrasaction="ignore", restval="")
        writer.writeheader()
        writer.writerows(rows)


def number(row: Row, column: str) -> float:
    """A row's number; nan where it is empty or none. True and False count as 1 and 0."""
    return _number(row.get(column, ""))


def _number(text: str) -> float:
    if text.lower() in ("true", "false"):
        return float(text.lower() == "true")
    try:
        return float(text)
    except ValueError:
        return math.nan


def read_meta(path: Path) -> Dict[str, Any]:
    """study.json; empty if there is none."""
    if not path.is_file():
        return {}
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise CodedError("bad_study", f"cannot read {path}: {error}") from None
    if not isinstance(found, dict):
        raise CodedError("bad_study", f"{path}: expected keys and values")
    return found
