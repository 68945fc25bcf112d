"""Puts the report together: numbers, tables, figures, page."""
from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

import jinja2
import numpy as np
from markupsafe import Markup

from vb_core.errors import CodedError
from vb_evaluation.report import charts, explanations, maps, paper, sweeps
from vb_evaluation.report.contents import TOLERATED_LOSS, Contents
from vb_evaluation.report.data import AGREEMENT, CURVES, REQUIRED, RUNS, SENSITIVITY, STATES, Row, Study, number, read_study, write_table
from vb_evaluation.report.ledger import ONE, TWO, Ledger, Number
from vb_evaluation.report.paper import PAPER

PAGE, NUMBERS, TABLES = "report.html", "numbers.csv", "tables"
_TORNADO_ROWS = 24


def write_report(folder: Path) -> Path:
    """Writes report.html, numbers.csv and tables/*.csv into a study's folder.

    Only runs.csv must be there; what is missing is left out of the page.

    Returns:
        The page.

    Raises:
        CodedError: "bad_study" naming the file, and the line or column; "cannot_write".
    """
    study = read_study(folder)
    ledger = Ledger(study)
    values = _values(study, ledger)
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(str(Path(__file__).parent)), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True,
    )
    values["css"] = Markup((Path(__file__).parent / "page.css").read_text(encoding="utf-8"))
    page = study.folder / PAGE
    try:
        page.write_text(environment.get_template("page.html.j2").render(values), encoding="utf-8")
        _write_tables(study.folder, values)
        write_table(study.folder / NUMBERS, ("id", "text", "value", "statistic", "column", "methods", "file", "where", "lines"), [
            {"id": entry.id, "text": entry.text, "value": repr(entry.value), "statistic": entry.statistic, "column": entry.column,
             "methods": entry.versus, "file": entry.file, "where": entry.where, "lines": entry.lines} for entry in ledger.numbers
        ])
    except OSError as error:
        raise CodedError("cannot_write", f"cannot write the report into {study.folder}: {error.strerror}") from None
    return page


def _values(study: Study, ledger: Ledger) -> Dict[str, Any]:
    """All that the template shows."""
    contents = Contents(study, ledger)
    people = bool(study.meta.get("people", False))
    nominal, settings = sweeps.sensitivity(study, ledger)
    curves = sweeps.curves(study, ledger)
    pictures, notes = maps.representatives(study)
    beside = contents.beside_the_paper()
    values: Dict[str, Any] = {
        "people": people,
        "quick": bool(study.meta.get("quick", False)),
        "participants": len(study.participants),
        "runs_total": len(study.runs.rows),
        "scenarios": study.scenarios,
        "methods": study.methods,
        "method_names": [study.method_title(method) for method in study.methods],
        "several": len(study.methods) > 2,
        "baseline_name": study.method_title(study.baseline),
        "methods_compared": sweeps.methods_named(study) if len(study.methods) > 1 else "",
        "facts": _facts(study),
        "citation": paper.CITATION,
        "verdicts": contents.verdicts(),
        "state_key": [(charts.STATE_COLORS[state], state.capitalize()) for state in STATES],
        "method_key": [(charts.color_of(method, index), study.method_title(method)) for index, method in enumerate(study.methods)],
        "times": contents.times(),
        "time_tests": contents.time_tests(),
        "time_bars": _time_bars(study),
        "accuracy": contents.accuracy(),
        "accuracy_tests": contents.accuracy_tests(),
        "accuracy_boxes": _boxes(study),
        "map_rows": _map_rows(study, pictures),
        "map_notes": notes,
        "map_key": {name: "#{:02x}{:02x}{:02x}".format(*color) for name, color in
                    (("truth", maps.TRUTH), ("agreement", maps.AGREEMENT), ("excess", maps.EXCESS), ("union", maps.UNION))},
        "completeness": contents.completeness(),
        "completeness_figure": _rates(study, ledger),
        "beside": beside,
        "differences": explanations.differences(study, contents) if beside and not people else [],
        "sweeps": [_sweep(study, name, found) for name, found in curves.items()],
        "nominal": nominal,
        "settings": settings,
        "standing": _standing(settings),
        "tolerated_loss": f"{TOLERATED_LOSS:.3f}".lstrip("0"),
        "agreement": _agreement(study),
        "further": contents.further(),
        "rerun": study.meta.get("rerun", ""),
        "reruns": [(file, study.meta[key]) for key, file in (("rerun", RUNS), ("rerun_curves", CURVES), ("rerun_sensitivity", SENSITIVITY))
                   if study.meta.get(key)],
        "run_columns": [column for column in study.runs.columns],
        "all_runs": [{"line": line, "cells": [row[column] for column in study.runs.columns], "command": rerun(study, row)}
                     for row, line in zip(study.runs.rows, study.runs.lines)],
    }
    if settings and nominal is not None:
        values.update(_tornados(study, nominal, settings))
    values["sections"] = [(key, title) for key, title, shown in (
        ("findings", "Findings", values["verdicts"]), ("time", "Interaction time", True), ("accuracy", "Accuracy", True),
        ("completeness", "Completeness", True), ("paper", "Beside the paper", beside), ("curves", "Curves", values["sweeps"]),
        ("sensitivity", "Sensitivity", settings), ("agreement", "Through ROS", values["agreement"]),
        ("further", "Further measures", values["further"]), ("trace", "Every run, every number", True),
    ) if shown]
    values["numbers"] = [
        {"id": entry.id, "text": entry.text, "meaning": (TWO if entry.versus else ONE)[entry.statistic][0], "column": entry.column,
         "versus": entry.versus, "file": entry.file, "where": entry.where, "lines": entry.lines} for entry in ledger.numbers
    ]
    return values


