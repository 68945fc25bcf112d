"""Every number of the report, each with the rows that it is made of.

A number is asked for by file, filter, column and statistic, and computed from nothing else; so what the report
says of its origin cannot differ from its origin. All of them are written to numbers.csv.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Callable, Dict, List, Mapping, Sequence, Tuple

import numpy as np
from markupsafe import Markup

from vb_core.errors import CodedError
from vb_evaluation import statistics
from vb_evaluation.report.data import Study, Table, number

# ------------------------------------------------------------------ how numbers are written
FORMATS: Dict[str, Callable[[float], str]] = {
    "count": lambda value: f"{value:.0f}",
    "seconds": lambda value: f"{value:.1f}",
    "share": lambda value: f"{100 * value:.1f} %",
    "index": lambda value: f"{value:.3f}".replace("0.", ".", 1) if abs(value) < 0.9995 else f"{value:.3f}",
    "factor": lambda value: f"{value:.2f}",
    "z": lambda value: f"{value:.3f}",
    "p": statistics.format_p,
    "plain": lambda value: f"{value:.4g}",
}


# ------------------------------------------------------------------ what can be asked for
def _once(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function with its last results kept: estimate and both limits come from one bootstrap."""
    kept = lru_cache(maxsize=64)(lambda *samples: function(*(np.frombuffer(sample) for sample in samples)))
    return lambda *samples: kept(*(np.ascontiguousarray(sample, dtype=float).tobytes() for sample in samples))


_compare, _median = _once(statistics.compare), _once(statistics.median)
_speedup = _once(lambda first, second: statistics.ratio_of_means(second, first))

ONE: Dict[str, Tuple[str, Callable[[np.ndarray], float]]] = {
    "n": ("number", lambda v: float(len(v))),
    "sum": ("sum", lambda v: float(v.sum())),
    "mean": ("mean", lambda v: float(v.mean()) if len(v) else math.nan),
    "sd": ("standard deviation", lambda v: float(v.std(ddof=1)) if len(v) > 1 else math.nan),
    "median": ("median", lambda v: float(np.median(v)) if len(v) else math.nan),
    "median_low": ("lower limit of the median (bootstrap)", lambda v: _median(v).low),
    "median_high": ("upper limit of the median (bootstrap)", lambda v: _median(v).high),
    "min": ("smallest", lambda v: float(v.min()) if len(v) else math.nan),
    "max": ("largest", lambda v: float(v.max()) if len(v) else math.nan),
    "share_low": ("lower limit of the share (Wilson)", lambda v: statistics.proportion(int(v.sum()), len(v)).low),
    "share_high": ("upper limit of the share (Wilson)", lambda v: statistics.proportion(int(v.sum()), len(v)).high),
}
TWO: Dict[str, Tuple[str, Callable[[np.ndarray, np.ndarray], float]]] = {
    "pairs": ("number of pairs", lambda a, b: float(len(a))),
    "faster": ("pairs with the smaller value for the first", lambda a, b: float((a < b).sum())),
    "difference": ("mean difference", lambda a, b: float((a - b).mean()) if len(a) else math.nan),
    "median_difference": (
        "difference of the medians",
        lambda a, b: float(np.median(a) - np.median(b)) if len(a) else math.nan,
    ),
    "z": ("Z of the Wilcoxon signed-rank test", lambda a, b: _compare(a, b).test.z),
    "p": ("asymptotic p of the Wilcoxon signed-rank test", lambda a, b: _compare(a, b).test.p),
    "p_exact": ("exact p of the Wilcoxon signed-rank test", lambda a, b: _compare(a, b).test.p_exact),
    "r": ("effect size r = |Z| / sqrt(2 x pairs)", lambda a, b: _compare(a, b).r),
    "rank_biserial": ("matched-pairs rank-biserial correlation", lambda a, b: _compare(a, b).rank_biserial),
    "shift": ("Hodges-Lehmann difference", lambda a, b: _compare(a, b).shift.estimate),
    "shift_low": ("its lower limit", lambda a, b: _compare(a, b).shift.low),
    "shift_high": ("its upper limit", lambda a, b: _compare(a, b).shift.high),
    "shift_confidence": ("confidence of its interval", lambda a, b: _compare(a, b).shift.confidence),
    "shapiro_w": ("W of the Shapiro-Wilk test of the differences", lambda a, b: _compare(a, b).normality.w),
    "shapiro_p": ("p of the Shapiro-Wilk test of the differences", lambda a, b: _compare(a, b).normality.p),
    "outliers": ("outliers among the differences (boxplot)", lambda a, b: float(len(_compare(a, b).outliers))),
    "ratio": ("ratio of the means, second over first", lambda a, b: _speedup(a, b).estimate),
    "ratio_low": ("its lower limit (bootstrap)", lambda a, b: _speedup(a, b).low),
    "ratio_high": ("its upper limit (bootstrap)", lambda a, b: _speedup(a, b).high),
    "mcnemar": ("exact p of McNemar's test", lambda a, b: statistics.mcnemar(a > 0, b > 0)),
}


