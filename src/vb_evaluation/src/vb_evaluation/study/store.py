"""A study's folder: rows that survive an interruption, and the study they belong to."""
from __future__ import annotations

import csv
import io
import json
import os
from pathlib import Path
from typing import Any, Dict, Mapping, Sequence, Tuple

from vb_core.errors import CodedError
from vb_core.files import write_atomically
from vb_evaluation.report.data import META, read_meta


class RowFile:
    """A CSV file to which whole rows are added.

    A row is written in one piece and reaches the disk before the next run begins; a row that was cut off by a
    power failure is dropped.

    Args:
        key: the columns that together name a row.

    Attributes:
        rows: by name, as in the file.

    Raises:
        CodedError: "other_columns" if the file has others.
    """

    def __init__(self, path: Path, columns: Sequence[str], key: Sequence[str]) -> None:
        self.path, self.columns, self.key = path, tuple(columns), tuple(key)
        self.rows: Dict[Tuple[str, ...], Mapping[str, str]] = {}
        if not path.exists():
            write_atomically(path, self._lines([]))
        content = path.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        if len(whole) < len(content):
            write_atomically(path, whole)
        reader = csv.DictReader(io.StringIO(whole.decode("utf-8")))
        if tuple(reader.fieldnames or ()) != self.columns:
            raise CodedError(
                "other_columns", f"{path} was written with other columns: move it away, or start again with FRESH=1")
        self.rows.update((self.name_of(row), row) for row in reader)

    def name_of(self, row: Mapping[str, Any]) -> Tuple[str, ...]:
        """The name of a row."""
        return tuple(str(row[column]) for column in self.key)

    def append(self, row: Mapping[str, Any]) -> None:
        """Adds a row for good."""
        text = {column: str(row.get(column, "")) for column in self.columns}
        with open(str(self.path), "ab", buffering=0) as stream:
            stream.write(self._lines([text], False))
            os.fsync(stream.fileno())
        self.rows[self.name_of(text)] = text

    def sort(self, names: Sequence[Tuple[str, ...]]) -> None:
        """Puts rows in the order of their names, so that the file does not depend on who finished first; others come last."""
        self.rows = {name: self.rows[name] for name in dict.fromkeys([*names, *self.rows]) if name in self.rows}
        write_atomically(self.path, self._lines(list(self.rows.values())))

    def _lines(self, rows: Sequence[Mapping[str, str]], header: bool = True) -> bytes:
        stream = io.StringIO()
        writer = csv.DictWriter(stream, self.columns, lineterminator="\n")
        if header:
            writer.writeheader()
        writer.writerows(rows)
        return stream.getvalue().encode("utf-8")


def claim(folder: Path, configuration: str, fresh: bool, facts: Mapping[str, Any]) -> None:
    """Makes sure that a folder's contents belong to a configuration, and records which.

    Args:
        configuration: the study's hash.
        fresh: deletes what belongs to another one; else that is an error.
        facts: for study.json.

    Raises:
        CodedError: "other_study".
    """
    found = read_meta(folder / META)
    if fresh:
        for path in [*folder.glob("*.csv"), *folder.glob("maps/*"), folder / META]:
            if path.is_file():
                path.unlink()
    elif found and found.get("configuration") != configuration:
        raise CodedError(
            "other_study", f"{folder} holds runs of another configuration or program ({found.get('configuration')}, this "
            f"is {configuration}): they cannot be mixed. FRESH=1 throws them away; OUT=folder puts the new ones elsewhere"
        )
    elif not found and (folder / "runs.csv").exists():
        raise CodedError("other_study", f"{folder}/runs.csv comes without {META}, so nobody knows how it was made: "
                         "FRESH=1 throws it away; OUT=folder puts the new runs elsewhere")
    folder.mkdir(parents=True, exist_ok=True)
    document = {**facts, "configuration": configuration}
    write_atomically(folder / META, (json.dumps(document, indent=2, sort_keys=True, default=str) + "\n").encode())
