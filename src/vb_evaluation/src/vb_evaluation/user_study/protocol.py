"""The protocol of a study: who does what in which order, and what the experimenter notes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List, Optional, Sequence

import pandas

from vb_core.errors import CodedError
from vb_evaluation.counterbalancing import order_runs
from vb_evaluation.report.study_files import read_flags, read_sheet, write_table

COLUMNS = ("participant", "order", "method", "scenario", "recording", "completed", "note")


@dataclass(frozen=True)
class Entry:
    """One run of the protocol."""

    participant: str  # a number or a pseudonym
    method: str
    scenario: str
    recording: str  # folder of the recording, as the file has it; no other run has the same
    completed: Optional[bool] = None  # what the experimenter noted; None leaves it to the seed point
    note: str = ""
    order: int = 0  # the run's position among its participant's, from 1; 0 if the file does not say

    def folder(self, protocol: Path) -> Path:
        """Returns the recording's folder, beside the protocol's file; absolute, since nodes have another working folder."""
        return protocol.absolute().parent / Path(self.recording).expanduser()


def plan_runs(participants: int, scenarios: Sequence[str], methods: Sequence[str], seed: int) -> List[Dict[str, str]]:
    """Returns the rows of a protocol to fill in. See `order_runs`."""
    return [
        {
            "participant": f"p{number:02d}",
            "order": str(order),
            "method": method,
            "scenario": scenario,
            "recording": f"p{number:02d}_{order}_{method}_{scenario}",
        }
        for number in range(1, participants + 1)
        for order, (scenario, method) in enumerate(order_runs(number, participants, scenarios, methods, seed), 1)
    ]


def write_protocol(path: Path, rows: Sequence[Dict[str, str]]) -> None:
    """Writes a protocol; inverse of `read_protocol`.

    Raises:
        CodedError: "cannot_write", also if the file exists: notes must not be lost.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_table(path, COLUMNS, rows, mode="x")
    except OSError as error:
        raise CodedError("cannot_write", what=str(path), reason=error.strerror) from None


def read_protocol(path: Path) -> List[Entry]:
    """Reads a protocol. Runs without a recording did not take place.

    Raises:
        CodedError: "bad_protocol" naming the line.
    """
    entries = []
    first_lines: Dict[object, int] = {}
    table = read_sheet(path, ("participant", "method", "scenario", "recording"), "bad_protocol")
    completed = read_flags(table.get("completed", pandas.Series("", table.index)), path, "bad_protocol")
    for line, row in table.to_dict("index").items():
        empty = [column for column in ("participant", "method", "scenario") if not row[column]]
        if empty:
            raise CodedError("bad_protocol", f"{path}, line {line}: {empty[0]} is empty")
        for key in ((row["participant"], row["method"], row["scenario"]), row["recording"] or line):
            if first_lines.setdefault(key, line) != line:
                lines = f"lines {first_lines[key]} and {line}"
                raise CodedError("bad_protocol", f"{path}, {lines}: the same run or recording twice")
        if row["recording"]:
            names = {key: row[key] for key in ("participant", "method", "scenario", "recording")}
            order = int(row["order"]) if row.get("order", "").isdigit() else 0
            entries.append(Entry(**names, completed=completed[line], note=row.get("note", ""), order=order))
    return entries
