"""Tables of results as CSV files, with the command, the date and the revision that made them."""

from __future__ import annotations

import csv
import subprocess
from datetime import date
from pathlib import Path
from typing import Any, Dict, List

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "results"


def revision() -> str:
    """Returns the present commit, with "-dirty" where files differ from it outside of docs; "" outside of a repository.

    A bench that goes on later writes its table into docs meanwhile, and that changes nothing of what it measures.
    """
    git = ["git", "-C", str(FOLDER.parent.parent)]
    done = subprocess.run(
        [*git, "rev-parse", "--short", "HEAD"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        universal_newlines=True,
    )
    differs = (
        subprocess.run([*git, "diff", "--quiet", "HEAD", "--", ".", ":!docs"], stderr=subprocess.DEVNULL).returncode
        == 1
    )
    return done.stdout.strip() + ("-dirty" if differs else "")


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
