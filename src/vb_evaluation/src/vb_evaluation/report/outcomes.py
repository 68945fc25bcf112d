"""Makes the tables of what was measured: effects, boundary error, time, Jaccard index, completeness."""

from __future__ import annotations

import math
from typing import Any, Dict, List, NamedTuple

import pandas

from vb_evaluation import statistics
from vb_evaluation.report import effect_sizes, paper_results
from vb_evaluation.report.study_files import ERRORS, STATES, StudyResults, select
from vb_evaluation.report.table import Table


class Measure(NamedTuple):
    """A measure by which methods are compared.

    Attributes:
        sign: 1 if larger values are better, else -1.
        margin: how much worse than the baseline a method may be; nan where no such question is asked.
    """

    title: str
    digits: int
    sign: float
    margin: float


# one cell of the map is 2.5 cm; .05 is about twice the .028 that the paper calls not notable in practice
COMPARED = {
    "error_mean_cm": Measure("Mean boundary error [cm]", 1, sign=-1.0, margin=2.5),
    "time_total_s": Measure("Time [s]", 1, sign=-1.0, margin=math.nan),
    "jaccard": Measure("Jaccard index", 3, sign=1.0, margin=0.05),
}
COMPLETED = Measure("Completed [points]", 0, sign=1.0, margin=10.0)
EFFECT_DIGITS = {measure.title: measure.digits for measure in (*COMPARED.values(), COMPLETED)}


def summary_table(study: StudyResults) -> Table:
    """Reports the method's effects with their intervals."""
    method, baseline = (paper_results.method_title(key) for key in study.comparison)
    text = (
        f"Differences are {method.lower()} minus {baseline.lower()}, paired by participant: Hodges-Lehmann estimate and 95 % "
        "interval (accuracy: who completed both). Speed-up: ratio of the mean times, bootstrap interval. Completed: of all "
        "runs, Newcombe's interval. [?]: too few pairs."
    )
    return Table("summary", f"{method} against {baseline.lower()}", text, _effects(study, study.runs), EFFECT_DIGITS)


def summary_without_help_table(study: StudyResults) -> Table:
    """Reports the effects without the runs that had help or a problem, if there are any."""
    is_aided = (study.runs.helped > 0) | (study.runs.problems > 0)
    text = f"The same without the {is_aided.sum()} runs with help or a problem of the system."
    rows = _effects(study, study.runs[~is_aided]) if is_aided.any() else []
    return Table("summary_without_help", "Without help", text, rows, EFFECT_DIGITS)


def _effects(study: StudyResults, runs: pandas.DataFrame) -> List[Dict[str, Any]]:
    """Computes the effects of a study's method on some of its runs, a row for each scenario."""
    differences = {column: study.differences(runs, column) for column in COMPARED}
    rows = []
    for scenario in study.scenarios:
        scenario_runs = select(runs, scenario=scenario)
        row: Dict[str, Any] = {"Scenario": study.scenario_title(scenario)}
        row["Pairs"] = len(differences["time_total_s"][scenario])
        row["Pairs, accuracy"] = len(differences["error_mean_cm"][scenario])
        for column, measure in COMPARED.items():
            row[measure.title] = statistics.hodges_lehmann(differences[column][scenario])
        row["Speed-up"] = effect_sizes.speed_up(scenario_runs, study.comparison)
        row[COMPLETED.title] = effect_sizes.completion_difference(scenario_runs, study.comparison)
        rows.append(row)
    return rows


def noninferiority_table(study: StudyResults) -> Table:
    """Reports whether the method is worse than the baseline by a margin or more (the paper's hypotheses 3 and 4)."""
    rows: List[Dict[str, Any]] = []
    for column in ("jaccard", "error_mean_cm"):
        measure = COMPARED[column]
        gains = {key: measure.sign * values for key, values in study.differences(study.runs, column).items()}
        corrected = statistics.holm([statistics.noninferiority_p(gain, measure.margin) for gain in gains.values()])
        for (scenario, gain), p in zip(gains.items(), corrected):
            reading = _compare_with_margin(statistics.hodges_lehmann(gain, 0.9), measure)
            test = {"p (Holm)": statistics.format_p(p)} if study.has_people else {}
            rows.append({"Scenario": study.scenario_title(scenario), **reading, "Pairs": len(gain), **test})
    completed = effect_sizes.completion_difference(study.runs, study.comparison, 0.9)
    rows.append({"Scenario": "all", **_compare_with_margin(completed, COMPLETED)})
    text = (
        "Gains: positive is better. Not worse: the 90 % interval lies above minus the margin, which is a one-sided test at "
        "5 %; equivalent: within both margins (two one-sided tests). Accuracy: who completed both."
    )
    if study.has_people:
        text += " Completed: a person's runs count as independent."
    return Table("not_worse", "Not worse by a margin", text, rows)


def _compare_with_margin(gain: statistics.Interval, measure: Measure) -> Dict[str, str]:
    """Compares the 90 % interval of a gain with its measure's margin."""
    is_not_worse = gain.low > -measure.margin
    reading = "worse" if gain.high < -measure.margin else "open"
    return {
        "Measure": measure.title,
        "Gain [90 %]": gain.text(measure.digits),
        "Margin": f"{measure.margin:g}",
        "Reading": "not worse" if is_not_worse else reading,
        "Equivalent": "yes" if is_not_worse and gain.high < measure.margin else "no",
    }


