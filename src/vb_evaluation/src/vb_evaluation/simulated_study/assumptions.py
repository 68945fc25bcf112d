"""Reads the simulation's assumptions (config/assumptions.yaml), and draws worlds in which all of them vary at once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Dict, List, Mapping, Tuple

import yaml

from vb_core.errors import ParameterError
from vb_core.parameters import Parameters, param
from vb_evaluation.simulated_study.config import PACKAGE, Study

SOURCES = ("paper", "data", "literature", "assumed", "mechanics")
USUAL = (0.5, 2.0)


@dataclass(frozen=True)
class Assumption(Parameters):
    """The source of one figure.

    Attributes:
        times: plausible range in multiples of the value; empty: USUAL if it is assumed, else it is not varied.
    """

    source: str = param("assumed", choices=SOURCES)
    unit: str = param("")
    why: str = param("")
    times: list = param([])

    @property
    def range(self) -> Tuple[float, ...]:
        """(low, high) in multiples of the value; empty if it is not varied."""
        return tuple(self.times) or (USUAL if self.source == "assumed" else ())


@lru_cache(maxsize=1)
def load_assumptions() -> Mapping[str, Assumption]:
    """Returns all assumptions by the keys that `Study.changed` uses."""
    document = yaml.safe_load((PACKAGE / "config" / "assumptions.yaml").read_text(encoding="utf-8"))
    return {key: Assumption.from_mapping(entry, key) for key, entry in document.items()}


def varied_assumptions(study: Study) -> Dict[str, Assumption]:
    """Selects the assumptions that have a plausible range, and a value in this study."""
    return {key: entry for key, entry in load_assumptions().items() if entry.range and _get(study, key) is not None}


def draw_worlds(study: Study, count: int, seed: int) -> List[Dict[str, float]]:
    """Draws a Latin hypercube: for each of `count` worlds a factor for each assumption, even on a logarithmic scale.

    Another count gives different worlds.
    """
    # imported here: it takes as long as all other imports of a worker, which never draws worlds
    from scipy.stats import qmc

    varied = varied_assumptions(study)
    samples = qmc.LatinHypercube(len(varied), seed=seed).random(count)
    return [
        {
            key: round(math.exp(math.log(entry.range[0]) + share * math.log(entry.range[1] / entry.range[0])), 6)
            for share, (key, entry) in zip(row, varied.items())
        }
        for row in samples
    ]


def changes(study: Study, factors: Mapping[str, float]) -> Dict[str, Any]:
    """Returns a world's changes, for `Study.changed`."""
    return {key: scaled(_get(study, key), factor) for key, factor in factors.items()}


def scaled(value: Any, factor: float) -> Any:
    """Multiplies a number, a list of numbers or a distribution by a factor; whole numbers stay whole and at least 1."""
    if isinstance(value, bool):
        return value
    if isinstance(value, int):
        return max(1, int(round(value * factor)))
    if isinstance(value, float):
        return round(value * factor, 9)
    if isinstance(value, list):
        return [scaled(entry, factor) for entry in value]
    return {"scaled": [value, factor]}


def _get(study: Study, key: str) -> Any:
    head, _, rest = key.partition("/")
    value: Any = study.sources[head] if head in study.sources else study.document.get(head)
    for name in rest.split("/"):
        if not isinstance(value, Mapping):
            raise ParameterError(key, "there is no such value")
        value = value.get(name)
        if value is None:
            return None
    return value
