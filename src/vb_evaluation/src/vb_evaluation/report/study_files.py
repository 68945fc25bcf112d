"""Reads the files in a study's folder as pandas tables. Only runs.csv must be there. Nothing here knows a simulator.

A table's index is the line number in its file. Measures are numbers, nan where unknown; everything else is text.
"""

from __future__ import annotations

import io
import json
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any, Dict, Iterable, Iterator, List, Mapping, Optional, Sequence, Tuple

import numpy as np
import pandas

from vb_core.errors import CodedError
from vb_evaluation.metrics import ERRORS
from vb_evaluation.report import paper_results
from vb_evaluation.statistics import paired_differences

RUNS, WORLDS = "runs.csv", "worlds.csv"
DRAWS, META, WARNINGS = "draws.csv", "study.json", "warnings.csv"
QUESTIONNAIRE_FILES = ("questionnaire.csv", "demographics.csv")  # filled in by people
STATES = ("guide", "border", "seed")
TIMES = tuple(f"time_{state}_s" for state in STATES) + ("time_total_s",)
KEY = ("participant", "scenario", "method", "seed")
# the paper's measures come first and in this order: other programs read them
REQUIRED = (*KEY, "completed", *TIMES, "jaccard")
ACCURACY = ("jaccard", *ERRORS)
MEASURES = ("completed", *TIMES, *ACCURACY)
# by file, the columns that identify a row besides KEY
CONDITIONS: Dict[str, Tuple[str, ...]] = {RUNS: (), WORLDS: ("draw",)}
BASELINE = "robot_only"
_EXTRA_MEASURES = ("jaccard_enclosed", "too_bright", "helped", "problems", "seed_is_right", "pointed_right")
_FLAGS = {
    **dict.fromkeys(("yes", "y", "1", "true", "ja"), True),
    **dict.fromkeys(("no", "n", "0", "false", "nein"), False),
}


@dataclass(frozen=True)
class StudyResults:
    """A study's folder, read and checked.

    Attributes:
        runs: runs.csv, one row per run.
        worlds: worlds.csv, empty if there is none.
        meta: study.json, empty if there is none.
    """

    folder: Path
    runs: pandas.DataFrame
    worlds: pandas.DataFrame
    meta: Mapping[str, Any] = field(default_factory=dict)

    @property
    def has_people(self) -> bool:
        """Whether people took part."""
        return bool(self.meta.get("people", False))

    def scenario_title(self, key: str) -> str:
        """Returns a scenario's name for people, as study.json or else the paper has it."""
        return str((self.meta.get("scenarios") or {}).get(key) or paper_results.scenario_title(key))

    def titles(self, scenario: str, method: str) -> Dict[str, Any]:
        """Makes a row with the cells that name a scenario and a method for people."""
        return {"Scenario": self.scenario_title(scenario), "Method": paper_results.method_title(method)}

    @property
    def scenarios(self) -> List[str]:
        """The scenarios in runs.csv: the paper's in its order, then the others as in study.json."""
        # each participant has another order, so the rows' order means nothing
        order = list(dict.fromkeys([*paper_results.PAPER, *(self.meta.get("scenarios") or {}), *self.runs.scenario]))
        return sorted(self.runs.scenario.unique(), key=order.index)

    @property
    def methods(self) -> List[str]:
        """The methods in runs.csv. The baseline comes last."""
        return sorted(self.runs.method.unique(), key=lambda name: (name == BASELINE, name != "nrs", name))

    @property
    def comparison(self) -> Tuple[str, str]:
        """The (method, baseline) to compare; the same one twice if there is no other."""
        return self.methods[0], self.methods[-1]

    def by_method(self, **where: object) -> Iterator[Tuple[str, str, pandas.DataFrame]]:
        """Yields each scenario, method, and the runs with them. `where` leaves only those with these values."""
        for scenario, method in product(self.scenarios, self.methods):
            yield scenario, method, select(self.runs, scenario=scenario, method=method, **where)

    def differences(self, runs: pandas.DataFrame, column: str) -> Dict[str, np.ndarray]:
        """Returns a column's paired differences (N,), method minus baseline, in each scenario."""
        samples = {key: pairs(select(runs, scenario=key), column, self.comparison) for key in self.scenarios}
        return {key: paired_differences(*pair) for key, pair in samples.items()}

    @property
    def missing(self) -> List[str]:
        """The runs that a participant lacks and others have, in words."""
        present = set(zip(self.runs.participant, self.runs.scenario, self.runs.method))
        return [
            ", ".join((person, *self.titles(scenario, method).values()))
            for person, scenario, method in product(self.runs.participant.unique(), self.scenarios, self.methods)
            if (person, scenario, method) not in present
        ]


def select(table: pandas.DataFrame, **where: object) -> pandas.DataFrame:
    """Returns the rows whose columns have these values."""
    for column, value in where.items():
        table = table[table[column] == value]
    return table


