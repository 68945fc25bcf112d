"""The protocol of a study: who does what in which order, and what the experimenter notes."""
from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List, Optional, Sequence

from vb_core.errors import CodedError
from vb_evaluation.design import order_of_runs

COLUMNS = ("participant", "order", "method", "scenario", "recording", "completed", "interaction", "note")
_YES, _NO = ("1", "yes", "y", "true", "ja"), ("0", "no", "n", "false", "nein")


@dataclass(frozen=True)
class Entry:
    """One run of the protocol.

    Attributes:
        participant: a number or a pseudonym.
        recording: folder of the recording, as the file has it.
        completed: what the experimenter noted; None leaves it to the seed point.
        order: the run's place among its participant's, from 1; 0 if the file does not say.
        interaction: id of the interaction; "" takes the recording's interactions in their order.
    """

    participant: str
    method: str
    scenario: str
    recording: str
    completed: Optional[bool] = None
    interaction: str = ""
    note: str = ""
    order: int = 0


def plan(participants: int, scenarios: Sequence[str], methods: Sequence[str], seed: int) -> List[Dict[str, str]]:
    """Rows of a protocol to fill in: see `order_of_runs`."""
    return [
        {"participant": f"p{number:02d}", "order": str(order), "method": method, "scenario": scenario,
         "recording": f"p{number:02d}_{order}_{method}_{scenario}"}
        for number in range(1, participants + 1)
        for order, (scenario, method) in enumerate(order_of_runs(number, scenarios, methods, seed), 1)
    ]


def write(path: Path, rows: Sequence[Dict[str, str]]) -> None:
    """Writes a protocol; inverse of `read`.

    Raises:
        CodedError: "cannot_write", also if the file exists: notes must not be lost.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(str(path), "x", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, COLUMNS, restval="", lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    except OSError as error:
        raise CodedError("cannot_write", f"cannot write {path}: {error.strerror}") from None


def read(path: Path) -> List[Entry]:
    """Reads a protocol, comma or semicolon between the columns, as spreadsheets write it.

    Raises:
        CodedError: "bad_protocol" naming the line.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise CodedError("bad_protocol", f"cannot read {path}: {error}") from None
    lines = text.splitlines()
    separator = ";" if lines and lines[0].count(";") > lines[0].count(",") else ","
    reader = csv.DictReader(lines, delimiter=separator, restval="")
    missing = [
        column
        for column in ("participant", "method", "scenario", "recording")
        if column not in (reader.fieldnames or ())
    ]
    if missing:
        raise CodedError("bad_protocol", f"{path}: the column {missing[0]} is missing")
    entries, seen = [], {}
    for line, row in enumerate(reader, 2):
        cells = {key: (value or "").strip() for key, value in row.items() if isinstance(key, str)}
        if not any(cells.values()):
            continue
        empty = [column for column in ("participant", "method", "scenario") if not cells[column]]
        if empty:
            raise CodedError("bad_protocol", f"{path}, line {line}: {empty[0]} is empty")
        key = (cells["participant"], cells["method"], cells["scenario"])
        if key in seen:
            raise CodedError("bad_protocol", f"{path}, lines {seen[key]} and {line}: the same run twice")
        seen[key] = line
        if not cells["recording"]:
            continue  # this run did not take place
        entries.append(
            Entry(
                *key,
                cells["recording"],
                _flag(cells.get("completed", ""), f"{path}, line {line}"),
                cells.get("interaction", ""),
                cells.get("note", ""),
                int(cells["order"]) if cells.get("order", "").isdigit() else 0,
            )
        )
    return entries


def _flag(text: str, where: str) -> Optional[bool]:
    if text == "":
        return None
    if text.lower() in _YES + _NO:
        return text.lower() in _YES
    raise CodedError("bad_protocol", f"{where}: completed: expected yes, no or nothing, got '{text}'")