def tests_table(study: StudyResults) -> Table:
    """Reports the paper's Wilcoxon tests, for studies with people only."""
    rows: List[Dict[str, Any]] = []
    measures = COMPARED if study.has_people else {}
    for column, measure in measures.items():
        tests = effect_sizes.wilcoxon_rows(study.differences(study.runs, column))
        for scenario, test in tests.items():
            rows.append({"Measure": measure.title, "Scenario": study.scenario_title(scenario), **test})
    text = (
        "Wilcoxon signed-rank test: Z as SPSS gives it (zero differences left out, ties corrected, no continuity "
        "correction), exact p over all signs, r = |Z| / √(2 × pairs), Hodges-Lehmann difference and 95 % "
        "interval ([?]: too few pairs). Accuracy: who completed both. Holm: corrected over a measure's scenarios."
    )
    return Table("tests", "Tests", text, rows, {"Z": 3, "Difference": 3})


def error_table(study: StudyResults) -> Table:
    """Reports the boundary error in centimetres."""
    headings = dict(zip(ERRORS, ("mean [cm]", "95 % of the boundary within [cm]", "largest [cm]")))
    rows = []
    for scenario, method, runs in study.by_method(completed=1):
        row = study.titles(scenario, method)
        for column, heading in headings.items():
            row[heading] = statistics.median(runs[column].dropna())
        row["worst run's largest [cm]"] = runs.error_max_cm.max()
        row["Runs"] = runs.error_max_cm.count()
        rows.append(row)
    text = (
        "How far the boundary that the robot respects lies from the one that was asked for, both ways, over completed runs. "
        "Of each run the mean, the 95th percentile and the largest distance along the boundary; in the table their medians "
        "over runs with bootstrap intervals."
    )
    digits = dict.fromkeys(rows[0], 1)
    return Table("error", "Boundary error", text, rows if any(row["Runs"] for row in rows) else [], digits)


def time_table(study: StudyResults) -> Table:
    """Reports interaction time by state."""
    rows = []
    for scenario, method, runs in study.by_method():
        row = study.titles(scenario, method)
        for state in STATES:
            row[f"{state.capitalize()} [s]"] = runs[f"time_{state}_s"].mean()
        totals = runs.time_total_s.dropna()
        row["Total, mean [s]"] = statistics.mean(totals)
        row["Runs"] = len(totals)
        rows.append(row)
    text = (
        "From leaving the state Default to the border in the map, in the states Guide, Border and Seed, "
        "attempts that were cancelled included (paper, Sect. 5.5)."
    )
    return Table("time", "Interaction time", text, rows, dict.fromkeys(rows[0], 1))


def accuracy_table(study: StudyResults) -> Table:
    """Reports the paper's Jaccard index."""
    rows = []
    for scenario, method, runs in study.by_method(completed=1):
        indices = runs.jaccard.dropna()
        row = study.titles(scenario, method)
        row["Median"] = statistics.median(indices)
        row["Smallest"] = indices.min()
        row["Paper"], _ = paper_results.paper_figures(scenario, method)
        row["Runs"] = len(indices)
        rows.append(row)
    text = "Restricted cells against those that were asked for, over completed runs."
    return Table("accuracy", "Jaccard index", text, rows, dict.fromkeys(rows[0], 3))


def completeness_table(study: StudyResults) -> Table:
    """Reports success rates, and counts the outcomes, with the help and problems that the experimenter noted."""
    outcomes = study.runs.outcome.unique() if "outcome" in study.runs else ()
    rows = []
    for scenario, method, runs in study.by_method():
        flags = runs.completed.dropna()
        _, published = paper_results.paper_figures(scenario, method)
        row = study.titles(scenario, method)
        row["Completed"] = f"{int(flags.sum())} of {len(flags)}"
        row["Share [%]"] = statistics.percentage(flags)
        row["Paper [%]"] = 100 * published
        for outcome in outcomes:
            row[f"Outcome {outcome}"] = (runs.outcome == outcome).sum()
        if study.has_people:
            row["With help"] = (runs.helped > 0).sum()
            row["With a problem of the system"] = (runs.problems > 0).sum()
        rows.append(row)
    text = "Runs that ended with a saved border and a seed on the side that was asked for"
    if study.has_people:
        text += ", and that nobody who judged them said otherwise of"
    text += "; Wilson's 95 % intervals."
    return Table("completeness", "Completed", text, rows, {"Share [%]": 0, "Paper [%]": 1})


def not_completed_table(study: StudyResults) -> Table:
    """Lists the runs that were not completed, with what explains them."""
    failed = study.runs[study.runs.completed == 0].dropna(axis="columns", how="all")
    explanations = [name for name in ("outcome", "reason", "pointed_right", "seed_is_right", "note") if name in failed]
    rows = []
    for run in failed.to_dict("records"):
        row = {"Person": run["participant"], **study.titles(run["scenario"], run["method"])}
        for name in explanations:
            text = run[name] if isinstance(run[name], str) else f"{run[name]:g}"
            row[name.replace("_", " ").capitalize()] = text
        rows.append(row)
    return Table("not_completed", "Every run that was not completed", "", rows if "outcome" in study.runs else [])
