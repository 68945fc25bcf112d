"""Shared code of all benches: arguments, result tables with revisions, and comparison with another version.

A bench prints each row at once, and appends it to --csv FILE with its revision. --other takes a revision, or the folder
`src` of another checkout. Both versions then process the same input in turns, in one process, so that other load on the
computer affects both alike and the ratio of their times is meaningful.
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
from typing import Any, Callable, Dict, List, Optional

import pandas

from vb_evaluation.repository_revision import revision
from vb_evaluation.statistics import proportion

TOP = Path(__file__).resolve().parents[1]
HALVES = ("development", "judging")  # of recordings; the second half is kept unseen for the final measurement


def arguments(doc: Optional[str], seed: Optional[int] = None, other: bool = False) -> argparse.ArgumentParser:
    """Returns a bench's argument parser. It has --csv, and --seed and --other if the bench needs them."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--csv", type=Path, metavar="FILE", help="append the rows to a table")
    if seed is not None:
        parser.add_argument("--seed", type=int, default=seed, help="default: %(default)s")
    if other:
        parser.add_argument("--other", type=source_of, metavar="REVISION|SRC", help="also an older version")
    return parser


def versions(options: argparse.Namespace) -> Dict[str, Optional[Path]]:
    """Returns the `src` folders of the versions to compare: None for this version, and the other's if requested."""
    return {"this": None, **({"other": options.other} if options.other else {})}


class ResultTable:
    """Rows of results, which are printed at once, and appended with seed and revision to a CSV file if one is given."""

    def __init__(self, path: Optional[Path] = None, seed: Optional[int] = None) -> None:
        self._path = path
        self._source = {} if path is None else {"revision": revision()}
        if seed is not None:
            self._source["seed"] = str(seed)
        self.rows: List[Dict[str, Any]] = []

    def add(self, **row: Any) -> None:
        """Adds a row. Floats are rounded to four digits; lists, such as positions to inspect, are only printed."""
        for key, value in row.items():
            row[key] = float(f"{value:.4g}") if isinstance(value, float) else value
        self.rows.append(row)
        # only a number needs its column's name beside it
        texts = [f"{key} {value}" if isinstance(value, (int, float)) else str(value) for key, value in row.items()]
        print("  ".join(texts), flush=True)
        if self._path is not None:
            new = {key: value for key, value in row.items() if not isinstance(value, list)}
            tables = [pandas.read_csv(self._path, dtype=str, keep_default_na=False)] if self._path.exists() else []
            table = pandas.concat([*tables, pandas.DataFrame([{**new, **self._source}], dtype=str)])
            self._path.parent.mkdir(parents=True, exist_ok=True)
            table.fillna("").to_csv(self._path, index=False)


def share(hits: int, n: int) -> str:
    """Formats a share with Wilson's 95 % interval, in percent."""
    if not n:
        return "-"
    interval = proportion(hits, n).scaled(100.0)
    return f"{hits} of {n}: {interval.estimate:.1f} % ({interval.low:.1f} to {interval.high:.1f})"


# ------------------------------------------------------------------ another version
def source_of(name: str) -> Path:
    """Returns the `src` folder of another version. `name` is such a folder, or a revision, which is unpacked."""
    if Path(name).is_dir():
        return Path(name).resolve()
    folder = Path(tempfile.mkdtemp(prefix="other_version_"))
    archive = subprocess.run(["git", "-C", str(TOP), "archive", name, "src"], stdout=subprocess.PIPE, check=True).stdout
    subprocess.run(["tar", "-x", "-C", str(folder)], input=archive, check=True)
    return folder / "src"


@lru_cache(maxsize=None)
def import_from(source: Optional[Path], *names: str) -> List[Any]:
    """Imports modules of this version (None) or of another, whose packages then coexist with this version's."""
    if source is None:
        return [importlib.import_module(name) for name in names]
    packages = {package_xml.parent.name for package_xml in source.glob("*/package.xml")} - {"vb_msgs", "vb_evaluation"}

    def ours() -> List[str]:
        return [name for name in sys.modules if name.split(".")[0] in packages]

    saved_modules = {name: sys.modules.pop(name) for name in ours()}
    saved_path = list(sys.path)
    sys.path[:0] = [str(source / package / "src") for package in sorted(packages)]
    try:
        return [importlib.import_module(name) for name in names]
    finally:
        sys.path[:] = saved_path
        for name in ours():
            del sys.modules[name]
        sys.modules.update(saved_modules)


def time_in_turns(actions: Dict[str, Callable[[], Any]], rounds: int) -> Dict[str, float]:
    """Times actions in turns; returns medians [ms] of thread time, and the ratio of the first action to each other.

    The first round is not counted, because it includes one-time work.
    """
    times: Dict[str, List[float]] = {name: [] for name in actions}
    for number in range(rounds + 1):
        order = list(actions) if number % 2 else list(actions)[::-1]
        for name in order:
            start = time.thread_time()
            actions[name]()
            times[name].append(1e3 * (time.thread_time() - start))
    table = pandas.DataFrame(times)[1:]
    first = next(iter(actions))
    ratios = table.rdiv(table[first], axis=0).drop(columns=first)
    return {**table.median().add_suffix("_ms"), **ratios.median().add_prefix(f"{first}_over_")}
