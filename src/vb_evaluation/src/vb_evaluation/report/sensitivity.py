"""Writes the sections on what would change the findings: plausible worlds, curves, every image searched."""

from __future__ import annotations

import math
from typing import Any, Dict, List, Tuple

import numpy as np
import pandas
from scipy import stats

from vb_evaluation import statistics
from vb_evaluation.report import charts, effect_sizes, paper
from vb_evaluation.report.blocks import Block, Figure, Grid, Text
from vb_evaluation.report.data import ALL_IMAGES, CURVES, DRAWS, WORLDS, StudyResults, known, read_sheet, select
from vb_evaluation.statistics import Interval

TOLERATED_CM = 2.5  # [cm] one cell of the map: no robot keeps a border more exactly
MIN_GROUP, MIN_PAIRS = 5, 10  # of ranks within a scenario, and in all
SWEEPS = {
    "coverage": ("Camera coverage", "part of the floor that ceiling cameras see"),
    "distance": ("Distance of the robot", "path of the robot to the border [m]"),
    "border_length": ("Border length", "length of the border [m]"),
    "robots": ("Number of robots", "robots"),
}
_RUN = ["participant", "scenario", "method"]


# ---------------------------------------------------------------- plausible worlds
def plausible_worlds_section(study: StudyResults) -> List[Block]:
    """Reports the conclusions over worlds in which all assumptions differ at once.

    Empty where draws.csv or worlds.csv is missing.
    """
    if not study.has_worlds:
        return []
    inputs = read_sheet(study.folder / DRAWS, ("draw",)).apply(pandas.to_numeric, errors="coerce").set_index("draw")
    table, (first, baseline) = study.tables[WORLDS], study.comparison
    both = select(table, method=first).merge(
        select(table, method=baseline), on=["draw", "scenario"], suffixes=("", "_base")
    )
    rows, by_chance = rank_influences(both, inputs)
    panels = []
    for outcome in dict.fromkeys(row["outcome"] for row in rows):
        bars = [(row["assumption"], row["rho"]) for row in rows if row["outcome"] == outcome]
        panels.append(
            (charts.rank_bars(bars, f"rank correlation with {outcome}", by_chance), f"What decides: {outcome}")
        )
    return [
        Text(
            f"All {len(inputs.columns)} assumptions vary together over their plausible ranges (last section): a Latin hypercube of "
            f"{table.draw.nunique()} draws."
        ),
        Grid(
            "worlds",
            {"conclusion": "Conclusion", "scenario": "Scenario", "holds": "holds in [%] of worlds", "n": "Worlds"},
            conclusions(study, both),
            {"holds": 0},
            words="Wilson's 95 % intervals. A world is a draw of all assumptions, with one person who tries both methods. Too bright: "
            "the lab's own check of the cameras asks for a shorter exposure before anybody draws.",
        ),
        Figure(panels, wide=True),
        Text(
            f"Grey: what the largest of {len(inputs.columns)} correlations reaches by pure chance in 95 % of cases "
            f"(±{by_chance:.2f}); this number of draws cannot show that an assumption with a bar within it matters. The ranges are "
            "assumed, too; a share of worlds is no probability that a conclusion is true.",
            caveat=True,
        ),
        Grid(
            "deciding",
            {
                "outcome": "Outcome",
                "assumption": "Assumption",
                "rho": "Rank correlation",
                "n": "Pairs",
                "clear": "beyond chance",
            },
            rows,
            folded=True,
            words="The assumptions with the largest correlations",
        ),
    ]


def _completed(both: pandas.DataFrame, column: str) -> Tuple[pandas.Series, pandas.Series]:
    """Returns a measure with either method, nan unless both were completed."""
    done = (both.completed == 1) & (both.completed_base == 1) & both[column].notna() & both[f"{column}_base"].notna()
    return both[column].where(done), both[f"{column}_base"].where(done)


