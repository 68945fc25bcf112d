"""Shared code of all benches: arguments, rows of results with their revision, and an older version to compare with.

A bench prints each row as soon as it has it, and appends it to --csv FILE with the revision that made it. --other takes a
revision, or the folder `src` of another checkout; both versions then process the same input in turns, in one process:
other load on the computer affects both alike, so that the ratio of their times is meaningful.
"""

from __future__ import annotations

import argparse
import importlib
import subprocess
import sys
import tempfile
import time
from functools import lru_cache
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Sequence

import numpy as np
import pandas

from vb_evaluation.provenance import revision
from vb_evaluation.statistics import proportion

TOP = Path(__file__).resolve().parents[1]
HALVES = ("development", "judging")  # of recordings: those looked at while a program is changed, and the others


def arguments(doc: Optional[str], seed: Optional[int] = None, other: bool = False) -> argparse.ArgumentParser:
    """Makes a bench's parser, with its docstring as help, always --csv, and --seed and --other where they apply."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--csv", type=Path, metavar="FILE", help="append the rows to a table")
    if seed is not None:
        parser.add_argument("--seed", type=int, default=seed, help="default: %(default)s")
    if other:
        parser.add_argument("--other", type=source_of, metavar="REVISION|SRC", help="also an older version")
    return parser


def versions(given: argparse.Namespace) -> Dict[str, Optional[Path]]:
    """Returns the `src` folders of the versions to compare: None for this one, and the other one's if there is one."""
    return {"this": None, **({"other": given.other} if given.other else {})}


class Table:
    """Rows of results: printed as they come, and appended, with seed and revision, to a CSV file if one is given."""

    def __init__(self, path: Optional[Path] = None, seed: Optional[int] = None) -> None:
        self._path, self._source = path, {"revision": revision()} if path is not None else {}
        if seed is not None:
            self._source["seed"] = str(seed)
        self.rows: List[Dict[str, Any]] = []

    def add(self, **row: Any) -> None:
        """Adds a row; floats are rounded to four digits, lists (positions to look at) stay out of the file."""
        row = {key: float(f"{value:.4g}") if isinstance(value, float) else value for key, value in row.items()}
        self.rows.append(row)
        words = (f"{key} {value}" if isinstance(value, (int, float)) else str(value) for key, value in row.items())
        print("  ".join(words), flush=True)
        if self._path is not None:
            new = {key: value for key, value in row.items() if not isinstance(value, list)}
            kept = [pandas.read_csv(self._path, dtype=str, keep_default_na=False)] if self._path.exists() else []
            table = pandas.concat([*kept, pandas.DataFrame([{**new, **self._source}], dtype=str)])
            self._path.parent.mkdir(parents=True, exist_ok=True)
            table.fillna("").to_csv(self._path, index=False)


def share(hits: int, n: int) -> str:
    """Writes a share with Wilson's 95 % interval, in percent."""
    if not n:
        return "-"
    found = proportion(hits, n).scaled(100.0)
    return f"{hits} of {n}: {found.estimate:.1f} % ({found.low:.1f} to {found.high:.1f})"


# ------------------------------------------------------------------ another version
def source_of(name: str) -> Path:
    """Returns the `src` folder of another version, given a path or a revision, whose files are unpacked."""
    if Path(name).is_dir():
        return Path(name).resolve()
    folder = Path(tempfile.mkdtemp(prefix="other_version_"))
    archive = subprocess.run(["git", "-C", str(TOP), "archive", name, "src"], stdout=subprocess.PIPE, check=True).stdout
    subprocess.run(["tar", "-x", "-C", str(folder)], input=archive, check=True)
    return folder / "src"


@lru_cache(maxsize=None)
def import_from(source: Optional[Path], *names: str) -> List[Any]:
    """Imports modules of this version (None) or of another one, whose packages then coexist with these."""
    if source is None:
        return [importlib.import_module(name) for name in names]
    packages = {path.parent.name for path in source.glob("*/package.xml")} - {"vb_msgs", "vb_evaluation"}

    def ours() -> List[str]:
        return [name for name in sys.modules if name.split(".")[0] in packages]

    kept, path = {name: sys.modules.pop(name) for name in ours()}, list(sys.path)
    sys.path[:0] = [str(source / package / "src") for package in sorted(packages)]
    try:
        return [importlib.import_module(name) for name in names]
    finally:
        sys.path[:] = path
        for name in ours():
            del sys.modules[name]
        sys.modules.update(kept)


def in_turns(actions: Dict[str, Callable[[], Any]], rounds: int) -> Dict[str, float]:
    """Times actions in turns; returns medians [ms] of thread time, and the ratio of the first action to each other one.

    The first round is left out: it includes one-time work.
    """
    times: Dict[str, List[float]] = {name: [] for name in actions}
    for number in range(rounds + 1):
        for name in list(actions) if number % 2 else list(actions)[::-1]:
            began = time.thread_time()
            actions[name]()
            times[name].append(1e3 * (time.thread_time() - began))
    table, first = pandas.DataFrame(times)[1:], next(iter(actions))
    ratios = table.rdiv(table[first], axis=0).drop(columns=first)
    return {**table.median().add_suffix("_ms"), **ratios.median().add_prefix(f"{first}_over_")}


def quantiles(values: Sequence[float]) -> Dict[str, Any]:
    """Returns how many values [s] there are, their median and 95th percentile [ms]."""
    middle, high = 1e3 * np.quantile(values, (0.5, 0.95)) if len(values) else ("", "")
    return {"n": len(values), "median_ms": middle, "p95_ms": high}
