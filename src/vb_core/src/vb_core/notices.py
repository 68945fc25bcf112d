"""Notices for people: each node publishes all its notices together, and a reader keeps those that still apply."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from itertools import chain
from typing import Dict, Iterable, List, Mapping, Tuple

from vb_core import sentences
from vb_core.errors import CodedError

REPEAT_PERIOD = 1.0  # [s] a node repeats its notices
EXPIRY_TIME = 5.0  # [s] a node's notices expire once it has been silent for five repetitions
# by a notice's code, the codes that make it redundant: they concern all robots, or say what is wrong with the camera
_SUPERSEDED_BY = {
    "robot_stopped": {"stopped", "stop_state_lost"},
    "camera_no_pose": {
        "camera_not_calibrated",
        "camera_file_broken",
        "camera_frame_differs",
        "camera_other_lens",
        "shared_frame",
    },
}


class Severity(enum.IntEnum):
    """Severities, as in vb_msgs/Notice."""

    INFO = 0
    WARNING = 1
    ERROR = 2


@dataclass(frozen=True)
class Notice:
    """A notice, for instance about a robot, a border or a camera. Its fields are those of vb_msgs/Notice."""

    code: str
    severity: Severity = Severity.INFO
    robot: str = ""
    border_id: str = ""
    camera: str = ""
    values: Mapping[str, str] = field(default_factory=dict)
    message: str = ""

    @classmethod
    def from_error(cls, error: CodedError, severity: Severity, camera: str = "") -> "Notice":
        """Makes a notice from an error. The camera, given here or by the error, is in both `camera` and `values`."""
        values = {key: str(value) for key, value in error.values.items()}
        if camera:
            values["camera"] = camera
        return cls(error.code, severity, camera=values.get("camera", ""), values=values, message=error.message)

    @classmethod
    def of_robot(cls, robot: str, code: str, severity: Severity, **values: str) -> "Notice":
        """Makes a notice about a robot, whom the sentence names as {who}."""
        return cls(code, severity, robot=robot, values={**sentences.robot_values(robot), **values})

    def sentence(self, language: str = sentences.ENGLISH) -> str:
        """Returns the text to show."""
        return sentences.translate(self.code, self.values, language, self.message)


class ActiveNotices:
    """The current notices of all nodes. Not thread safe."""

    def __init__(self) -> None:
        self._published: Dict[str, Tuple[float, List[Notice]]] = {}

    def update(self, source: str, notices: Iterable[Notice], now: float) -> None:
        """Replaces a node's notices by those that it published at time `now` [s]."""
        self._published[source] = (now, list(notices))

    def current(self, now: float) -> List[Notice]:
        """Returns the notices that apply at time `now` [s], most severe first. A jump back in time drops none."""
        unexpired = [notices for time, notices in self._published.values() if now - time <= EXPIRY_TIME]
        active = list(chain.from_iterable(unexpired))
        reported = {(notice.code, notice.camera) for notice in active}
        active = [
            notice
            for notice in active
            if reported.isdisjoint((code, notice.camera) for code in _SUPERSEDED_BY.get(notice.code, ()))
        ]
        return sorted(active, key=lambda notice: (-notice.severity, notice.code, notice.robot, notice.border_id))
