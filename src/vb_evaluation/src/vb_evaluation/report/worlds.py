"""The conclusions over plausible worlds: worlds.csv has the runs, draws.csv what each draw assumed."""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np
from scipy import stats

from vb_evaluation import statistics
from vb_evaluation.report.data import DRAWS, WORLDS, Study, Table, number, read_table

TOLERATED_CM = 2.5  # [cm] one cell of the map: no robot keeps a border more exactly


@dataclass(frozen=True)
class Worlds:
    """The results.

    Attributes:
        conclusions: conclusion, scenario, holds (Interval), n.
        deciding: outcome to entries (assumption, n, clear, _rho: estimate, low, high), the strongest first.
        noise: the 95 % limit of the largest correlation by pure chance among this many.
    """

    draws: int
    dimensions: int
    conclusions: List[Dict[str, Any]]
    deciding: Dict[str, List[Dict[str, Any]]]
    noise: float


def read(study: Study) -> Optional[Worlds]:
    """The worlds of a study; None if there are none."""
    if WORLDS not in study.tables or len(study.methods) < 2 or not (study.folder / DRAWS).is_file():
        return None
    table, inputs = study.tables[WORLDS], read_table(study.folder / DRAWS, ("draw",))
    methods = study.comparison
    pairs = _pairs(table, methods)
    claims = {
        "faster (both completed)": lambda a, b: _both(a, b, "time_total_s", lambda x, y: x < y),
        "at least 1.5 times as fast (both completed)": lambda a, b: _both(a, b, "time_total_s", lambda x, y: 1.5 * x < y),
        f"mean boundary error at most {TOLERATED_CM} cm larger": lambda a, b: _both(
            a, b, "error_mean_cm", lambda x, y: x <= y + TOLERATED_CM),
        "completed wherever robot only was": lambda a, b: number(a, "completed") == 1 if number(b, "completed") == 1 else None,
    }
    conclusions = []
    for claim, holds in claims.items():
        for scenario in ("", *table.distinct("scenario")):
            known = [held for (_, place), (a, b) in pairs.items() if scenario in ("", place)
                     for held in [holds(a, b)] if held is not None]
            conclusions.append({"conclusion": claim, "scenario": study.scenario_title(scenario) if scenario else "all",
                                "holds": statistics.proportion(sum(known), len(known)), "n": len(known)})
    outcomes = {
        "speed-up (logarithm)": lambda a, b: _both(a, b, "time_total_s", lambda x, y: math.log(y / x)),
        "boundary error, network robot system": lambda a, b: _both(a, a, "error_mean_cm", lambda x, _: x),
        "boundary error, difference of the methods": lambda a, b: _both(a, b, "error_mean_cm", lambda x, y: x - y),
    }
    names = [column for column in inputs.columns if column not in ("draw", "participant", "scenario")]
    deciding = {outcome: _ranked(pairs, inputs, names, of) for outcome, of in outcomes.items()}
    least = min((entries[0]["n"] for entries in deciding.values() if entries), default=0)
    return Worlds(len(table.distinct("draw")), len(names), conclusions, {key: one for key, one in deciding.items() if one},
                  noise(least, len(names)))


def noise(count: int, dimensions: int) -> float:
    """What the largest of this many rank correlations of `count` pairs stays below by chance, 95 % (Sidak, Fisher's z)."""
    if count < 5 or not dimensions:
        return 1.0
    level = 0.95 ** (1.0 / dimensions)
    return math.tanh(stats.norm.ppf((1.0 + level) / 2.0) / math.sqrt(count - 3.0))


def _pairs(table: Table, methods: Tuple[str, str]) -> Dict[Tuple[str, str], Tuple[Any, Any]]:
    """The rows of both methods by (draw, scenario)."""
    found: Dict[Tuple[str, str], Dict[str, Any]] = {}
    for row in table.rows:
        found.setdefault((row["draw"], row["scenario"]), {})[row["method"]] = row
    return {key: (rows[methods[0]], rows[methods[1]]) for key, rows in found.items() if set(methods) <= set(rows)}


def _both(first: Any, second: Any, column: str, of: Any) -> Optional[Any]:
    """A function of both rows' numbers; None unless both were completed."""
    values = [number(row, column) if row["completed"] == "1" else math.nan for row in (first, second)]
    return of(*values) if all(map(math.isfinite, values)) else None


def _ranked(pairs: Dict, inputs: Table, names: Sequence[str], of: Any) -> List[Dict[str, Any]]:
    """Spearman's correlation of each assumption with an outcome, ranked within scenarios so that these do not count."""
    drawn = {row["draw"]: row for row in inputs.rows}
    groups: Dict[str, List[Tuple[Any, float]]] = {}
    for (draw, scenario), (a, b) in pairs.items():
        value = of(a, b)
        if value is not None and draw in drawn:
            groups.setdefault(scenario, []).append((drawn[draw], value))
    groups = {scenario: group for scenario, group in groups.items() if len(group) >= 5}
    count = sum(map(len, groups.values()))
    if count < 10:
        return []
    limit = noise(count, len(names))
    found = []
    for name in names:
        x = np.concatenate([_ranks([number(row, name) for row, _ in group]) for group in groups.values()])
        y = np.concatenate([_ranks([value for _, value in group]) for group in groups.values()])
        if np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
            continue
        rho = float(np.corrcoef(x, y)[0, 1])
        reach = 1.96 * math.sqrt((1.0 + rho * rho / 2.0) / (count - 3.0))  # Bonett & Wright 2000
        middle = math.atanh(min(max(rho, -0.999999), 0.999999))
        found.append({"assumption": name, "n": count, "clear": "yes" if abs(rho) > limit else "no",
                      "_rho": (rho, math.tanh(middle - reach), math.tanh(middle + reach))})
    return sorted(found, key=lambda entry: -abs(entry["_rho"][0]))


def _ranks(values: Sequence[float]) -> np.ndarray:
    """Ranks, centred and as shares, so that groups of different size can be put together."""
    ranks = stats.rankdata(values)
    return (ranks - ranks.mean()) / len(ranks)