def rerun(study: Study, row: Row) -> str:
    """The command that makes a row again, alone; "" if the study does not say how."""
    pattern = study.meta.get("rerun", "")
    try:
        return str(pattern).format(**row)
    except (KeyError, IndexError, ValueError) as error:
        raise CodedError("bad_study", f"study.json: rerun: {pattern!r} does not fit the columns of {RUNS}: {error}") from None


# ------------------------------------------------------------------ figures
def _column(study: Study, column: str, **where: str) -> np.ndarray:
    """(N,) the known values of a column of runs.csv."""
    found = np.array([number(row, column) for row in study.runs.select(**where).rows], dtype=float)
    return found[np.isfinite(found)]


def _time_bars(study: Study) -> List[Tuple[str, str]]:
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


def _boxes(study: Study) -> List[Tuple[str, str]]:
    figures = []
    for scenario in study.scenarios:
        groups = []
        for method in study.methods:
            published = PAPER[scenario].jaccard.get(method) if scenario in PAPER else None
            groups.append((method, study.method_title(method), _column(study, "jaccard", scenario=scenario, method=method, completed="1"),
                           published))
        figures.append((study.scenario_title(scenario), charts.boxes(groups, "Jaccard index")))
    return figures


def _rates(study: Study, ledger: Ledger) -> str:
    groups = []
    for scenario in study.scenarios:
        bars = []
        for method in study.methods:
            share, low, high = (ledger.one(RUNS, "completed", statistic, "share", scenario=scenario, method=method).value
                                for statistic in ("mean", "share_low", "share_high"))
            published = PAPER[scenario].completeness if scenario in PAPER and method in PAPER[scenario].jaccard else None
            bars.append((method, study.method_title(method), share, low, high, published))
        groups.append((study.scenario_title(scenario), bars))
    return charts.rates(groups)


def _map_rows(study: Study, pictures: Sequence[maps.MapPicture]) -> List[List[Optional[Dict[str, Any]]]]:
    """Rows of the figure: ground truths, then one row per method; one column per scenario."""
    scenarios = [key for key in study.scenarios if any(entry.scenario == key for entry in pictures)]
    found = {(entry.scenario, entry.method): entry for entry in pictures}
    rows = []
    for method in ["", *study.methods] if scenarios else []:
        row: List[Optional[Dict[str, Any]]] = []
        for scenario in scenarios:
            entry = found.get((scenario, method))
            title = f"{study.scenario_title(scenario)}: " + (study.method_title(method).lower() if method else "ground truth")
            row.append(entry and {"uri": charts.data_uri(entry.png, "image/png"), "title": title, "line": entry.line,
                                  "score": f"Jaccard {entry.jaccard:.3f}", "alt": f"Map, {title}"})
        rows.append(row)
    return rows


def _sweep(study: Study, name: str, curves: Sequence[sweeps.Curve]) -> Dict[str, Any]:
    speedups, times, accuracies = [], [], []
    for index, curve in enumerate(curves):
        x, title = [point.x for point in curve.points], study.scenario_title(curve.scenario)
        style = {"color": charts.SERIES[(index + 2) % len(charts.SERIES)], "marker": charts.MARKERS[index % len(charts.MARKERS)]}
        speedups.append((title, x, [point.speedup.value for point in curve.points], [point.speedup_low.value for point in curve.points],
                         [point.speedup_high.value for point in curve.points], style))
        for method, line in ((study.methods[0], "-"), (study.baseline, "--")):
            times.append((f"{title}, {study.method_title(method).lower()}", x, [point.times[method].value for point in curve.points],
                          None, None, dict(style, linestyle=line)))
            accuracies.append((f"{title}, {study.method_title(method).lower()}", x, [point.jaccard[method].value for point in curve.points],
                               None, None, dict(style, linestyle=line)))
    return {
        "name": name, "title": curves[0].title, "axis": curves[0].axis,
        "speedup": charts.lines(speedups, curves[0].axis, "speed-up", level=1.0),
        "time": charts.lines(times, curves[0].axis, "mean interaction time [s]"),
        "jaccard": charts.lines(accuracies, curves[0].axis, "Jaccard index, median"),
        "note": explanations.curve_words(study, curves),
        "curves": [{"name": study.scenario_title(curve.scenario), "points": curve.points} for curve in curves],
    }