def pairs(table: pandas.DataFrame, column: str, methods: Tuple[str, str]) -> Tuple[np.ndarray, np.ndarray]:
    """Returns two (N,) samples of a column, one for each method, paired by participant: means over each one's rows.

    Only completed runs have an accuracy.
    """
    rows = table[table[column].notna()]
    if column in ACCURACY:
        rows = select(rows, completed=1)
    means = rows.pivot_table(index="participant", columns="method", values=column, aggfunc="mean")
    people = rows.participant.unique()
    paired = means.reindex(index=people, columns=list(methods)).dropna()
    first, second = paired.to_numpy(float).T
    return first, second


def read_study(folder: Path) -> StudyResults:
    """Reads a study. Runs that were not done in the planned condition are left out and counted.

    Raises:
        CodedError: "bad_study" naming the file, and the line or column.
    """
    folder = Path(folder)
    if not (folder / RUNS).is_file():
        raise CodedError("bad_study", f"{folder / RUNS} is missing: run 'make study' first, or name the study's folder")
    runs = read_table(folder / RUNS)
    worlds = read_table(folder / WORLDS) if (folder / WORLDS).is_file() else pandas.DataFrame()
    is_deviating = runs.get("as_planned", pandas.Series("", runs.index)) == "0"
    if is_deviating.all():
        raise CodedError("bad_study", f"{folder / RUNS} has no rows: no run has ended yet")
    meta = {**read_meta(folder / META), "deviating": is_deviating.sum()}
    return StudyResults(folder, runs[~is_deviating], worlds, meta)


def read_sheet(path: Path, required: Iterable[str], code: str = "bad_study") -> pandas.DataFrame:
    """Reads a CSV file with a header as text, with commas or semicolons, as spreadsheets write it. Skips empty rows.

    Raises:
        CodedError: `code` if it cannot be read or a column is missing.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
        head = text.split("\n", 1)[0]
        separator = ";" if head.count(";") > head.count(",") else ","
        options = {"dtype": str, "keep_default_na": False, "skip_blank_lines": False, "index_col": False}
        sheet = pandas.read_csv(io.StringIO(text), sep=separator, **options)
    except (OSError, ValueError) as error:
        raise CodedError(code, f"cannot read {path}: {error}") from None
    missing = [column for column in required if column not in sheet]
    if missing:
        raise CodedError(code, f"{path}: the column {missing[0]} is missing; there are {', '.join(sheet.columns)}")
    sheet = sheet.fillna("").apply(lambda column: column.str.strip())
    sheet.index += 2
    return sheet[(sheet != "").any(axis=1)]


def read_table(path: Path) -> pandas.DataFrame:
    """Reads runs.csv or worlds.csv. Measures that it lacks are unknown.

    Raises:
        CodedError: "bad_study" if a column is missing or a measure is neither a number nor empty.
    """
    conditions = CONDITIONS[path.name]
    table = read_sheet(path, (*REQUIRED, *conditions))
    for column in (*MEASURES, *_EXTRA_MEASURES, *conditions):
        text = table.get(column, pandas.Series("", table.index))
        digits = text.str.lower().replace({"true": "1", "false": "0"})
        numbers = pandas.to_numeric(digits, errors="coerce").astype(float)
        is_wrong = ~np.isfinite(numbers) & ((text != "") | (column in conditions)) & (column not in _EXTRA_MEASURES)
        refuse_cells(text, is_wrong, path, "a number", "bad_study")
        table[column] = numbers
    table["completed"] = table.completed.where(table.completed.isna() | (table.completed == 0), 1.0)
    return table


def refuse_cells(cells: pandas.Series, is_wrong: pandas.Series, path: Path, expected: str, code: str) -> None:
    """Raises a CodedError that names the first wrong cell of a sheet's column, if there is one."""
    if is_wrong.any():
        line = is_wrong.idxmax()
        raise CodedError(code, f"{path}, line {line}: {cells.name}: expected {expected}, got {cells[line]!r}")


def yes_or_no(text: str, place: str, code: str) -> Optional[bool]:
    """Parses a person's yes or no. Returns None if the cell is empty."""
    if text and text.lower() not in _FLAGS:
        raise CodedError(code, f"{place}: expected yes or no or nothing, got '{text}'")
    return _FLAGS.get(text.lower())


def write_table(path: Path, columns: Sequence[str], rows: Sequence[Mapping[str, Any]], mode: str = "w") -> None:
    """Writes a CSV file with a header; inverse of `read_sheet`. `mode` is that of `open`: "x" overwrites nothing."""
    table = pandas.DataFrame(list(rows), columns=list(columns), dtype=object)
    table.to_csv(path, index=False, lineterminator="\n", mode=mode)


def read_meta(path: Path) -> Dict[str, Any]:
    """Reads study.json, or returns an empty dictionary if there is none."""
    if not path.is_file():
        return {}
    try:
        meta = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise CodedError("bad_study", f"cannot read {path}: {error}") from None
    if not isinstance(meta, dict):
        raise CodedError("bad_study", f"{path}: expected keys and values")
    return meta