@dataclass(frozen=True)
class Number:
    """A number and where it comes from.

    Attributes:
        id: its line in numbers.csv.
        where: column=value, joined by "; ".
        versus: "first vs second", the two methods whose runs are paired; "" for a statistic of one group.
        text: as the report writes it.
    """

    id: str
    value: float
    text: str
    statistic: str
    column: str
    file: str
    where: str
    versus: str
    lines: str

    @property
    def known(self) -> bool:
        return math.isfinite(self.value)

    def origin(self) -> str:
        """One line for a person."""
        meaning = (TWO if self.versus else ONE)[self.statistic][0]
        return (
            f"{meaning} of {self.column}"
            + (f", {self.versus}" if self.versus else "")
            + f" in {self.file}"
            + (f" where {self.where}" if self.where else "")
            + (f" (lines {self.lines})" if self.lines else "")
        )

    def __html__(self) -> Markup:
        return Markup('<a class="n" href="#{0}" title="{1}">{2}</a>').format(self.id, self.origin(), self.text)

    def __str__(self) -> str:
        return self.text


class Ledger:
    """Computes numbers of a study and keeps account of them."""

    def __init__(self, study: Study) -> None:
        self._study = study
        self._numbers: Dict[Tuple[Any, ...], Number] = {}

    def one(self, file: str, column: str, statistic: str, form: str, **where: str) -> Number:
        """A statistic of one group of rows; rows without a value are left out."""
        table = self._study.tables[file].select(**where)
        table = table.keep([math.isfinite(number(row, column)) for row in table.rows])
        values = np.array([number(row, column) for row in table.rows])
        return self._enter(
            (file, column, statistic, form, "", tuple(sorted(where.items()))),
            form,
            lambda: ONE[statistic][1](values),
            table.lines,
            where,
        )

    def two(self, file: str, column: str, statistic: str, form: str, methods: Tuple[str, str], **where: str) -> Number:
        """A statistic of two methods' runs, paired by participant and conditions; incomplete pairs are left out."""
        first, second, lines = paired(self._study.tables[file].select(**where), column, methods)
        return self._enter(
            (file, column, statistic, form, " vs ".join(methods), tuple(sorted(where.items()))),
            form,
            lambda: TWO[statistic][1](first, second),
            lines,
            where,
        )

    @property
    def numbers(self) -> List[Number]:
        """All that were asked for."""
        return list(self._numbers.values())

    def _enter(
        self,
        key: Tuple[Any, ...],
        form: str,
        compute: Callable[[], float],
        lines: Sequence[int],
        where: Mapping[str, str],
    ) -> Number:
        if key not in self._numbers:
            value = compute()
            text = FORMATS[form](value).replace("-", "\N{MINUS SIGN}") if math.isfinite(value) else "–"
            file, column, statistic, _, versus, _ = key
            self._numbers[key] = Number(
                f"n{len(self._numbers) + 1}",
                value,
                text,
                statistic,
                column,
                file,
                "; ".join(f"{name}={wanted}" for name, wanted in where.items()),
                versus,
                spans(lines),
            )
        return self._numbers[key]


def paired(table: Table, column: str, methods: Tuple[str, str]) -> Tuple[np.ndarray, np.ndarray, List[int]]:
    """(first, second, lines): the values of two methods in the same order of participants and conditions.

    Raises:
        CodedError: "bad_study" if a participant has two runs under the same conditions.
    """
    found: Dict[Tuple[str, ...], Dict[str, Tuple[float, int]]] = {}
    for row, line in zip(table.rows, table.lines):
        value = number(row, column)
        if row["method"] not in methods or not math.isfinite(value):
            continue
        key = tuple(
            row.get(name, "") for name in ("participant", "scenario", "sweep", "parameter", "factor", "value", "runner")
        )
        pair = found.setdefault(key, {})
        if row["method"] in pair:
            raise CodedError(
                "bad_study",
                f"{table.name}, lines {pair[row['method']][1]} and {line}: the same participant, scenario and "
                "method twice: each may have one run",
            )
        pair[row["method"]] = (value, line)
    pairs = [pair for pair in found.values() if len(pair) == 2]
    first, second = (np.array([pair[method][0] for pair in pairs], dtype=float) for method in methods)
    return first, second, sorted(pair[method][1] for pair in pairs for method in methods)


def spans(lines: Sequence[int]) -> str:
    """Line numbers with runs of neighbours joined: "2-4, 7"."""
    parts: List[List[int]] = []
    for line in sorted(lines):
        if parts and line == parts[-1][1] + 1:
            parts[-1][1] = line
        else:
            parts.append([line, line])
    return ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in parts)
