"""The tables of the report: time, accuracy, completeness, and measures of the user's own."""
from __future__ import annotations

from typing import Any, Callable, Dict, List, Tuple

from vb_evaluation.report.data import RUNS, STATES, Study
from vb_evaluation.report.ledger import Ledger, Number
from vb_evaluation.report.paper import PAPER, Published, index_text, percent_text, published, test_text


class Contents:
    """Everything that the page says about runs.csv.

    Args:
        study: as it was read.
        ledger: computes and keeps the numbers.
    """

    def __init__(self, study: Study, ledger: Ledger) -> None:
        self.study = study
        self.ledger = ledger

    @property
    def comparisons(self) -> List[Tuple[str, str]]:
        """Pairs (method, baseline) to be compared; none if there is one method only."""
        return [(method, self.study.baseline) for method in self.study.methods[:-1]]

    # ------------------------------------------------------------------ tables
    def times(self) -> List[Dict[str, Any]]:
        """Mean time in each state, by scenario and method."""
        rows = []
        for scenario in self.study.scenarios:
            for method in self.study.methods:
                where = {"scenario": scenario, "method": method}
                row: Dict[str, Any] = {
                    "scenario": self.study.scenario_title(scenario),
                    "method": self.study.method_title(method),
                }
                for state in STATES:
                    row[state] = self.one(f"time_{state}_s", "mean", "seconds", **where)
                row["total"] = self.one("time_total_s", "mean", "seconds", **where)
                row["sd"] = self.one("time_total_s", "sd", "seconds", **where)
                row["median"] = self.one("time_total_s", "median", "seconds", **where)
                row["runs"] = self.one("time_total_s", "n", "count", **where)
                rows.append(row)
        return rows

    def time_tests(self) -> List[Dict[str, Any]]:
        """The paper's test of the interaction time, with effect sizes."""
        rows = []
        for scenario in self.study.scenarios:
            for methods in self.comparisons:
                row = self._tests("time_total_s", "seconds", methods, scenario)
                row["speedup"] = self.two("time_total_s", "ratio", "factor", methods, scenario=scenario)
                row["speedup_low"] = self.two("time_total_s", "ratio_low", "factor", methods, scenario=scenario)
                row["speedup_high"] = self.two("time_total_s", "ratio_high", "factor", methods, scenario=scenario)
                row["faster"] = self.two("time_total_s", "faster", "count", methods, scenario=scenario)
                row["paper"] = test_text(scenario, methods, "time")
                row["paper_speedup"] = f"{PAPER[scenario].speedup}" if published(scenario, methods) else "–"
                rows.append(row)
        return rows

    def accuracy(self) -> List[Dict[str, Any]]:
        """Jaccard index of completed runs, by scenario and method."""
        rows = []
        for scenario in self.study.scenarios:
            for method in self.study.methods:
                where = {"scenario": scenario, "method": method, "completed": "1"}
                rows.append(
                    {
                        "scenario": self.study.scenario_title(scenario),
                        "method": self.study.method_title(method),
                        "median": self.one("jaccard", "median", "index", **where),
                        "low": self.one("jaccard", "median_low", "index", **where),
                        "high": self.one("jaccard", "median_high", "index", **where),
                        "min": self.one("jaccard", "min", "index", **where),
                        "max": self.one("jaccard", "max", "index", **where),
                        "runs": self.one("jaccard", "n", "count", **where),
                        "paper": _or_dash(
                            scenario, method, lambda found, method=method: index_text(found.jaccard[method])
                        ),
                    }
                )
        return rows

    def accuracy_tests(self) -> List[Dict[str, Any]]:
        """The paper's test of the accuracy, over pairs of completed runs."""
        rows = []
        for scenario in self.study.scenarios:
            for methods in self.comparisons:
                row = self._tests("jaccard", "index", methods, scenario, completed="1")
                row["paper"] = test_text(scenario, methods, "accuracy")
                rows.append(row)
        return rows

    def completeness(self) -> List[Dict[str, Any]]:
        """Success rates, by scenario and method."""
        rows = []
        for scenario in self.study.scenarios:
            for method in self.study.methods:
                where = {"scenario": scenario, "method": method}
                rows.append(
                    {
                        "scenario": self.study.scenario_title(scenario),
                        "method": self.study.method_title(method),
                        "share": self.one("completed", "mean", "share", **where),
                        "low": self.one("completed", "share_low", "share", **where),
                        "high": self.one("completed", "share_high", "share", **where),
                        "successes": self.one("completed", "sum", "count", **where),
                        "runs": self.one("completed", "n", "count", **where),
                        "paper": _or_dash(scenario, method, lambda found: percent_text(found.completeness)),
                    }
                )
        return rows

    def further(self) -> List[Dict[str, Any]]:
        """Medians of the columns that the paper has not."""
        rows = []
        for column in self.study.further_measures:
            for scenario in self.study.scenarios:
                row: Dict[str, Any] = {"measure": column, "scenario": self.study.scenario_title(scenario)}
                for method in self.study.methods:
                    row[method] = self.one(column, "median", "plain", scenario=scenario, method=method)
                rows.append(row)
        return rows

    # ------------------------------------------------------------------ numbers of runs.csv
    def one(self, column: str, statistic: str, form: str, **where: str) -> Number:
        """A statistic of one group of runs; see `Ledger.one`."""
        return self.ledger.one(RUNS, column, statistic, form, **where)

    def two(self, column: str, statistic: str, form: str, methods: Tuple[str, str], **where: str) -> Number:
        """A statistic of paired runs; see `Ledger.two`."""
        return self.ledger.two(RUNS, column, statistic, form, methods, **where)

    def _tests(self, column: str, form: str, methods: Tuple[str, str], scenario: str, **where: str) -> Dict[str, Any]:
        asked = {
            "pairs": "count",
            "shapiro_w": "index",
            "shapiro_p": "p",
            "outliers": "count",
            "z": "z",
            "p": "p",
            "p_exact": "p",
            "r": "index",
            "rank_biserial": "index",
            "shift": form,
            "shift_low": form,
            "shift_high": form,
            "shift_confidence": "share",
        }
        row: Dict[str, Any] = {
            "scenario": self.study.scenario_title(scenario),
            "methods": " against ".join(map(self.study.method_title, methods)),
        }
        for statistic, written in asked.items():
            row[statistic] = self.two(column, statistic, written, methods, scenario=scenario, **where)
        return row


def _or_dash(scenario: str, method: str, text: Callable[[Published], str]) -> str:
    """What the paper has for a scenario and method, as text; "–" if it has nothing."""
    return text(PAPER[scenario]) if published(scenario, (method,)) else "–"
