"""Tables of results as CSV files, with the command, the date and the revision that made them."""
from __future__ import annotations

import csv
import subprocess
from datetime import date
from pathlib import Path
from typing import Any, Dict, List

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "results"


def revision() -> str:
    """The present commit; "" outside of a repository."""
    command = ["git", "-C", str(FOLDER.parent), "rev-parse", "--short", "HEAD"]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, universal_newlines=True)
    return done.stdout.strip()


def write_table(name: str, command: str, made_by: str, rows: List[Dict[str, Any]]) -> Path:
    """Writes docs/results/NAME.csv; the first row names the columns."""
    path = FOLDER / f"{name}.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(str(path), "w", newline="") as stream:
        stream.write(f"# python3 bench/{command}; {date.today()}, revision {made_by}\n")
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return path
