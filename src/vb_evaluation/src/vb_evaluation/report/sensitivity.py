"""Writes the sections on what would change the findings: plausible worlds, curves, every image searched."""
from __future__ import annotations

import math
from typing import Any, Dict, List, Tuple

import numpy as np

from vb_evaluation import statistics
from vb_evaluation.report import charts, effects, paper, worlds
from vb_evaluation.report.blocks import Figure, Grid, Section, Text
from vb_evaluation.report.data import CURVES, UNGATED, Study, Table, number
from vb_evaluation.statistics import Interval



SWEEPS = {
    "coverage": ("Camera coverage", "part of the floor that ceiling cameras see"),
    "distance": ("Distance of the robot", "path of the robot to the border [m]"),
    "border_length": ("Border length", "length of the border [m]"),
    "robots": ("Number of robots", "robots"),
}


def plausible(study: Study) -> Section:
    """The conclusions over worlds in which all assumptions differ at once."""
    found = worlds.read(study)
    if found is None:
        return Section("worlds", "Plausible worlds", [])
    holds = Grid("worlds", {"conclusion": "Conclusion", "scenario": "Scenario", "holds": "holds in [%] of worlds", "n": "Worlds"},
                 [{**row, "holds": effects.scaled(row["holds"], 100.0)} for row in found.conclusions], {"holds": 0},
                 words="Wilson's 95 % intervals. A world is a draw of all assumptions, with one person who tries both methods.")
    panels, rows = [], []
    for outcome, entries in found.deciding.items():
        panels.append((charts.rank_bars([(entry["assumption"], *entry["_rho"]) for entry in entries[:12]],
                                        f"rank correlation with {outcome}", found.noise), f"What decides: {outcome}"))
        rows += [{"outcome": outcome, **entry, "rho": Interval(*entry["_rho"], 0.95)} for entry in entries[:12]]
    deciding = Grid("deciding", {"outcome": "Outcome", "assumption": "Assumption", "rho": "Rank correlation", "n": "Pairs",
                                 "clear": "beyond chance"}, rows, folded=True, words="The assumptions with the largest correlations")
    return Section("worlds", "Plausible worlds", [
        Text((f"All {found.dimensions} assumptions vary together over their plausible ranges (last section): a Latin hypercube of "
              f"{found.draws} draws.",)),
        holds, Figure(panels, wide=True),
        Text((f"Grey: what the largest of {found.dimensions} correlations reaches by pure chance in 95 % of cases "
              f"(±{found.noise:.2f}); a bar within it decides nothing that this number of draws could show. Ranges are themselves "
              "assumed; a share of worlds is no probability that a conclusion is true.",), "caveat"),
        deciding])


def curves(study: Study) -> Section:
    """Speed-up, time and boundary error over coverage, distance, length and number of robots."""
    if CURVES not in study.tables or len(study.methods) < 2:
        return Section("curves", "Curves", [])
    table, blocks = study.tables[CURVES], []
    blocks.append(Text((f"All else is kept; {len(table.distinct('participant'))} participants at each point, completed runs. Bands are "
                        "95 % bootstrap intervals over participants; with so few they are too narrow rather than too wide.",), "caveat"))
    for sweep in table.distinct("sweep"):
        name, axis = SWEEPS.get(sweep, (sweep.replace("_", " ").capitalize(), sweep.replace("_", " ")))
        blocks += _curve(study, table.select(sweep=sweep), sweep, name, axis)
    return Section("curves", "Curves", blocks)


def _curve(study: Study, table: Table, sweep: str, name: str, axis: str) -> List[Any]:
    rows: List[Dict[str, Any]] = []
    lines: Dict[str, List[Tuple]] = {"speedup": [], "time": [], "error": []}
    for index, scenario in enumerate(study.scenarios):
        here = table.select(scenario=scenario)
        values = sorted(here.distinct("value"), key=float)
        if not values:
            continue
        style = {"color": charts.SERIES[(index + 2) % len(charts.SERIES)], "marker": charts.MARKERS[index % len(charts.MARKERS)]}
        x, points = [float(value) for value in values], [here.select(value=value) for value in values]
        ratios = [effects.ratio(point, study.comparison, True) for point in points]
        label = study.scenario_title(scenario)
        lines["speedup"].append((label, x, [one.estimate for one in ratios], [one.low for one in ratios],
                                 [one.high for one in ratios], style))
        for key, column, of in (("time", "time_total_s", np.mean), ("error", "error_mean_cm", np.median)):
            for method, line in zip(study.comparison, ("-", "--")):
                samples = [point.select(method=method, completed=1).numbers(column) for point in points]
                y = [float(of(sample)) if len(sample) else math.nan for sample in samples]
                lines[key].append((f"{label}, {paper.method_title(method).lower()}", x, y, None, None, {**style, "linestyle": line}))
        rows += [{"scenario": label, "value": value, "speedup": ratio, "runs": len(point.rows),
                  "completed": int(point.numbers("completed").sum())} for value, ratio, point in zip(values, ratios, points)]
    figures = [(charts.lines(lines[key], axis, words), f"{name}: {words}") for key, words in (
        ("speedup", "speed-up"), ("time", "mean time [s]"), ("error", "mean boundary error [cm], median"))]
    columns = {"scenario": "Scenario", "value": axis, "speedup": "Speed-up", "completed": "Completed", "runs": "Runs"}
    return [Figure(figures), Grid(f"curve_{sweep}", columns, rows, folded=True, words=f"{name}: table")]


def ungated(study: Study) -> Section:
    """A random part of the runs with every image searched, beside the same runs of the study."""
    if UNGATED not in study.tables:
        return Section("ungated", "Every picture searched", [])
    table, rows = study.tables[UNGATED], []
    gated = {tuple(row[key] for key in ("participant", "scenario", "method")): row for row in study.runs.rows}
    pairs = [(row, gated[key]) for row in table.rows
             for key in [tuple(row[name] for name in ("participant", "scenario", "method"))] if key in gated]
    for column, words in (("time_total_s", "time [s]"), ("error_mean_cm", "mean boundary error [cm]"), ("jaccard", "Jaccard index"),
                          ("spots", "spots"), ("false_spots", "spots farther than 0.3 m from the true one"),
                          ("completed", "completed")):
        values = [(number(full, column), number(cut, column)) for full, cut in pairs]
        known = np.array([value for value in values if np.isfinite(value).all()]).reshape(-1, 2)
        if len(known):
            rows.append({"measure": words, "full": float(known[:, 0].mean()), "cut": float(known[:, 1].mean()), "runs": len(known),
                         "difference": statistics.hodges_lehmann(np.round(known[:, 0] - known[:, 1], 9)),
                         "largest": float(np.abs(known[:, 0] - known[:, 1]).max())})
    return Section("ungated", "Every picture searched", [
        Text((f"To save time a run renders and searches only pictures, and parts of pictures, in which the true spot can be seen, so "
              f"that false spots elsewhere cannot happen. {len(pairs)} runs, drawn at random over all scenarios and methods, were "
              "done again with every picture of every camera rendered and searched as a whole.",)),
        Grid("ungated", {"measure": "Measure", "full": "Everything searched", "cut": "As in the study", "difference": "Difference",
                         "largest": "Largest difference", "runs": "Runs"}, rows, {"difference": 3, "largest": 3}),
        Text(("Which images are left out is decided by where the true spot is; a detector that is disturbed elsewhere at that moment "
              "is not seen by the study, only by these runs.",), "caveat")])
