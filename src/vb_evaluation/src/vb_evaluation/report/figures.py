"""The figures of the page, made of the study's rows."""
from __future__ import annotations

import math
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np

from vb_evaluation.report import charts, explanations, maps, sweeps
from vb_evaluation.report.data import RUNS, STATES, Study, number
from vb_evaluation.report.ledger import Ledger
from vb_evaluation.report.paper import PAPER

TORNADO_ROWS = 24


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else 0.0


def _column(study: Study, column: str, **where: str) -> np.ndarray:
    """(N,) the known values of a column of runs.csv."""
    found = np.array([number(row, column) for row in study.runs.select(**where).rows], dtype=float)
    return found[np.isfinite(found)]


def time_bars(study: Study) -> List[Tuple[str, str]]:
    totals = _column(study, "time_total_s")
    limit = 1.04 * float(totals.max()) if len(totals) else 1.0
    figures = []
    for scenario in study.scenarios:
        bars = []
        for method in study.methods:
            where = {"scenario": scenario, "method": method}
            means = {state: _mean(_column(study, f"time_{state}_s", **where)) for state in STATES}
            bars.append((method, study.method_title(method), means, _column(study, "time_total_s", **where)))
        figures.append((study.scenario_title(scenario), charts.time_bars(bars, limit)))
    return figures


def boxes(study: Study) -> List[Tuple[str, str]]:
    figures = []
    for scenario in study.scenarios:
        groups = []
        for method in study.methods:
            published = PAPER[scenario].jaccard.get(method) if scenario in PAPER else None
            groups.append(
                (
                    method,
                    study.method_title(method),
                    _column(study, "jaccard", scenario=scenario, method=method, completed="1"),
                    published,
                )
            )
        figures.append((study.scenario_title(scenario), charts.boxes(groups, "Jaccard index")))
    return figures


def rates(study: Study, ledger: Ledger) -> str:
    groups = []
    for scenario in study.scenarios:
        bars = []
        for method in study.methods:
            share, low, high = (
                ledger.one(RUNS, "completed", statistic, "share", scenario=scenario, method=method).value
                for statistic in ("mean", "share_low", "share_high")
            )
            published = (
                PAPER[scenario].completeness if scenario in PAPER and method in PAPER[scenario].jaccard else None
            )
            bars.append((method, study.method_title(method), share, low, high, published))
        groups.append((study.scenario_title(scenario), bars))
    return charts.rates(groups)


def map_rows(study: Study, pictures: Sequence[maps.MapPicture]) -> List[List[Optional[Dict[str, Any]]]]:
    """Rows of the figure: ground truths, then one row per method; one column per scenario."""
    scenarios = [key for key in study.scenarios if any(entry.scenario == key for entry in pictures)]
    found = {(entry.scenario, entry.method): entry for entry in pictures}
    rows = []
    for method in ["", *study.methods] if scenarios else []:
        row: List[Optional[Dict[str, Any]]] = []
        for scenario in scenarios:
            entry = found.get((scenario, method))
            title = f"{study.scenario_title(scenario)}: " + (
                study.method_title(method).lower() if method else "ground truth"
            )
            row.append(
                entry
                and {
                    "uri": charts.data_uri(entry.png, "image/png"),
                    "title": title,
                    "line": entry.line,
                    "score": f"Jaccard {entry.jaccard:.3f}",
                    "alt": f"Map, {title}",
                }
            )
        rows.append(row)
    return rows


def sweep(study: Study, name: str, curves: Sequence[sweeps.Curve]) -> Dict[str, Any]:
    speedups, times, accuracies = [], [], []
    for curve in curves:
        # a scenario has the same look in every figure
        index = study.scenarios.index(curve.scenario) if curve.scenario in study.scenarios else len(study.scenarios)
        x, title = [point.x for point in curve.points], study.scenario_title(curve.scenario)
        style = {
            "color": charts.SERIES[(index + 2) % len(charts.SERIES)],
            "marker": charts.MARKERS[index % len(charts.MARKERS)],
        }
        speedups.append(
            (
                title,
                x,
                [point.speedup.value for point in curve.points],
                [point.speedup_low.value for point in curve.points],
                [point.speedup_high.value for point in curve.points],
                style,
            )
        )
        for method, line in ((study.methods[0], "-"), (study.baseline, "--")):
            times.append(
                (
                    f"{title}, {study.method_title(method).lower()}",
                    x,
                    [point.times[method].value for point in curve.points],
                    None,
                    None,
                    dict(style, linestyle=line),
                )
            )
            accuracies.append(
                (
                    f"{title}, {study.method_title(method).lower()}",
                    x,
                    [point.jaccard[method].value for point in curve.points],
                    None,
                    None,
                    dict(style, linestyle=line),
                )
            )
    return {
        "name": name,
        "title": curves[0].title,
        "axis": curves[0].axis,
        "speedup": charts.lines(speedups, curves[0].axis, "speed-up", level=1.0),
        "time": charts.lines(times, curves[0].axis, "mean interaction time [s]"),
        "jaccard": charts.lines(accuracies, curves[0].axis, "Jaccard index, median"),
        "note": explanations.curve_words(study, curves),
        "curves": [{"name": study.scenario_title(curve.scenario), "points": curve.points} for curve in curves],
    }


def tornados(study: Study, nominal: sweeps.Setting, settings: Sequence[sweeps.Setting]) -> Dict[str, str]:
    def rows(of: str) -> Tuple[List[Tuple[str, List[Tuple[str, float]]]], float]:
        centre = getattr(nominal, of).value
        found: Dict[str, List[Tuple[str, float]]] = {}
        for setting in settings:
            found.setdefault(setting.parameter, []).append((setting.factor, getattr(setting, of).value))
        reach = {
            name: max((abs(value - centre) for _, value in results if math.isfinite(value)), default=0.0)
            for name, results in found.items()
        }
        longest = sorted(found, key=lambda name: -reach[name])
        # what changes nothing has no bar; one row stays if nothing does
        longest = [name for name in longest if reach[name] > 1e-9][:TORNADO_ROWS] or longest[:1]
        return [(name, found[name]) for name in longest], centre

    speedup, jaccard = rows("speedup"), rows("jaccard")
    return {
        "tornado_time": charts.tornado(
            *speedup, "speed-up, " + ", ".join(row["scenario"] for row in nominal.by_scenario)
        ),
        "tornado_jaccard": charts.tornado(
            *jaccard, f"mean Jaccard index, {study.method_title(study.methods[0]).lower()}"
        ),
    }
