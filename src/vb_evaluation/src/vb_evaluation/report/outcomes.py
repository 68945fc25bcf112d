"""Writes the sections on what was measured: effects, boundary error, time, Jaccard index, completeness."""

from __future__ import annotations

import math
from typing import Any, Dict, List, NamedTuple

import pandas

from vb_evaluation import statistics
from vb_evaluation.report import effect_sizes, map_figures, paper_results
from vb_evaluation.report.blocks import Block, Figure, Table, column_headings
from vb_evaluation.report.study_files import ERRORS, STATES, StudyResults, known_values, pairs

ERROR_TITLES = dict(zip(ERRORS, ("mean", "95 % of the boundary within", "largest")))


class NoninferiorityMargin(NamedTuple):
    """How much worse than the baseline a method may be in a measure. `sign` is 1 if larger values are better, else -1."""

    title: str
    margin: float
    sign: float
    digits: int


# one cell of the map is 2.5 cm; .05 is about twice the .028 that the paper calls not notable in practice
MARGINS = {
    "jaccard": NoninferiorityMargin("Jaccard index", 0.05, sign=1.0, digits=3),
    "error_mean_cm": NoninferiorityMargin("mean boundary error [cm]", 2.5, sign=-1.0, digits=1),
}
COMPLETENESS_MARGIN = 10  # [percentage points]
_EXPLANATIONS = ("outcome", "reason", "pointed_right", "seed_is_right", "note")


def summary_section(study: StudyResults) -> List[Block]:
    """Reports the method's effects with their intervals. With people, also without runs that had help or a problem."""
    if len(study.methods) < 2:
        return []
    names = [paper_results.method_title(method).lower() for method in study.comparison]
    explanation = (
        f"Differences are {names[0]} minus {names[1]}, paired by participant: Hodges-Lehmann estimate and 95 % interval "
        "(accuracy: who completed both). Speed-up: ratio of the mean times, bootstrap interval. Completed: of all runs, "
        "Newcombe's interval. [?]: too few pairs."
    )
    blocks = [_summary("summary", study, study.runs, explanation), *noninferiority_blocks(study)]
    unaided = study.runs[~((study.runs.helped > 0) | (study.runs.problems > 0))]
    if len(unaided) < len(study.runs):
        left_out = len(study.runs) - len(unaided)
        explanation = f"The same without the {left_out} runs with help or a problem of the system."
        blocks.append(_summary("summary_without_help", study, unaided, explanation))
    return blocks


def _summary(name: str, study: StudyResults, runs: pandas.DataFrame, explanation: str) -> Table:
    """Makes the table of the effects of a study's method on some of its runs, a row for each scenario."""
    methods = study.comparison
    rows = [
        {
            "scenario": title,
            "pairs": len(pairs(table, "time_total_s", methods)[0]),
            "accuracy_pairs": len(pairs(table, "error_mean_cm", methods, True)[0]),
            "error": effect_sizes.paired_shift(table, "error_mean_cm", methods, True),
            "time": effect_sizes.paired_shift(table, "time_total_s", methods),
            "speedup": effect_sizes.ratio(table, methods),
            "jaccard": effect_sizes.paired_shift(table, "jaccard", methods, True),
            "completed": effect_sizes.completed_more(table, methods),
        }
        for title, table in study.by_scenario(runs)
    ]
    with_units = {"error": "Mean boundary error [cm]", "time": "Time [s]", "completed": "Completed [points]"}
    heads = column_headings(*rows[0], accuracy_pairs="Pairs, accuracy", jaccard="Jaccard index", **with_units)
    return Table(name, heads, rows, {"error": 1, "time": 1, "jaccard": 3, "completed": 0}, explanation=explanation)


