"""What the paper measured with 15 people (Sect. 5.8), for its three scenarios. "nrs" against "robot_only"."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, Mapping, Optional, Tuple

CITATION = (
    "D. Sprute, K. Tönnies, M. König: Interactive Restriction of a Mobile Robot's Workspace in a Smart Home "
    "Environment. Journal of Ambient Intelligence and Smart Environments, 2019, doi:10.3233/AIS-190539"
)


@dataclass(frozen=True)
class Published:
    """The paper's figures for one scenario.

    Attributes:
        speedup: mean time of robot only over that of the network robot system.
        time_z, accuracy_z: Z of the Wilcoxon test; accuracy_p: its p as printed.
        jaccard: median by method.
        completeness: success rate 0 .. 1, the same for both methods.
        border_gain_s: [s] by which the Border state was shorter; None where the paper gives no figure.
        border_m, distance_m: [m] length of the border, shortest path from the robot's start.
    """

    title: str
    speedup: float
    time_z: float
    time_p: str
    accuracy_z: float
    accuracy_p: str
    jaccard: Mapping[str, float]
    completeness: float
    border_gain_s: Optional[float]
    border_m: float
    distance_m: float


PAPER: Dict[str, Published] = {
    "room": Published(
        "Room exclusion",
        2.8,
        -3.411,
        "< .001",
        -0.594,
        ".588",
        {"nrs": 0.971, "robot_only": 0.974},
        14 / 15,
        4.0,
        0.70,
        5.40,
    ),
    "carpet": Published(
        "Carpet exclusion",
        2.2,
        -3.408,
        "< .001",
        -3.110,
        "< .001",
        {"nrs": 0.856, "robot_only": 0.779},
        14 / 15,
        26.0,
        6.50,
        2.50,
    ),
    "corner": Published(
        "Spot cleaning",
        2.2,
        -3.409,
        "< .001",
        -2.497,
        ".010",
        {"nrs": 0.878, "robot_only": 0.906},
        13 / 15,
        None,
        3.60,
        3.00,
    ),
}

METHOD_TITLES = {"nrs": "Network robot system", "robot_only": "Robot only"}


def scenario_title(key: str) -> str:
    """A scenario's name for people."""
    return PAPER[key].title if key in PAPER else key.replace("_", " ").capitalize()


def method_title(key: str) -> str:
    """A method's name for people."""
    return METHOD_TITLES.get(key, key.replace("_", " ").capitalize())


def published(scenario: str, methods: Tuple[str, ...]) -> bool:
    """Whether the paper has figures of a scenario with these methods."""
    return scenario in PAPER and all(method in PAPER[scenario].jaccard for method in methods)