def _tornados(study: Study, nominal: sweeps.Setting, settings: Sequence[sweeps.Setting]) -> Dict[str, str]:
    def rows(of: str) -> Tuple[List[Tuple[str, List[Tuple[str, float]]]], float]:
        centre = getattr(nominal, of).value
        found: Dict[str, List[Tuple[str, float]]] = {}
        for setting in settings:
            found.setdefault(setting.parameter, []).append((setting.factor, getattr(setting, of).value))
        reach = {name: max((abs(value - centre) for _, value in results if math.isfinite(value)), default=0.0)
                 for name, results in found.items()}
        longest = sorted(found, key=lambda name: -reach[name])[:_TORNADO_ROWS]
        return [(name, found[name]) for name in longest], centre

    speedup, jaccard = rows("speedup"), rows("jaccard")
    return {
        "tornado_time": charts.tornado(*speedup, "speed-up over all scenarios"),
        "tornado_jaccard": charts.tornado(*jaccard, f"mean Jaccard index, {study.method_title(study.methods[0]).lower()}"),
    }


# ------------------------------------------------------------------ words and tables
def _facts(study: Study) -> List[str]:
    named = (("world", "world {}"), ("seed", "seed {}"), ("software", "software {}"), ("created", "{}"))
    return [words.format(study.meta[key]) for key, words in named if study.meta.get(key) not in (None, "")]


def _standing(settings: Sequence[sweeps.Setting]) -> List[Any]:
    if not settings:
        return []
    counts = [(sum(getattr(setting, flag) for setting in settings), words) for flag, words in
              (("faster", "is it faster in every scenario"), ("no_loss", "is there no loss of accuracy"), ("complete", "is it as complete"))]
    words: List[Any] = [f"With each of {len({s.parameter for s in settings})} assumed parameters changed ({len(settings)} settings): "]
    words.append("; ".join(f"in {count} of {len(settings)} {claim}" for count, claim in counts) + ".")
    fallen = [f"{setting.parameter} × {setting.factor}" for setting in settings if not (setting.faster and setting.no_loss and setting.complete)]
    if fallen:
        words.append(f" A conclusion falls with: {', '.join(fallen)}.")
    return words


def _agreement(study: Study) -> Optional[Dict[str, Any]]:
    table = study.tables.get(AGREEMENT)
    if table is None or not table.rows:
        return None
    measures = [column for column in REQUIRED if column not in ("participant", "scenario", "method", "seed")]
    ordered = sorted(table.rows, key=lambda row: [row[column] for column in ("scenario", "method", "participant", "runner")])
    return {
        "columns": ["runner", *measures],
        "rows": [{"name": f"{row['participant']}, {study.scenario_title(row['scenario'])}, {study.method_title(row['method']).lower()}",
                  "values": [row["runner"], *(row[column] for column in measures)]} for row in ordered],
    }


def _write_tables(folder: Path, values: Mapping[str, Any]) -> None:
    """Each table of the page as CSV; a number as the page writes it."""
    tables = folder / TABLES
    tables.mkdir(exist_ok=True)
    for old in tables.glob("*.csv"):
        old.unlink()
    found: Dict[str, List[Dict[str, Any]]] = {
        name: list(values[name]) for name in ("times", "time_tests", "accuracy", "accuracy_tests", "completeness", "further")
    }
    found["beside_the_paper"] = [
        {"scenario": row.scenario, "quantity": row.quantity, "paper": row.paper, "here": "".join(map(str, row.ours)), "verdict": row.verdict}
        for row in values["beside"]
    ]
    found["curves"] = [
        {"sweep": sweep["name"], "scenario": curve["name"], "value": point.value, "speedup": point.speedup, "speedup_low": point.speedup_low,
         "speedup_high": point.speedup_high, **{f"time_{method}": entry for method, entry in point.times.items()},
         **{f"jaccard_{method}": entry for method, entry in point.jaccard.items()},
         **{f"completed_{method}": entry for method, entry in point.completeness.items()}}
        for sweep in values["sweeps"] for curve in sweep["curves"] for point in curve["points"]
    ]
    settings = [setting for setting in [values["nominal"], *values["settings"]] if setting is not None]
    found["sensitivity"] = [
        {"parameter": setting.parameter, "factor": setting.factor, "value": setting.value, "scenario": row["scenario"],
         "speedup": row["speedup"], "speedup_low": row["speedup_low"], "jaccard": row["jaccard"], "jaccard_difference": row["loss"],
         "completed": row["completeness"], "faster": int(setting.faster), "no_loss": int(setting.no_loss), "complete": int(setting.complete)}
        for setting in settings for row in setting.by_scenario
    ]
    for name, rows in found.items():
        if rows:
            write_table(tables / f"{name}.csv", list(rows[0]), [{key: _plain(value) for key, value in row.items()} for row in rows])


def _plain(value: Any) -> Any:
    if isinstance(value, Number):
        return repr(value.value) if value.known else ""
    return value


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else 0.0