def noninferiority_blocks(study: StudyResults) -> List[Block]:
    """Reports whether the method is worse than the baseline by a margin or more (the paper's hypotheses 3 and 4)."""
    rows: List[Dict[str, Any]] = []
    for title, runs in study.by_scenario():
        for column, (measure, margin, sign, digits) in MARGINS.items():
            first, second = pairs(runs, column, study.comparison, True)
            gain = effect_sizes.paired_shift(runs, column, study.comparison, True, 0.9).scaled(sign)
            reading = _compare_with_margin(gain, margin, digits)
            p = statistics.noninferiority_p(sign * (first - second), margin)
            rows.append({"scenario": title, "measure": measure, **reading, "n": len(first), "p_value": p})
    completed = effect_sizes.completed_more(study.runs, study.comparison, 0.9)
    reading = _compare_with_margin(completed, COMPLETENESS_MARGIN, 0)
    rows.append({"scenario": "all", "measure": "completed [points]", **reading, "n": ""})
    keys = ["scenario", "measure", "gain", "margin", "reading", "equivalent", "n"]
    explanation = (
        "Gains: positive is better. Not worse: the 90 % interval lies above minus the margin, which is a one-sided test at "
        "5 %; equivalent: within both margins (two one-sided tests). Accuracy: who completed both."
    )
    if study.has_people:
        keys.append("holm")
        explanation += " Completed: a person's runs count as independent."
        for margin in MARGINS.values():
            effect_sizes.add_holm([row for row in rows if row["measure"] == margin.title])
    return [Table("not_worse", column_headings(*keys, gain="Gain [90 %]"), rows, explanation=explanation)]


def _compare_with_margin(gain: statistics.Interval, margin: float, digits: int) -> Dict[str, str]:
    """Compares the 90 % interval of a gain with a margin."""
    is_not_worse = gain.low > -margin
    reading = "worse" if gain.high < -margin else "open"
    return {
        "gain": gain.text(digits),
        "margin": f"{margin:g}",
        "reading": "not worse" if is_not_worse else reading,
        "equivalent": "yes" if is_not_worse and gain.high < margin else "no",
    }


def error_section(study: StudyResults) -> List[Block]:
    """Reports the boundary error in centimetres."""

    def measure(runs: pandas.DataFrame, *_: float) -> Dict[str, Any]:
        worst = known_values(runs, "error_max_cm")
        medians = {column: statistics.median(known_values(runs, column)) for column in ERRORS}
        return {**medians, "worst": float(worst.max()) if len(worst) else math.nan, "runs": len(worst)}

    rows = study.rows(measure, completed=1)
    if not any(row["runs"] for row in rows):
        return []
    errors = {key: f"{ERROR_TITLES[key]} [cm]" for key in ERRORS}
    heads = column_headings("scenario", "method", *ERRORS, "worst", "runs", **errors, worst="worst run's largest [cm]")
    introduction = (
        "How far the boundary that the robot respects lies from the one that was asked for, both ways, over completed runs. "
        "Of each run the mean, the 95th percentile and the largest distance along the boundary; in the table their medians "
        "over runs with bootstrap intervals."
    )
    table = Table("error", heads, rows, {key: 1 for key in (*ERRORS, "worst")})
    return [introduction, table, *effect_sizes.wilcoxon_blocks(study, "error_mean_cm", "cm", True)]


def time_section(study: StudyResults) -> List[Block]:
    """Reports interaction time by state."""

    def measure(runs: pandas.DataFrame, *_: float) -> Dict[str, Any]:
        states = {state: float(runs[f"time_{state}_s"].mean()) for state in STATES}
        totals = known_values(runs, "time_total_s")
        return {**states, "total": statistics.mean(totals), "runs": len(totals)}

    states = {state: f"{state.capitalize()} [s]" for state in STATES}
    heads = column_headings("scenario", "method", *STATES, "total", "runs", **states, total="Total, mean [s]")
    introduction = (
        "From leaving the state Default to the border in the map, in the states Guide, Border and Seed, "
        "attempts that were cancelled included (paper, Sect. 5.5)."
    )
    table = Table("time", heads, study.rows(measure), {key: 1 for key in (*STATES, "total")})
    return [introduction, table, *effect_sizes.wilcoxon_blocks(study, "time_total_s", "s", False)]


