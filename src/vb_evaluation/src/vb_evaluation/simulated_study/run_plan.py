"""Plans the runs of a study: main runs, and plausible worlds in which all assumptions vary at once.

Use it to see what a study consists of before it is run. `live_run.LiveRun(study, job).run()` carries out one of the runs,
`make study` all.

>>> from vb_evaluation.simulated_study import config
>>> study = config.load()                                         # config/study.yaml
>>> quick = plan_jobs(study, quick=True)                               # one participant
>>> len(quick), sorted({(job.scenario, job.method) for job in quick})[0]
(6, ('carpet', 'nrs'))
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Dict, List, Mapping, Tuple

import yaml

from vb_core.errors import CodedError, ParameterError
from vb_core.parameters import Parameters, param
from vb_evaluation.counterbalancing import order_runs
from vb_evaluation.report.study_files import KEY, RUNS, WORLDS
from vb_evaluation.simulated_study.config import PACKAGE, Study

SOURCES = ("paper", "data", "literature", "assumed")
DEFAULT_FACTORS = (0.5, 2.0)


@dataclass(frozen=True)
class Assumption(Parameters):
    """The source of one figure.

    Attributes:
        times: plausible range in multiples of the value; empty: DEFAULT_FACTORS if it is assumed, else it is not varied.
    """

    source: str = param("assumed", choices=SOURCES)
    unit: str = param("")
    why: str = param("")
    times: list = param([])

    @property
    def range(self) -> Tuple[float, ...]:
        """(low, high) in multiples of the value, or () if it is not varied."""
        return tuple(self.times) or (DEFAULT_FACTORS if self.source == "assumed" else ())


@lru_cache(maxsize=1)
def load_assumptions() -> Mapping[str, Assumption]:
    """Returns all assumptions by the keys that `Study.changed` uses."""
    document = yaml.safe_load((PACKAGE / "config" / "assumptions.yaml").read_text(encoding="utf-8"))
    return {key: Assumption.from_mapping(entry, key) for key, entry in document.items()}


def varied_assumptions(study: Study) -> Dict[str, Assumption]:
    """Selects the assumptions that have a plausible range, and a value in this study."""
    return {key: entry for key, entry in load_assumptions().items() if entry.range and _get(study, key) is not None}


def draw_worlds(study: Study) -> List[Dict[str, float]]:
    """Draws a Latin hypercube: for each world of a study a factor for each assumption, even on a logarithmic scale.

    Another number of worlds gives different ones.
    """
    # this import takes as long as all others of a worker, which never draws worlds
    from scipy.stats import qmc

    varied = varied_assumptions(study)
    samples = qmc.LatinHypercube(len(varied), seed=study.design.seed).random(study.design.worlds)
    worlds = []
    for shares in samples:
        factors = {}
        for share, (key, entry) in zip(shares, varied.items()):
            low, high = entry.range
            factors[key] = round(math.exp(math.log(low) + share * math.log(high / low)), 6)
        worlds.append(factors)
    return worlds


def scaled_values(study: Study, factors: Mapping[str, float]) -> Dict[str, Any]:
    """Returns a world's assumptions, each times its factor, for `Study.changed`."""
    return {key: scale_value(_get(study, key), factor) for key, factor in factors.items()}


def scale_value(value: Any, factor: float) -> Any:
    """Multiplies a number, a list of numbers or a distribution by a factor; whole numbers stay whole and at least 1."""
    if isinstance(value, bool):
        return value
    if isinstance(value, int):
        return max(1, int(round(value * factor)))
    if isinstance(value, float):
        return round(value * factor, 9)
    if isinstance(value, list):
        return [scale_value(entry, factor) for entry in value]
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


@dataclass(frozen=True)
class Job:
    """One run. Its result depends on this and the study alone.

    Attributes:
        draw: number of the run's plausible world, from 1; 0 for a main run.
        changes: changes of the configuration, for worlds; see `Study.changed`.
        order: the run's position among its participant's runs, from 1; 0 if there is no such order.
    """

    participant: int
    scenario: str
    method: str
    draw: int = 0
    changes: Mapping[str, Any] = field(default_factory=dict)
    order: int = 0

    @property
    def file(self) -> str:
        """Which CSV file its row goes to."""
        return WORLDS if self.draw else RUNS

    def columns(self, seed: int) -> Dict[str, Any]:
        """Returns the columns that identify the run."""
        key = dict(zip(KEY, (self.participant, self.scenario, self.method, seed)))
        return {**key, "draw": self.draw} if self.draw else key

    @property
    def name(self) -> str:
        """Its name among its file's runs. Names sort in the order of the rows."""
        number = f"d{self.draw:04d}" if self.draw else f"p{self.participant:04d}_{self.order}"
        return f"{self.file[: -len('.csv')]}_{number}_{self.scenario}_{self.method}"


def plan_jobs(study: Study, quick: bool = False) -> List[Job]:
    """Lists all runs of a study or, if `quick`, only those of its first participant, which show that all works."""
    if quick:
        return main_jobs(study, 1)
    return main_jobs(study, study.design.participants) + world_jobs(study)


def main_jobs(study: Study, participants: int) -> List[Job]:
    """Lists a run for every participant, method and scenario, in each participant's order."""
    design = study.design
    shared = (design.participants, design.scenarios, design.methods, design.seed)
    return [
        Job(participant, scenario, method, order=order)
        for participant in range(1, participants + 1)
        for order, (scenario, method) in enumerate(order_runs(participant, *shared), 1)
    ]


def world_jobs(study: Study) -> List[Job]:
    """Lists a run of each method in each world, each world with a different person. Scenarios take turns."""
    scenarios = study.design.scenarios
    return [
        Job(draw, scenarios[draw % len(scenarios)], method, draw, scaled_values(study, factors))
        for draw, factors in enumerate(draw_worlds(study), 1)
        for method in study.design.methods
    ]


def select_jobs(candidates: List[Job], **values: Any) -> List[Job]:
    """Selects the jobs with these values of columns, where None stands for any value.

    Raises:
        CodedError: "no_such_run" if there is none.
    """
    filters = {name: value for name, value in values.items() if value is not None}
    matches = [job for job in candidates if filters.items() <= job.columns(0).items()]
    if not matches:
        raise CodedError("no_such_run", f"the study has no run with {filters}")
    return matches
