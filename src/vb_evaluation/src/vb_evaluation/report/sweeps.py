"""What the paper could not say: curves over the surroundings, and sensitivity to what is assumed."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, List, Optional, Tuple

from vb_evaluation.report.findings import TOLERATED_LOSS
from vb_evaluation.report.data import CURVES, RUNS, SENSITIVITY, Study
from vb_evaluation.report.ledger import Ledger, Number

NOMINAL = "1"
SWEEP_TITLES = {
    "coverage": "Camera coverage",
    "distance": "Distance of the robot",
    "border_length": "Border length",
    "robots": "Number of robots",
}
SWEEP_AXES = {
    "coverage": "part of the floor that ceiling cameras see",
    "distance": "way of the robot to the border [m]",
    "border_length": "length of the border [m]",
    "robots": "robots",
}


@dataclass(frozen=True)
class CurvePoint:
    """One value of a sweep in one scenario; what is missing is unknown (nan)."""

    x: float
    value: str
    speedup: Number
    speedup_low: Number
    speedup_high: Number
    times: Dict[str, Number]
    jaccard: Dict[str, Number]
    completeness: Dict[str, Number]
    runs: Number


@dataclass(frozen=True)
class Curve:
    """A sweep in one scenario, by rising value."""

    sweep: str
    scenario: str
    points: List[CurvePoint]

    @property
    def title(self) -> str:
        return SWEEP_TITLES.get(self.sweep, self.sweep.replace("_", " ").capitalize())

    @property
    def axis(self) -> str:
        return SWEEP_AXES.get(self.sweep, self.sweep.replace("_", " "))


@dataclass(frozen=True)
class Setting:
    """What came out with one parameter at one multiple of its value; the parameter "" is the study as it is.

    Attributes:
        value: what it was set to.
        speedup, jaccard, completed: over all scenarios; the latter two of the first method.
        by_scenario: speed-up, loss of accuracy and completeness by scenario.
        faster, no_loss, complete: whether the conclusion stands.
    """

    parameter: str
    factor: str
    value: str
    speedup: Number
    jaccard: Number
    completed: Number
    by_scenario: List[Dict[str, Any]]
    faster: bool
    no_loss: bool
    complete: bool


def curves(study: Study, ledger: Ledger) -> Dict[str, List[Curve]]:
    """Curves by sweep; empty without curves.csv or without two methods."""
    if CURVES not in study.tables or len(study.methods) < 2:
        return {}
    table, methods = study.tables[CURVES], (study.methods[0], study.baseline)
    found: Dict[str, List[Curve]] = {}
    for sweep in table.distinct("sweep"):
        rows = table.select(sweep=sweep)
        for scenario in rows.distinct("scenario"):
            values = sorted(rows.select(scenario=scenario).distinct("value"), key=float)
            points = [
                _point(ledger, study, methods, {"sweep": sweep, "value": value, "scenario": scenario})
                for value in values
            ]
            found.setdefault(sweep, []).append(Curve(sweep, scenario, points))
    return found


def _point(ledger: Ledger, study: Study, methods: Tuple[str, str], where: Dict[str, str]) -> CurvePoint:
    def two(column: str, statistic: str, form: str) -> Number:
        # somebody who gave up after minutes has not done the task: his time says when he lost patience
        return ledger.two(CURVES, column, statistic, form, methods, completed="1", **where)

    def each(column: str, statistic: str, form: str, **more: str) -> Dict[str, Number]:
        return {
            method: ledger.one(CURVES, column, statistic, form, method=method, **where, **more)
            for method in study.methods
        }

    return CurvePoint(
        x=float(where["value"]),
        value=where["value"],
        speedup=two("time_total_s", "ratio", "factor"),
        speedup_low=two("time_total_s", "ratio_low", "factor"),
        speedup_high=two("time_total_s", "ratio_high", "factor"),
        times=each("time_total_s", "mean", "seconds", completed="1"),
        jaccard=each("jaccard", "median", "index", completed="1"),
        completeness=each("completed", "mean", "share"),
        runs=ledger.one(CURVES, "time_total_s", "n", "count", **where),
    )


def sensitivity(study: Study, ledger: Ledger) -> Tuple[Optional[Setting], List[Setting]]:
    """(nominal, settings): every parameter at its other values, beside the same participants with nothing changed.

    Rows with factor 1 in sensitivity.csv are the nominal ones; without any, the same participants' runs in runs.csv.
    """
    if SENSITIVITY not in study.tables or len(study.methods) < 2:
        return None, []
    table = study.tables[SENSITIVITY]
    nominal_rows = table.select(factor="|".join((NOMINAL, "1.0")))
    if nominal_rows.rows:
        keys = {column: (nominal_rows.distinct(column) or [""])[0] for column in ("parameter", "factor")}
        nominal = _setting(study, ledger, SENSITIVITY, keys)
    else:
        nominal = _setting(
            study, ledger, RUNS, {column: "|".join(table.distinct(column)) for column in ("participant", "scenario")}
        )
    settings = []
    for parameter in table.distinct("parameter"):
        for factor in sorted(table.select(parameter=parameter).distinct("factor"), key=float):
            if float(factor) != 1.0:
                settings.append(_setting(study, ledger, SENSITIVITY, {"parameter": parameter, "factor": factor}))
    return nominal, settings


def _setting(study: Study, ledger: Ledger, file: str, where: Dict[str, str]) -> Setting:
    methods = (study.methods[0], study.baseline)
    rows = study.tables[file].select(**where)
    by_scenario = []
    for scenario in rows.distinct("scenario"):
        here = dict(where, scenario=scenario)
        by_scenario.append(
            {
                "scenario": study.scenario_title(scenario),
                "speedup": ledger.two(file, "time_total_s", "ratio", "factor", methods, **here),
                "speedup_low": ledger.two(file, "time_total_s", "ratio_low", "factor", methods, **here),
                "pairs": ledger.two(file, "time_total_s", "pairs", "count", methods, **here),
                "faster": ledger.two(file, "time_total_s", "faster", "count", methods, **here),
                "loss": ledger.two(file, "jaccard", "median_difference", "index", methods, completed="1", **here),
                "jaccard": ledger.one(file, "jaccard", "median", "index", method=methods[0], completed="1", **here),
                "completeness": ledger.one(file, "completed", "mean", "share", method=methods[0], **here),
                "mcnemar": ledger.two(file, "completed", "mcnemar", "p", methods, **here),
                "completeness_gain": ledger.two(file, "completed", "difference", "share", methods, **here),
            }
        )
    return Setting(
        parameter=where.get("parameter", ""),
        factor=where.get("factor", NOMINAL),
        value=(rows.distinct("value") or [""])[0],
        speedup=ledger.two(file, "time_total_s", "ratio", "factor", methods, **where),
        jaccard=ledger.one(file, "jaccard", "mean", "index", method=methods[0], completed="1", **where),
        completed=ledger.one(file, "completed", "mean", "share", method=methods[0], **where),
        by_scenario=by_scenario,
        faster=all(_faster(row) for row in by_scenario),
        no_loss=all(row["loss"].value >= -TOLERATED_LOSS for row in by_scenario if row["loss"].known),
        complete=all(not (row["mcnemar"].value < 0.05 and row["completeness_gain"].value < 0.0) for row in by_scenario),
    )


def _faster(row: Dict[str, Any]) -> bool:
    """Whether a scenario is done faster: by the interval of the speed-up, or, without one, by everybody."""
    if row["speedup_low"].known:
        return row["speedup_low"].value > 1.0
    return row["pairs"].value > 0 and row["faster"].value == row["pairs"].value


def methods_named(study: Study) -> str:
    """The two methods that curves and sensitivity compare, for a heading."""
    return f"{study.method_title(study.methods[0])} against {study.method_title(study.baseline).lower()}"