def accuracy_section(study: StudyResults) -> List[Block]:
    """Reports the paper's Jaccard index, with representative maps."""

    def measure(runs: pandas.DataFrame, published: float, _: float) -> Dict[str, Any]:
        done = known_values(runs, "jaccard")
        least = float(done.min()) if len(done) else math.nan
        return {"median": statistics.median(done), "least": least, "paper": published, "runs": len(done)}

    images, notes = map_figures.representatives(study)
    heads = column_headings("scenario", "method", "median", "least", "paper", "runs", least="Smallest")
    blocks: List[Block] = [
        "Restricted cells against those that were asked for, over completed runs.",
        Table("accuracy", heads, study.rows(measure, completed=1), {"median": 3, "least": 3, "paper": 3}),
        *effect_sizes.wilcoxon_blocks(study, "jaccard", "", True),
    ]
    if images:
        caption = (
            "Representative maps: the ground truth (yellow), and by method the run nearest to the median: agreement "
            "(green), restricted beyond the ground truth (red), union (blue outline)."
        )
        blocks += [caption, Figure(images)]
    return [*blocks, *notes]


def completeness_section(study: StudyResults) -> List[Block]:
    """Reports success rates."""

    def measure(runs: pandas.DataFrame, _: float, published: float) -> Dict[str, Any]:
        completed = known_values(runs, "completed")
        share = statistics.proportion(int(completed.sum()), len(completed)).scaled(100.0)
        return {"completed": f"{int(completed.sum())} of {len(completed)}", "share": share, "paper": 100 * published}

    heads = column_headings("scenario", "method", "completed", "share", "paper", share="Share [%]", paper="Paper [%]")
    introduction = "Runs that ended with a saved border and a seed on the side that was asked for"
    if study.has_people:
        introduction += ", and that nobody who judged them said otherwise of"
    introduction += "; Wilson's 95 % intervals."
    table = Table("completeness", heads, study.rows(measure), {"share": 0, "paper": 1})
    return [introduction, table, *_count_who_completed(study), *_count_outcomes(study)]


def _count_who_completed(study: StudyResults) -> List[Block]:
    """Counts, for each scenario, who completed it with which method."""
    if len(study.methods) < 2:
        return []
    rows: List[Dict[str, Any]] = []
    for title, runs in study.by_scenario():
        counts = statistics.compare_completed(*pairs(runs, "completed", study.comparison))
        rows.append({"scenario": title, **counts, "p": statistics.format_p(counts["p"]), "p_value": counts["p"]})
    first, second = (f"Only {paper_results.method_title(method).lower()}" for method in study.comparison)
    keys = ["scenario", "both", "first", "second", "neither"]
    if study.has_people:
        effect_sizes.add_holm(rows)
        keys += ["p", "holm"]
    titles = {"first": first, "second": second, "both": "With both", "neither": "With neither"}
    return [Table("who_completed", column_headings(*keys, **titles, p="p (McNemar, exact)"), rows)]


def _count_outcomes(study: StudyResults) -> List[Block]:
    """Counts the outcomes, and the help and problems that the experimenter noted. Lists the runs not completed."""
    if "outcome" not in study.runs:
        return []
    outcomes = list(dict.fromkeys(study.runs.outcome))

    def measure(runs: pandas.DataFrame, *_: float) -> Dict[str, Any]:
        counts = {name: int((runs.outcome == name).sum()) for name in outcomes}
        return {**counts, **{name: int((runs[name] > 0).sum()) for name in ("helped", "problems")}}

    keys = ["scenario", "method", *outcomes]
    if study.has_people:
        keys += ["helped", "problems"]
    heads = column_headings(*keys, helped="With help", problems="With a problem of the system")
    failed = study.runs[study.runs.completed == 0]
    explanations = [name for name in _EXPLANATIONS if name in failed and failed[name].notna().any()]
    failures = [
        {
            "participant": row["participant"],
            **study.titles(row["scenario"], row["method"]),
            **{name: row[name] if isinstance(row[name], str) else f"{row[name]:g}" for name in explanations},
        }
        for row in failed.to_dict("records")
    ]
    heads_of_failures = column_headings("participant", "scenario", "method", *explanations, participant="Person")
    return [Table("outcomes", heads, study.rows(measure)), Table("not_completed", heads_of_failures, failures)]
