"""Plans the runs of a study: main runs and plausible worlds.

Use it to see what a study consists of before it is run. `live_run.run(study, job)` carries out one of the runs,
`make study` all.

>>> from vb_evaluation.simulated_study import config
>>> study = config.load()                                         # config/study.yaml
>>> quick = jobs(study, quick=True)                               # one participant
>>> len(quick), sorted({(job.scenario, job.method) for job in quick})[0]
(6, ('carpet', 'nrs'))
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Dict, List, Mapping

from vb_core.errors import CodedError
from vb_evaluation.counterbalancing import order_runs
from vb_evaluation.report.study_files import KEY, RUNS, WORLDS
from vb_evaluation.simulated_study import assumptions
from vb_evaluation.simulated_study.config import Study


@dataclass(frozen=True)
class Job:
    """One run; its result depends on this and the study alone.

    Attributes:
        draw: the plausible world that it is in, from 1; 0 for a main run.
        changes: of the configuration, for worlds; see `Study.changed`.
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
        """Its name among its file's runs; names sort in the order of the rows."""
        place = f"d{self.draw:04d}" if self.draw else f"p{self.participant:04d}_{self.order}"
        return f"{self.file[: -len('.csv')]}_{place}_{self.scenario}_{self.method}"


def jobs(study: Study, quick: bool = False) -> List[Job]:
    """Lists all runs of a study or, if `quick`, only those of its first participant, which show that all works."""
    if quick:
        return main_jobs(study, 1)
    return main_jobs(study, study.design.participants) + world_jobs(study)


def main_jobs(study: Study, participants: int) -> List[Job]:
    """Lists a run for every participant, method and scenario, in each participant's order."""
    design = study.design
    return [
        Job(participant, scenario, method, order=place)
        for participant in range(1, participants + 1)
        for place, (scenario, method) in enumerate(
            order_runs(participant, design.participants, design.scenarios, design.methods, design.seed), 1
        )
    ]


def world_jobs(study: Study) -> List[Job]:
    """Lists a run of each method in each world, each world with a different person; scenarios take turns."""
    scenarios = study.design.scenarios
    return [
        Job(draw, scenarios[draw % len(scenarios)], method, draw, assumptions.changes(study, factors))
        for draw, factors in enumerate(assumptions.draw_worlds(study, study.design.worlds, study.design.seed), 1)
        for method in study.design.methods
    ]


def select(among: List[Job], **wanted: Any) -> List[Job]:
    """Selects the jobs with these values of columns; None is any.

    Raises:
        CodedError: "no_such_run" if there is none.
    """
    asked = {name: value for name, value in wanted.items() if value is not None}
    found = [job for job in among if asked.items() <= job.columns(0).items()]
    if not found:
        raise CodedError("no_such_run", f"the study has no run with {asked}")
    return found