def conclusions(study: StudyResults, both: pandas.DataFrame) -> List[Dict[str, Any]]:
    """Counts in which share of worlds a conclusion holds, in all and by scenario."""
    (time, time_base), (error, error_base) = (_completed(both, column) for column in ("time_total_s", "error_mean_cm"))
    claims = {
        "faster (both completed)": (time < time_base, time.notna()),
        "at least 1.5 times as fast (both completed)": (1.5 * time < time_base, time.notna()),
        f"mean boundary error at most {TOLERATED_CM} cm larger": (error <= error_base + TOLERATED_CM, error.notna()),
        "completed wherever robot only was": (both.completed == 1, both.completed_base == 1),
        **{
            f"completed: {paper.method_title(method).lower()}": (column == 1, column.notna())
            for method, column in zip(study.comparison, (both.completed, both.completed_base))
        },
    }
    scopes = {
        "all": True,
        **{study.scenario_title(key): both.scenario == key for key in study.tables[WORLDS].scenario.unique()},
        "no camera too bright": both.too_bright == 0,
    }
    rows = []
    for claim, (holds, told) in claims.items():
        for scope, within in scopes.items():
            there = holds[told & within]
            rows.append(
                {
                    "conclusion": claim,
                    "scenario": scope,
                    "n": len(there),
                    "holds": statistics.proportion(int(there.sum()), len(there)).scaled(100.0),
                }
            )
    return rows


def rank_influences(both: pandas.DataFrame, inputs: pandas.DataFrame) -> Tuple[List[Dict[str, Any]], float]:
    """Computes Spearman's correlation of each assumption with each outcome, within scenarios.

    Returns:
        (the twelve strongest for each outcome, what the largest of all stays below by chance).
    """
    (time, time_base), (error, error_base) = (_completed(both, column) for column in ("time_total_s", "error_mean_cm"))
    outcomes = {
        "completed: network robot system": both.completed,
        "speed-up (logarithm)": np.log(time_base / time),
        "boundary error, network robot system": both.error_mean_cm.where(both.completed == 1),
        "boundary error, difference of the methods": error - error_base,
    }
    rows: List[Dict[str, Any]] = []
    for outcome, values in outcomes.items():
        found = both[["draw", "scenario"]].assign(outcome=values).dropna().join(inputs, on="draw", how="inner")
        found = found.groupby("scenario").filter(lambda group: len(group) >= MIN_GROUP)
        if len(found) < MIN_PAIRS:
            continue
        numbers = found.drop(columns=["draw", "scenario"])
        # ranks are centred and made shares, so that groups of different size can be put together
        ranks = numbers.groupby(found.scenario).transform(
            lambda column: (column.rank() - column.rank().mean()) / len(column)
        )
        rhos = ranks[inputs.columns].corrwith(ranks.outcome).dropna()
        limit = chance_level(len(found), len(inputs.columns))
        rows += [
            {
                "outcome": outcome,
                "assumption": name,
                "n": len(found),
                "clear": "yes" if abs(rho) > limit else "no",
                "rho": _correlation(rho, len(found)),
            }
            for name, rho in rhos.sort_values(key=np.abs, ascending=False, kind="stable")[:12].items()
        ]
    return rows, chance_level(min((row["n"] for row in rows), default=0), len(inputs.columns))


def _correlation(rho: float, count: int) -> Interval:
    reach = 1.96 * math.sqrt((1.0 + rho * rho / 2.0) / (count - 3.0))  # Bonett & Wright 2000
    middle = math.atanh(min(max(rho, -0.999999), 0.999999))
    return Interval(rho, math.tanh(middle - reach), math.tanh(middle + reach), 0.95)


def chance_level(count: int, dimensions: int) -> float:
    """Returns what the largest of this many rank correlations of `count` pairs stays below by chance, 95 % (Sidak, Fisher's z)."""
    if count < 5 or not dimensions:
        return 1.0
    level = 0.95 ** (1.0 / dimensions)
    return math.tanh(stats.norm.ppf((1.0 + level) / 2.0) / math.sqrt(count - 3.0))


# ---------------------------------------------------------------- curves
def curves_section(study: StudyResults) -> List[Block]:
    """Plots speed-up, time and boundary error over coverage, distance, length and number of robots."""
    if CURVES not in study.tables or len(study.methods) < 2:
        return []
    table = study.tables[CURVES]
    blocks: List[Block] = [
        Text(
            f"All else is kept; {table.participant.nunique()} participants at each point, completed runs. Bands are "
            "95 % bootstrap intervals over participants; with so few they are too narrow rather than too wide.",
            caveat=True,
        )
    ]
    for sweep in table.sweep.unique():
        blocks += _curve(study, select(table, sweep=sweep), sweep)
    return blocks


