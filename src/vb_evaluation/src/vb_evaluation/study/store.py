"""A study's folder: rows that survive an interruption, and the study they belong to."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any, Dict, Iterable, Mapping, Sequence, Tuple

from vb_core.errors import CodedError
from vb_core.files import append_line, write_atomically
from vb_evaluation.report.data import META, RUNS, read_meta


class RowFile:
    """A CSV file to which whole rows are added; one that was cut off is forgotten.

    Args:
        key: the columns that together name a row.

    Attributes:
        rows: by name, as in the file.

    Raises:
        CodedError: "other_columns" if the file has others.
    """

    def __init__(self, path: Path, columns: Sequence[str], key: Sequence[str]) -> None:
        self.path, self.columns, self.key = path, list(columns), tuple(key)
        whole = path.read_bytes().rpartition(b"\n")[0].decode("utf-8") if path.exists() else ""
        reader = csv.DictReader(io.StringIO(whole))
        if reader.fieldnames not in (None, self.columns):
            raise CodedError(
                "other_columns", f"{path} was written with other columns: move it away, or start again with FRESH=1"
            )
        self.rows: Dict[Tuple[str, ...], Mapping[str, Any]] = {self.name_of(row): row for row in reader}
        self.write()

    def name_of(self, row: Mapping[str, Any]) -> Tuple[str, ...]:
        """Returns the name of a row."""
        return tuple(str(row[column]) for column in self.key)

    def append(self, row: Mapping[str, Any]) -> None:
        """Adds a row for good."""
        append_line(self.path, self._lines([row]))
        self.rows[self.name_of(row)] = row

    def write(self, names: Iterable[Tuple[str, ...]] = ()) -> None:
        """Writes the rows in the order of these names, so that the file does not depend on who finished first; others come last."""
        self.rows = {name: self.rows[name] for name in dict.fromkeys([*names, *self.rows]) if name in self.rows}
        write_atomically(
            self.path,
            (self._lines([dict(zip(self.columns, self.columns)), *self.rows.values()]) + "\n").encode("utf-8"),
        )

    def _lines(self, rows: Iterable[Mapping[str, Any]]) -> str:
        stream = io.StringIO()
        csv.DictWriter(stream, self.columns, restval="", extrasaction="ignore", lineterminator="\n").writerows(rows)
        return stream.getvalue()[:-1]


def open_folder(folder: Path, configuration: str, fresh: bool, facts: Mapping[str, Any]) -> None:
    """Makes sure that a folder's contents belong to a configuration, and records which.

    Args:
        configuration: the study's hash.
        fresh: deletes what belongs to another one; else that is an error.
        facts: for study.json.

    Raises:
        CodedError: "other_study".
    """
    if fresh:
        for path in [*folder.glob("*.csv"), *folder.glob("maps/*.*"), *folder.glob(META)]:
            path.unlink()
    found = read_meta(folder / META).get("configuration", "unknown")
    if found != configuration and ((folder / META).exists() or (folder / RUNS).exists()):
        raise CodedError(
            "other_study",
            f"{folder} holds runs of another configuration or program ({found}, this is {configuration}): "
            "they cannot be mixed. FRESH=1 throws them away; OUT=folder puts the new ones elsewhere",
        )
    document = {**facts, "configuration": configuration}
    write_atomically(folder / META, (json.dumps(document, indent=2, sort_keys=True, default=str) + "\n").encode())
