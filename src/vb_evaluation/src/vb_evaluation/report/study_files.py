"""Reads the files in a study's folder as pandas tables. Only runs.csv must be there. Nothing here knows a simulator.

A table's index is the line number in its file. Measures are numbers, nan where unknown; everything else is text.
"""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, Iterable, Mapping, Sequence, Tuple

import numpy as np
import pandas

from vb_core.errors import CodedError
from vb_evaluation.metrics import ERRORS
from vb_evaluation.report.paper_results import METHOD_TITLES, METHODS, SCENARIO_TITLES
from vb_evaluation.statistics import paired_differences

RUNS, WORLDS = "runs.csv", "worlds.csv"
DRAWS, META = "draws.csv", "study.json"
QUESTIONNAIRE_FILES = ("questionnaire.csv", "demographics.csv")  # filled in by people
STATES = ("guide", "border", "seed")
TIMES = tuple(f"time_{state}_s" for state in STATES) + ("time_total_s",)
KEY = ("participant", "scenario", "method", "seed")
# the paper's measures come first and in this order: other programs read them
REQUIRED = (*KEY, "completed", *TIMES, "jaccard")
ACCURACY = ("jaccard", *ERRORS)
MEASURES = ("completed", *TIMES, *ACCURACY)
_EXTRA_MEASURES = ("draw", "jaccard_enclosed", "too_bright", "helped", "problems", "seed_is_right", "pointed_right")
_FLAGS = {
    **dict.fromkeys(("yes", "y", "1", "true", "ja"), True),
    **dict.fromkeys(("no", "n", "0", "false", "nein"), False),
}


@dataclass(frozen=True)
class StudyResults:
    """A study's folder, read and checked.

    Attributes:
        runs: runs.csv, one row per run, without those that were not done in the planned condition.
        deviating: the number of those.
        worlds, draws: worlds.csv and draws.csv, empty if there are none.
        meta: study.json, empty if there is none.
    """

    folder: Path
    runs: pandas.DataFrame
    deviating: int
    worlds: pandas.DataFrame
    draws: pandas.DataFrame
    meta: Mapping[str, Any]

    @property
    def has_people(self) -> bool:
        """Whether people took part."""
        return bool(self.meta.get("people", False))

    @property
    def scenarios(self) -> Dict[str, str]:
        """The scenarios' names for people by key: the paper's in its order, then the others as in study.json."""
        titles = {**SCENARIO_TITLES, **(self.meta.get("scenarios") or {})}
        present = self.runs.scenario.unique()
        # each participant has another order, so the rows' order means nothing
        return {key: titles.get(key) or _title(key) for key in dict.fromkeys([*titles, *present]) if key in present}

    @property
    def methods(self) -> Dict[str, str]:
        """The methods' names for people by key. The baseline comes last."""
        method, baseline = METHODS
        keys = sorted(self.runs.method.unique(), key=lambda key: (key == baseline, key != method, key))
        return {key: METHOD_TITLES.get(key) or _title(key) for key in keys}

    @property
    def comparison(self) -> Tuple[str, str]:
        """The (method, baseline) to compare; the same one twice if there is no other."""
        keys = list(self.methods)
        return keys[0], keys[-1]

    def pairs(self, column: str, scenario: str) -> Tuple[np.ndarray, np.ndarray]:
        """Returns a column's two samples (N,) in a scenario, of the methods to compare, paired by participant.

        They are means over a participant's rows with a method. Only completed runs have an accuracy.
        """
        rows = select(self.runs, scenario=scenario)
        if column in ACCURACY:
            rows = select(rows, completed=1)
        known = rows[rows[column].notna()]
        means = known.pivot_table(index="participant", columns="method", values=column, aggfunc="mean")
        paired = means.reindex(index=known.participant.unique(), columns=list(self.comparison)).dropna()
        first, second = paired.to_numpy(float).T
        return first, second

    def differences(self, column: str, scenario: str) -> np.ndarray:
        """Returns a column's paired differences (N,), method minus baseline, in a scenario."""
        return paired_differences(*self.pairs(column, scenario))


def _title(key: str) -> str:
    return key.replace("_", " ").capitalize()


def select(table: pandas.DataFrame, **where: object) -> pandas.DataFrame:
    """Returns the rows whose columns have these values."""
    for column, value in where.items():
        table = table[table[column] == value]
    return table


def read_study(folder: Path) -> StudyResults:
    """Reads a study. Runs that were not done in the planned condition are left out and counted.

    Raises:
        CodedError: "bad_study" naming the file, and the line or column.
    """
    runs = read_table(folder / RUNS)
    worlds = read_table(folder / WORLDS) if (folder / WORLDS).is_file() else pandas.DataFrame()
    draws = read_sheet(folder / DRAWS, ("draw",)) if (folder / DRAWS).is_file() else pandas.DataFrame()
    is_deviating = runs.get("as_planned", pandas.Series("", runs.index)) == "0"
    if is_deviating.all():
        raise CodedError("bad_study", f"{folder / RUNS} has no rows: no run has ended yet")
    return StudyResults(folder, runs[~is_deviating], is_deviating.sum(), worlds, draws, read_meta(folder / META))


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
    table = read_sheet(path, REQUIRED)
    refuse_cells(table.completed, ~table.completed.isin(["", "0", "1", "0.0", "1.0"]), path, "0 or 1", "bad_study")
    for column in (*MEASURES, *_EXTRA_MEASURES):
        text = table.get(column, pandas.Series("", table.index))
        numbers = pandas.to_numeric(text, errors="coerce").astype(float)
        refuse_cells(text, ~np.isfinite(numbers) & (text != ""), path, "a number", "bad_study")
        table[column] = numbers
    return table


def refuse_cells(cells: pandas.Series, is_wrong: pandas.Series, path: Path, expected: str, code: str) -> None:
    """Raises a CodedError that names the first wrong cell of a sheet's column, if there is one."""
    if is_wrong.any():
        line = is_wrong.idxmax()
        raise CodedError(code, f"{path}, line {line}: {cells.name}: expected {expected}, got {cells[line]!r}")


def read_flags(cells: pandas.Series, path: Path, code: str) -> pandas.Series:
    """Reads a sheet's column in which people wrote yes or no. Returns True, False, or None where a cell is empty."""
    words = cells.str.lower()
    refuse_cells(cells, ~words.isin(["", *_FLAGS]), path, "yes or no or nothing", code)
    return words.map(_FLAGS.get).astype(object)


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