def _curve(study: StudyResults, table: pandas.DataFrame, sweep: str) -> List[Any]:
    name, axis = SWEEPS.get(sweep, (sweep.replace("_", " ").capitalize(), sweep.replace("_", " ")))
    rows: List[Dict[str, Any]] = []
    lines: Dict[str, List[charts.Line]] = {"speed-up": [], "mean time [s]": [], "mean boundary error [cm], median": []}
    for index, scenario in enumerate(study.scenarios):
        label, points = study.scenario_title(scenario), dict(list(select(table, scenario=scenario).groupby("value")))
        if not points:
            continue
        ratios = [effect_sizes.ratio(point, study.comparison, True) for point in points.values()]
        lines["speed-up"].append(charts.Line(label, "", index, list(points), ratios))
        for words, column, of in (
            ("mean time [s]", "time_total_s", np.mean),
            ("mean boundary error [cm], median", "error_mean_cm", np.median),
        ):
            for method in study.comparison:
                samples = [known(select(point, method=method, completed=1), column) for point in points.values()]
                y = [Interval(float(of(sample)) if len(sample) else math.nan) for sample in samples]
                lines[words].append(charts.Line(label, paper.method_title(method).lower(), index, list(points), y))
        rows += [
            {
                "scenario": label,
                "value": str(value),
                "speedup": ratio,
                "runs": len(point),
                "completed": int(point.completed.sum()),
            }
            for (value, point), ratio in zip(points.items(), ratios)
        ]
    columns = {"scenario": "Scenario", "value": axis, "speedup": "Speed-up", "completed": "Completed", "runs": "Runs"}
    return [
        Figure([(charts.lines(found, axis, words), f"{name}: {words}") for words, found in lines.items()]),
        Grid(f"curve_{sweep}", columns, rows, folded=True, words=f"{name}: table"),
    ]


# ---------------------------------------------------------------- every image searched
def all_images_section(study: StudyResults) -> List[Block]:
    """Compares a random part of the runs, with every image searched, with the same runs of the study."""
    if ALL_IMAGES not in study.tables:
        return []
    both = study.tables[ALL_IMAGES].merge(study.runs, on=_RUN, suffixes=("", "_cut"))
    return [
        Text(
            f"To save time a run renders and searches only pictures, and parts of pictures, in which the true spot can be seen, so "
            f"that false spots elsewhere cannot happen. {len(both)} runs, drawn at random over all scenarios and methods, were "
            "repeated with every image of every camera rendered and searched as a whole."
        ),
        Grid(
            "all_images",
            {
                "measure": "Measure",
                "full": "Everything searched",
                "cut": "As in the study",
                "difference": "Difference",
                "largest": "Largest difference",
                "runs": "Runs",
            },
            _differences(both),
            {"difference": 3, "largest": 3},
        ),
        Text(
            "Which images are left out is decided by where the true spot is; a detector that is disturbed elsewhere at that moment "
            "is not seen by the study, only by these runs.",
            caveat=True,
        ),
    ]


def _differences(both: pandas.DataFrame) -> List[Dict[str, Any]]:
    """Returns a row for each measure that runs have with every image searched and without (name ends in "_cut")."""
    rows = []
    for column, words in (
        ("time_total_s", "time [s]"),
        ("error_mean_cm", "mean boundary error [cm]"),
        ("jaccard", "Jaccard index"),
        ("spots", "spots"),
        ("false_spots", "spots farther than 0.3 m from the true one"),
        ("completed", "completed"),
    ):
        there = both[[column, f"{column}_cut"]].dropna().to_numpy()
        if len(there):
            difference = there[:, 0] - there[:, 1]
            rows.append(
                {
                    "measure": words,
                    "full": float(there[:, 0].mean()),
                    "cut": float(there[:, 1].mean()),
                    "runs": len(there),
                    "difference": statistics.hodges_lehmann(np.round(difference, 9)),
                    "largest": float(np.abs(difference).max()),
                }
            )
    return rows
