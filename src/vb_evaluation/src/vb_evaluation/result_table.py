"""Writes tables of results as CSV files, with the revision that made them."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any, Dict, Sequence

from vb_evaluation.provenance import revision


def append_rows(path: Path, rows: Sequence[Dict[str, Any]]) -> None:
    """Adds rows to a table of results, each with the revision that it was measured at."""
    made_by = revision()
    new = not path.exists()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [*rows[0], "revision"])
        if new:
            writer.writeheader()
        writer.writerows({**row, "revision": made_by} for row in rows)
