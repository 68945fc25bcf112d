"""Writes the sections on what is behind the figures: order, people, assumptions, every run."""
from __future__ import annotations

import math
from typing import Any, Dict, List, Tuple

import numpy as np

from vb_evaluation import statistics
from vb_evaluation.report import questionnaire
from vb_evaluation.report import effects
from vb_evaluation.report.blocks import Grid, Section, Text, interval_text
from vb_evaluation.report.data import Study, number, read_table



def order(study: Study) -> Section:
    """Whether it matters which method came first (a two-period crossover), and whether people learn."""
    if "order" not in study.runs.columns or len(study.methods) != 2:
        return Section("order", "Order", [])
    rows = []
    for column, words, digits in (("time_total_s", "time [s]", 1), ("error_mean_cm", "mean boundary error [cm]", 2)):
        groups = _by_first(study, column)
        sizes = [len(group) for group in groups.values()]
        if len(groups) != 2 or min(sizes) < 2:
            continue
        first, second = (np.array(group) for group in groups.values())
        # Hills & Armitage 1979: halves of the difference tell the period, sums what is carried over
        for effect, a, b in (("period: second minus first", (second[:, 0] - second[:, 1]) / 2, (first[:, 0] - first[:, 1]) / 2),
                             ("carry-over", first.sum(axis=1), second.sum(axis=1))):
            found = statistics.unpaired(a, b)
            rows.append({"measure": words, "effect": effect, "difference": interval_text(found.shift, digits),
                         "p": statistics.format_p(found.p) if study.people else "", "groups": f"{sizes[0]} + {sizes[1]}"})
    if not rows:
        return Section("order", "Order", [])
    words = ("Half of the people began with one method, half with the other. Differences between the two groups, Hodges-Lehmann with "
             "95 % interval, means over each person's scenarios. The test of carry-over is weak: none shown is not none there.")
    if not study.people:
        words += " Simulated people neither learn nor tire: an interval without 0 would be chance or a fault."
    columns = {"measure": "Measure", "effect": "Effect", "difference": "Difference", "groups": "People"}
    return Section("order", "Order", [Text((words,), "caveat"),
                                      Grid("order", {**columns, "p": "p (Mann-Whitney)"} if study.people else columns, rows)])


def _by_first(study: Study, column: str) -> Dict[str, List[Tuple[float, float]]]:
    """(mean with the first method, mean with the baseline) of each person, by the method that came first."""
    groups: Dict[str, List[Tuple[float, float]]] = {method: [] for method in study.comparison}
    for person in study.runs.distinct("participant"):
        own = study.runs.select(participant=person)
        known = [row for row in own.rows if math.isfinite(number(row, "order"))]
        means = tuple(effects.mean(own.select(method=method).numbers(column)) for method in study.comparison)
        if known and all(len(own.select(method=method).numbers(column)) for method in study.comparison):
            groups[min(known, key=lambda row: number(row, "order"))["method"]].append(means)  # type: ignore[arg-type]
    return {method: group for method, group in groups.items() if group}


def experience(study: Study) -> Section:
    """Who took part and what they answered; empty for simulated people."""
    path, about = study.folder / "questionnaire.csv", study.folder / "demographics.csv"
    blocks: List[Any] = []
    if study.people and about.is_file():
        table = read_table(about, ("participant",))
        counted = [{"question": column, "answers": "; ".join(
            f"{value}: {len(table.select(**{column: value}).rows)}" for value in sorted(table.distinct(column)))}
            for column in table.columns if column != "participant"]
        blocks.append(Grid("demographics", {"question": "Question", "answers": f"Answers of {len(table.rows)} people"}, counted))
    if not study.people or not path.is_file():
        return Section("experience", "People and their experience", blocks)
    found, rows = questionnaire.read(path), []
    for answers in found.answers:
        compared = answers.comparison
        rows.append({"statement": answers.statement, "nrs": effects.mean(answers.first), "robot_only": effects.mean(answers.second),
                     "shift": compared.shift, "z": compared.test.z, "p": statistics.format_p(compared.test.p_exact),
                     "r": compared.r, "n": compared.n})
    columns = {"statement": "Statement", "nrs": "Network robot system", "robot_only": "Robot only", "shift": "Difference",
               "z": "Z", "p": "exact p", "r": "r", "n": "People"}
    return Section("experience", "People and their experience", [
        *blocks, Text(("The paper's five statements (1 to 5, 5 is the good end) and the UEQ-S (−3 to 3): means, Hodges-Lehmann difference, "
                       "Wilcoxon signed-rank test.",)), Grid("questionnaire", columns, rows, {"z": 3}),
        Text((f"{questionnaire.QUESTION} Yes: {found.helped} of {found.asked}.",))])


def assumptions(study: Study) -> Section:
    """Everything that was put in, with where it comes from."""
    entries = study.meta.get("assumptions") or []
    blocks: List[Any] = []
    if study.meta.get("caveats"):
        blocks.append(Text(tuple(study.meta["caveats"]), "list"))
    if entries:
        counts = {source: sum(entry["source"] == source for entry in entries) for source in ("paper", "data", "literature", "assumed")}
        blocks += [Text((f"{len(entries)} figures: " + ", ".join(f"{count} {source}" for source, count in counts.items()) + ".",)),
                   Grid("assumptions", {"key": "Figure", "value": "Value", "unit": "Unit", "range": "Plausible range",
                                        "source": "Source", "why": "Where from"}, entries, folded=True, words="Every figure")]
    return Section("assumptions", "What was assumed, and where the simulation is too kind", blocks)


def runs(study: Study) -> Section:
    """Every row."""
    rows = [{**row, "line": line} for row, line in zip(study.runs.rows, study.runs.lines)]
    blocks: List[Any] = []
    if study.meta.get("rerun"):
        blocks.append(Text((f"A row again, alone, with its own columns in place of the names in braces: {study.meta['rerun']}",)))
    blocks.append(Grid("runs", {column: column for column in study.runs.columns}, rows, folded=True, words="All runs"))
    return Section("runs", "Every run", blocks)
