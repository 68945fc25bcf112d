"""Which runs a study has, and in which order each participant does them."""
from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Dict, List, Mapping, Tuple

from vb_evaluation.study.config import Study
from vb_evaluation.study.runner import Task

RUNS, CURVES, SENSITIVITY = "runs.csv", "curves.csv", "sensitivity.csv"
TASK = ("participant", "scenario", "method", "seed")


@dataclass(frozen=True)
class Job:
    """One run of a study.

    Attributes:
        file: which CSV file its row goes to.
        changes: of the configuration, for curves and sensitivity; see `Study.changed`.
        conditions: columns that say what was changed.
        order: the run's place among its participant's runs, from 1; 0 if there is no such order.
    """

    task: Task
    file: str = RUNS
    changes: Mapping[str, Any] = field(default_factory=dict)
    conditions: Mapping[str, Any] = field(default_factory=dict)
    order: int = 0

    def columns(self, seed: int) -> Dict[str, Any]:
        """The columns that say which run it is."""
        task = self.task
        named = {"participant": task.participant, "scenario": task.scenario, "method": task.method, "seed": seed}
        return {**named, **self.conditions}


def main_jobs(study: Study, participants: int) -> List[Job]:
    """Every participant with every method in every scenario.

    Within subjects: a participant does all scenarios with one method, then with the next. The order of methods, and
    of scenarios within each, is random for each participant (paper, Sect. 5.4).
    """
    return [job for participant in range(1, participants + 1) for job in _in_order(study, participant)]


def _in_order(study: Study, participant: int) -> List[Job]:
    rng = study.streams(participant)("order")
    tasks: List[Tuple[str, str]] = []
    for method in rng.permutation(study.design.methods):
        tasks += [(str(scenario), str(method)) for scenario in rng.permutation(study.design.scenarios)]
    return [Job(Task(participant, *names), order=number) for number, names in enumerate(tasks, 1)]
