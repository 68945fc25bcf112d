"""Plans the runs of a study: main runs and plausible worlds.

Use it to see what a study consists of before it is run. `runner.run(study, job.task)` carries out one of the runs,
`make study` all.

>>> from vb_evaluation.study import config
>>> study = config.load()                                         # config/study.yaml
>>> quick = jobs(study, quick=True)                               # one participant
>>> len(quick), sorted({(job.task.scenario, job.task.method) for job in quick})[0]
(6, ('carpet', 'nrs'))
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Dict, List, Mapping

from vb_core.errors import CodedError
from vb_evaluation.design import order_runs
from vb_evaluation.report.data import KEY, RUNS, WORLDS
from vb_evaluation.study import assumptions
from vb_evaluation.study.config import Study
from vb_evaluation.study.result import RunTask


@dataclass(frozen=True)
class Job:
    """One run of a study.

    Attributes:
        file: which CSV file its row goes to.
        changes: of the configuration, for worlds; see `Study.changed`.
        conditions: columns that say what was changed.
        order: the run's place among its participant's runs, from 1; 0 if there is no such order.
    """

    task: RunTask
    file: str = RUNS
    changes: Mapping[str, Any] = field(default_factory=dict)
    conditions: Mapping[str, Any] = field(default_factory=dict)
    order: int = 0

    def columns(self, seed: int) -> Dict[str, Any]:
        """Returns the columns that say which run it is."""
        task = self.task
        return {**dict(zip(KEY, (task.participant, task.scenario, task.method, seed))), **self.conditions}

    @property
    def name(self) -> str:
        """Names it among its file's runs; the names' order is that of the rows."""
        task, draw = self.task, self.conditions.get("draw")
        place = f"d{draw:04d}" if draw else f"p{task.participant:04d}_{self.order}"
        return f"{self.file[: -len('.csv')]}_{place}_{task.scenario}_{task.method}"

    @property
    def words(self) -> str:
        """Which run it is, for people."""
        changed = [str(value) for value in self.conditions.values()]
        return ", ".join([f"participant {self.task.participant}", self.task.scenario, self.task.method, *changed])


def jobs(study: Study, quick: bool = False) -> List[Job]:
    """Lists all runs of a study; or only those of its first participant, which show that all works."""
    if quick:
        return main_jobs(study, 1)
    return main_jobs(study, study.design.participants) + world_jobs(study)


def main_jobs(study: Study, participants: int) -> List[Job]:
    """Lists a run for every participant, method and scenario, in each participant's order."""
    design = study.design
    return [
        Job(RunTask(participant, scenario, method), order=place)
        for participant in range(1, participants + 1)
        for place, (scenario, method) in enumerate(
            order_runs(participant, design.scenarios, design.methods, design.seed), 1
        )
    ]


def world_jobs(study: Study) -> List[Job]:
    """Lists both methods in each world, each world with a different person; scenarios take turns."""
    scenarios = study.design.scenarios
    return [
        Job(
            RunTask(draw, scenarios[draw % len(scenarios)], method),
            WORLDS,
            assumptions.changes(study, factors),
            {"draw": draw},
        )
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
