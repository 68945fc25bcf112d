"""Writes tables of results as CSV files, with the revision that made them."""

from __future__ import annotations

import csv
from datetime import date
from pathlib import Path
from typing import Any, Dict, List, Sequence

from vb_evaluation.provenance import repository_top, revision

RESULTS = repository_top() / "docs" / "results"


def write_table(name: str, command: str, made_by: str, rows: List[Dict[str, Any]]) -> Path:
    """Writes docs/results/NAME.csv with the command, the date and the revision; the first row names the columns."""
    path = RESULTS / f"{name}.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(str(path), "w", newline="") as stream:
        stream.write(f"# python3 bench/{command}; {date.today()}, revision {made_by}\n")
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return path


def append_rows(path: Path, rows: Sequence[Dict[str, Any]]) -> None:
    """Adds rows to a table of results, each with the revision that it was measured at."""
    made_by = revision()
    new = not path.exists()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [*rows[0], "revision"])
        if new:
            writer.writeheader()
        writer.writerows({**row, "revision": made_by} for row in rows)
