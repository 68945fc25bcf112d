"""The paper's results with 15 people (Sect. 5.8), for its three scenarios and its methods "nrs" and "robot_only"."""

from __future__ import annotations

import math
from typing import Dict, Mapping, NamedTuple, Optional, Tuple

CITATION = (
    "D. Sprute, K. Tönnies, M. König: Interactive Restriction of a Mobile Robot's Workspace in a Smart Home "
    "Environment. Journal of Ambient Intelligence and Smart Environments, 2019, doi:10.3233/AIS-190539"
)


class PaperFigures(NamedTuple):
    """The paper's figures for one scenario.

    Attributes:
        speedup: mean time with the robot only, divided by the mean time with the network robot system.
        jaccard: median by method.
        completeness: success rate 0 .. 1, the same for both methods.
        border_gain_s: [s] by which the Border state was shorter; None where the paper gives no figure.
    """

    title: str
    speedup: float
    jaccard: Mapping[str, float]
    completeness: float
    border_gain_s: Optional[float]


PAPER: Dict[str, PaperFigures] = {
    "room": PaperFigures("Room exclusion", 2.8, {"nrs": 0.971, "robot_only": 0.974}, 14 / 15, 4.0),
    "carpet": PaperFigures("Carpet exclusion", 2.2, {"nrs": 0.856, "robot_only": 0.779}, 14 / 15, 26.0),
    "corner": PaperFigures("Spot cleaning", 2.2, {"nrs": 0.878, "robot_only": 0.906}, 13 / 15, None),
}
METHOD_TITLES = {"nrs": "Network robot system", "robot_only": "Robot only"}
METHODS = ("nrs", "robot_only")


def paper_figures(scenario: str, method: str) -> Tuple[float, float]:
    """Returns the paper's (Jaccard index, completeness) of a scenario with a method, or nan where it has none."""
    entry = PAPER.get(scenario)
    if entry is None or method not in entry.jaccard:
        return math.nan, math.nan
    return entry.jaccard[method], entry.completeness


def scenario_title(key: str) -> str:
    """Returns a scenario's name for people."""
    return PAPER[key].title if key in PAPER else key.replace("_", " ").capitalize()


def method_title(key: str) -> str:
    """Returns a method's name for people."""
    return METHOD_TITLES.get(key, key.replace("_", " ").capitalize())
