"""Puts the report together: numbers, tables, figures, page."""
from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence

import jinja2
from markupsafe import Markup

from vb_core.errors import CodedError
from vb_evaluation.report import charts, explanations, figures, findings, maps, paper, sweeps
from vb_evaluation.report.contents import Contents
from vb_evaluation.report.data import (
    AGREEMENT,
    CURVES,
    REQUIRED,
    RUNS,
    SENSITIVITY,
    STATES,
    Row,
    Study,
    read_study,
    write_table,
)
from vb_evaluation.report.ledger import ONE, TWO, Ledger, Number

PAGE, NUMBERS, TABLES = "report.html", "numbers.csv", "tables"


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
        loader=jinja2.FileSystemLoader(str(Path(__file__).parent)),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
    )
    values["css"] = Markup((Path(__file__).parent / "page.css").read_text(encoding="utf-8"))
    page = study.folder / PAGE
    try:
        page.write_text(environment.get_template("page.html.j2").render(values), encoding="utf-8")
        _write_tables(study.folder, values)
        write_table(study.folder / NUMBERS, list(values["numbers"][0]), values["numbers"])
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
    beside = findings.beside_the_paper(contents)
    values: Dict[str, Any] = {
        "people": people,
        "quick": bool(study.meta.get("quick", False)),
        "participants": len(study.participants),
        "runs_total": len(study.runs.rows),
        "missing": _missing(study),
        "scenarios": study.scenarios,
        "methods": study.methods,
        "method_names": [study.method_title(method) for method in study.methods],
        "several": len(study.methods) > 2,
        "baseline_name": study.method_title(study.baseline),
        "methods_compared": sweeps.methods_named(study) if len(study.methods) > 1 else "",
        "facts": _facts(study),
        "citation": paper.CITATION,
        "verdicts": findings.verdicts(contents),
        "state_key": [(charts.STATE_COLORS[state], state.capitalize()) for state in STATES],
        "method_key": [
            (charts.color_of(method, index), study.method_title(method)) for index, method in enumerate(study.methods)
        ],
        "times": contents.times(),
        "time_tests": contents.time_tests(),
        "time_bars": figures.time_bars(study),
        "accuracy": contents.accuracy(),
        "accuracy_tests": contents.accuracy_tests(),
        "accuracy_boxes": figures.boxes(study),
        "map_rows": figures.map_rows(study, pictures),
        "map_notes": notes,
        "map_key": {
            name: "#{:02x}{:02x}{:02x}".format(*color)
            for name, color in (
                ("truth", maps.TRUTH),
                ("agreement", maps.AGREEMENT),
                ("excess", maps.EXCESS),
                ("union", maps.UNION),
            )
        },
        "completeness": contents.completeness(),
        "completeness_figure": figures.rates(study, ledger),
        "beside": beside,
        "differences": explanations.differences(study, contents) if beside and not people else [],
        "sweeps": [figures.sweep(study, name, found) for name, found in curves.items()],
        "nominal": nominal,
        "settings": settings,
        "sensitivity_where": ", ".join(row["scenario"] for row in nominal.by_scenario) if nominal else "",
        "tornado_rows": figures.TORNADO_ROWS,
        "sensitivity_participants": (
            len(study.tables[SENSITIVITY].distinct("participant")) if SENSITIVITY in study.tables else 0
        ),
        "standing": _standing(nominal, settings),
        "tolerated_loss": f"{findings.TOLERATED_LOSS:.3f}".lstrip("0"),
        "agreement": _agreement(study),
        "further": contents.further(),
        "rerun": study.meta.get("rerun", ""),
        "reruns": [
            (file, study.meta[key])
            for key, file in (("rerun", RUNS), ("rerun_curves", CURVES), ("rerun_sensitivity", SENSITIVITY))
            if study.meta.get(key)
        ],
        "run_columns": [column for column in study.runs.columns],
        "all_runs": [
            {"line": line, "cells": [row[column] for column in study.runs.columns], "command": rerun(study, row)}
            for row, line in zip(study.runs.rows, study.runs.lines)
        ],
    }
    if settings and nominal is not None:
        values.update(figures.tornados(study, nominal, settings))
    values["sections"] = [
        (key, title)
        for key, title, shown in (
            ("findings", "Findings", values["verdicts"]),
            ("time", "Interaction time", True),
            ("accuracy", "Accuracy", True),
            ("completeness", "Completeness", True),
            ("paper", "Beside the paper", beside),
            ("curves", "Curves", values["sweeps"]),
            ("sensitivity", "Sensitivity", settings),
            ("agreement", "Through ROS", values["agreement"]),
            ("further", "Further measures", values["further"]),
            ("trace", "Every run, every number", True),
        )
        if shown
    ]
    values["numbers"] = [_origin(entry) for entry in ledger.numbers]
    return values


def _origin(entry: Number) -> Dict[str, str]:
    """A number's line in numbers.csv and at the end of the page."""
    return {
        "id": entry.id,
        "text": entry.text,
        "value": repr(entry.value),
        "statistic": entry.statistic,
        "meaning": (TWO if entry.versus else ONE)[entry.statistic][0],
        "column": entry.column,
        "methods": entry.versus,
        "file": entry.file,
        "where": entry.where,
        "lines": entry.lines,
    }


