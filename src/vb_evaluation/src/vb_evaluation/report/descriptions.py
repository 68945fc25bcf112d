"""Computes the tables of what each method reached. Each declares of which measure, and how, its columns' cells are made."""

from __future__ import annotations

from typing import Any, Callable, Dict, List, Mapping, Tuple, Union

from pandas import Series

from vb_evaluation import statistics
from vb_evaluation.report.study_files import STATES, StudyResults, select
from vb_evaluation.statistics import Interval, format_number

# by heading: the measure, and what makes a cell of its known values (N,)
Columns = Mapping[str, Tuple[str, Callable[[Series], str]]]
FAILURE_COLUMNS = "participant scenario method outcome reason pointed_right seed_is_right note".split()


def cell_writer(statistic: Callable[[Series], Union[Interval, float]], digits: int = 0) -> Callable[[Series], str]:
    """Returns a function that computes a statistic and writes it with so many digits."""

    def write(values: Series) -> str:
        value = statistic(values)
        return value.text(digits) if isinstance(value, Interval) else format_number(value, digits)

    return write


ERROR_COLUMNS: Columns = {
    "mean [cm]": ("error_mean_cm", cell_writer(statistics.median, 1)),
    "95 % of the boundary within [cm]": ("error_p95_cm", cell_writer(statistics.median, 1)),
    "largest [cm]": ("error_max_cm", cell_writer(statistics.median, 1)),
    "worst run's largest [cm]": ("error_max_cm", cell_writer(Series.max, 1)),
    "Runs": ("error_max_cm", cell_writer(len)),
}
TIME_COLUMNS: Columns = {
    **{f"{state.capitalize()} [s]": (f"time_{state}_s", cell_writer(Series.mean, 1)) for state in STATES},
    "Total, mean [s]": ("time_total_s", cell_writer(statistics.mean, 1)),
    "Runs": ("time_total_s", cell_writer(len)),
}
ACCURACY_COLUMNS: Columns = {
    "Median": ("jaccard", cell_writer(statistics.median, 3)),
    "Smallest": ("jaccard", cell_writer(Series.min, 3)),
    "Runs": ("jaccard", cell_writer(len)),
}
COMPLETENESS_COLUMNS: Columns = {
    "Completed": ("completed", lambda flags: f"{flags.sum():.0f} of {len(flags)}"),
    "Share [%]": ("completed", cell_writer(statistics.percentage)),
}
HELP_COLUMNS: Columns = {
    "With help": ("helped", lambda counts: str((counts > 0).sum())),
    "With a problem of the system": ("problems", lambda counts: str((counts > 0).sum())),
}


def describe(study: StudyResults, columns: Columns, **where: object) -> List[Dict[str, Any]]:
    """Computes a row for each scenario and method, from the runs with these values."""
    rows = []
    for scenario, title in study.scenarios.items():
        for method, method_title in study.methods.items():
            runs = select(study.runs, scenario=scenario, method=method, **where)
            cells = {heading: write(runs[measure].dropna()) for heading, (measure, write) in columns.items()}
            rows.append({"Scenario": title, "Method": method_title, **cells})
    return rows


def describe_completeness(study: StudyResults) -> List[Dict[str, Any]]:
    """Computes success rates, and counts the outcomes, with the help and problems that the experimenter noted."""
    names = study.runs.outcome.unique() if "outcome" in study.runs else ()
    counts = {f"Outcome {name}": ("outcome", lambda given, name=name: str((given == name).sum())) for name in names}
    return describe(study, {**COMPLETENESS_COLUMNS, **counts, **(HELP_COLUMNS if study.has_people else {})})


def list_failures(study: StudyResults) -> List[Dict[str, Any]]:
    """Lists the runs that were not completed, or count for nothing, with what explains them."""
    failed = study.runs[study.runs.completed != 1]
    titled = failed.assign(scenario=failed.scenario.map(study.scenarios), method=failed.method.map(study.methods))
    is_known = titled.notna() & (titled != "")
    known = titled[[name for name in FAILURE_COLUMNS if name in titled and is_known[name].any()]]
    return known.rename(columns=lambda name: name.replace("_", " ").capitalize()).to_dict("records")
