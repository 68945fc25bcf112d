"""A study's folder: rows that survive an interruption, and the study they belong to."""
from __future__ import annotations

import csv
import io
import json
import os
from pathlib import Path
from typing import Any, Dict, List, Mapping, Sequence, Tuple

from vb_core.errors import CodedError
from vb_core.files import write_atomically

META = "study.json"


class RowFile:
    """A CSV file to which whole rows are added.

    A row is written in one piece and reaches the disk before the next run begins; a row that was cut off by a
    power failure is dropped.

    Args:
        key: the columns that together name a row.

    Raises:
        CodedError: "other_columns" if the file has others.
    """

    def __init__(self, path: Path, columns: Sequence[str], key: Sequence[str]) -> None:
        self.path = path
        self.columns = tuple(columns)
        self.key = tuple(key)
        self.rows: List[Dict[str, str]] = []
        if path.exists():
            self._recover()
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, self._lines([dict(zip(self.columns, self.columns))]))

    def _recover(self) -> None:
        content = self.path.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        if len(whole) < len(content):
            write_atomically(self.path, whole)
        reader = csv.DictReader(io.StringIO(whole.decode("utf-8")))
        if tuple(reader.fieldnames or ()) != self.columns:
            raise CodedError(
                "other_columns", f"{self.path} was written with other columns: move it away, or start again with FRESH=1"
            )
        self.rows = [dict(row) for row in reader]

    def name_of(self, row: Mapping[str, Any]) -> Tuple[str, ...]:
        """The name of a row."""
        return tuple(str(row[column]) for column in self.key)

    @property
    def done(self) -> List[Tuple[str, ...]]:
        """The names of all rows."""
        return [self.name_of(row) for row in self.rows]

    def append(self, row: Mapping[str, Any]) -> None:
        """Adds a row for good."""
        text = {column: str(row.get(column, "")) for column in self.columns}
        descriptor = os.open(str(self.path), os.O_WRONLY | os.O_APPEND)
        try:
            os.write(descriptor, self._lines([text]))
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
        self.rows.append(text)

    def sort(self, order: Mapping[Tuple[str, ...], int]) -> None:
        """Puts the rows in an order, by name, so that the file does not depend on who finished first."""
        self.rows.sort(key=lambda row: order.get(self.name_of(row), len(order)))
        write_atomically(self.path, self._lines([dict(zip(self.columns, self.columns)), *self.rows]))

    def _lines(self, rows: Sequence[Mapping[str, str]]) -> bytes:
        stream = io.StringIO()
        csv.DictWriter(stream, self.columns, lineterminator="\n").writerows(rows)
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
    found = read_meta(folder)
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


def read_meta(folder: Path) -> Dict[str, Any]:
    """study.json; empty if there is none."""
    try:
        found = json.loads((folder / META).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise CodedError("bad_study", f"cannot read {folder / META}: {error}: start again with FRESH=1") from None
    return found if isinstance(found, dict) else {}