def rerun(study: Study, row: Row) -> str:
    """The command that makes a row again, alone; "" if the study does not say how."""
    pattern = study.meta.get("rerun", "")
    try:
        return str(pattern).format(**row)
    except (KeyError, IndexError, ValueError) as error:
        raise CodedError(
            "bad_study", f"study.json: rerun: {pattern!r} does not fit the columns of {RUNS}: {error}"
        ) from None


# ------------------------------------------------------------------ words and tables
def _facts(study: Study) -> List[str]:
    named = (("world", "world {}"), ("seed", "seed {}"), ("software", "software {}"), ("created", "{}"))
    return [words.format(study.meta[key]) for key, words in named if study.meta.get(key) not in (None, "")]


def _missing(study: Study) -> List[str]:
    """Runs that a complete study would have, in words."""
    by_task: Dict[str, List[str]] = {}
    for participant, scenario, method in study.missing:
        words = f"{study.scenario_title(scenario)}, {study.method_title(method).lower()}"
        by_task.setdefault(words, []).append(participant)
    return [f"{words}: participant {', '.join(found)}" for words, found in by_task.items()]


def _standing(nominal: Optional[sweeps.Setting], settings: Sequence[sweeps.Setting]) -> List[Any]:
    """Which conclusions stand with which settings."""
    if nominal is None or not settings:
        return []
    words: List[Any] = [
        f"{len({setting.parameter for setting in settings})} assumed parameters were changed, one at a time "
        f"({len(settings)} settings), in {', '.join(row['scenario'] for row in nominal.by_scenario)}. "
        "These conclusions stand:"
    ]
    for flag, claim in (
        ("faster", "faster"),
        ("no_loss", "no loss of accuracy"),
        ("complete", "as complete"),
    ):
        fallen = [
            f"{setting.parameter} × {float(setting.factor):g}" for setting in settings if not getattr(setting, flag)
        ]
        words.append(f" {claim} with {len(settings) - len(fallen)} of {len(settings)}")
        if fallen:
            words.append(
                f" (not with {', '.join(fallen)}{'' if getattr(nominal, flag) else ', nor with nothing changed'})"
            )
        words.append(";" if flag != "complete" else ".")
    return words


def _agreement(study: Study) -> Optional[Dict[str, Any]]:
    table = study.tables.get(AGREEMENT)
    if table is None or not table.rows:
        return None
    further = [column for column in ("outcome", "real_time_factor") if column in table.columns]
    measures = [column for column in REQUIRED if column not in ("participant", "scenario", "method", "seed")] + further
    ordered = sorted(
        table.rows, key=lambda row: [row[column] for column in ("scenario", "method", "participant", "runner")]
    )
    return {
        "columns": ["runner", *measures],
        "rows": [
            {
                "name": f"{row['participant']}, {study.scenario_title(row['scenario'])}, "
                f"{study.method_title(row['method']).lower()}",
                "cells": [row["runner"], *(row[column] for column in measures)],
            }
            for row in ordered
        ],
    }


def _write_tables(folder: Path, values: Mapping[str, Any]) -> None:
    """Each table of the page as CSV; a number as the page writes it."""
    tables = folder / TABLES
    tables.mkdir(exist_ok=True)
    for old in tables.glob("*.csv"):
        old.unlink()
    found: Dict[str, List[Dict[str, Any]]] = {
        name: list(values[name])
        for name in ("times", "time_tests", "accuracy", "accuracy_tests", "completeness", "further")
    }
    found["beside_the_paper"] = [
        {
            "scenario": row.scenario,
            "quantity": row.quantity,
            "paper": row.paper,
            "here": "".join(map(str, row.ours)),
            "verdict": row.verdict,
        }
        for row in values["beside"]
    ]
    found["curves"] = [
        {
            "sweep": sweep["name"],
            "scenario": curve["name"],
            "value": point.value,
            "speedup": point.speedup,
            "speedup_low": point.speedup_low,
            "speedup_high": point.speedup_high,
            **{f"time_{method}": entry for method, entry in point.times.items()},
            **{f"jaccard_{method}": entry for method, entry in point.jaccard.items()},
            **{f"completed_{method}": entry for method, entry in point.completeness.items()},
        }
        for sweep in values["sweeps"]
        for curve in sweep["curves"]
        for point in curve["points"]
    ]
    settings = [setting for setting in [values["nominal"], *values["settings"]] if setting is not None]
    found["sensitivity"] = [
        {
            "parameter": setting.parameter,
            "factor": setting.factor,
            "value": setting.value,
            "scenario": row["scenario"],
            "speedup": row["speedup"],
            "speedup_low": row["speedup_low"],
            "jaccard": row["jaccard"],
            "jaccard_difference": row["loss"],
            "completed": row["completeness"],
            "faster": int(setting.faster),
            "no_loss": int(setting.no_loss),
            "complete": int(setting.complete),
        }
        for setting in settings
        for row in setting.by_scenario
    ]
    for name, rows in found.items():
        if rows:
            write_table(
                tables / f"{name}.csv",
                list(rows[0]),
                [{key: _plain(value) for key, value in row.items()} for row in rows],
            )


def _plain(value: Any) -> Any:
    if isinstance(value, Number):
        return repr(value.value) if value.known else ""
    return value
