"""A dry run: a simulated person does the planned run in one process and leaves the same recording as a real one.

It needs neither ROS nor people, and shows that plan, condition, recording and analysis fit before the first person
comes.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Callable, List

import cv2
import numpy as np
import yaml

from vb_core.files import append_line
from vb_evaluation.study_kit.conduct import NextRun
from vb_evaluation.study_kit.recording import LOG, MAPS, SESSION
from vb_evaluation.provenance import revision
from vb_evaluation.study.config import METHODS, Study
from vb_evaluation.study.result import Result, RunTask
from vb_map_integration.border import VirtualBorder
from vb_map_integration.storage.recording import MapRecording


TRUTHS = "ground_truth"
YELLOW, WHITE = (0, 215, 247), (255, 255, 255)


def person(study: Study, outcomes: List[bool]) -> Callable[[NextRun], Callable[[], None]]:
    """Returns the person that `conduct_run` starts instead of the system.

    Whether the run was completed is appended to `outcomes`. The simulated home's ground truth is painted beside the protocol.
    """

    # only running needs ROS
    from vb_evaluation.study import runner

    def start(planned: NextRun) -> Callable[[], None]:
        number = int(re.sub(r"\D", "", planned.entry.participant) or 1)
        result = runner.run(study, RunTask(number, planned.entry.scenario, planned.entry.method))
        write_recording(result, planned.folder)
        picture = np.where(result.truth[::-1, :, None], YELLOW, WHITE).astype(np.uint8)
        (planned.folder.parent / TRUTHS).mkdir(exist_ok=True)
        cv2.imwrite(str(planned.folder.parent / TRUTHS / f"{planned.entry.scenario}.png"), picture)
        outcomes.append(result.saved and result.seed_is_right)
        return lambda: None

    return start


def write_recording(result: Result, folder: Path) -> None:
    """Writes what the nodes leave: interactions, maps with their borders, and how the system was started."""
    maps = MapRecording(folder / MAPS)
    maps.record(result.prior, [], 0.0)
    cameras = sorted(METHODS[result.task.method](result.world))
    for record in result.records:
        if record["border_id"] and result.border is not None:
            border = VirtualBorder(
                result.border.points, result.border.seed, 1.0, result.border.closed, id=record["border_id"]
            )
            maps.record(result.posterior, [border], record["ended"] - 0.05)
        append_line(folder / LOG, json.dumps(record))
    session = {"method": result.task.method, "cameras": cameras, "revision": revision(), "rehearsal": True}
    (folder / SESSION).write_text(yaml.safe_dump(session), encoding="utf-8")
