"""Notices for people: each node publishes all its notices together, and readers keep those that still apply."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field, replace
from typing import Any, Dict, Iterable, List, Mapping, Tuple

from vb_core import sentences
from vb_core.errors import CodedError

REPEAT_PERIOD = 1.0  # [s] a node repeats its notices
EXPIRY_TIME = 5.0  # [s] a node's notices expire once it has been silent for five repetitions
# what is said of all robots is not said again of each one
_SAID_OF_ALL = {"robot_stopped": {"stopped", "stop_state_lost"}}
# what a camera lacks as its detector sees it: another error of that camera says why
_EXPLAINED = {"camera_silent", "camera_no_pose"}


class Severity(enum.IntEnum):
    """Severities, as in vb_msgs/Notice."""

    INFO = 0
    WARNING = 1
    ERROR = 2


@dataclass(frozen=True)
class Notice:
    """Something about a robot, a border or a camera, with the fields of vb_msgs/Notice."""

    code: str
    severity: Severity = Severity.INFO
    robot: str = ""
    border_id: str = ""
    camera: str = ""
    values: Mapping[str, str] = field(default_factory=dict)
    message: str = ""

    @classmethod
    def from_values(cls, code: str, severity: Severity, values: Mapping[str, Any]) -> "Notice":
        """Makes a notice of what a code comes with: the values as text, `camera` also as the field."""
        words = {key: str(value) for key, value in values.items()}
        return cls(code, severity, camera=words.get("camera", ""), values=words)

    @classmethod
    def from_error(cls, error: CodedError, severity: Severity, camera: str) -> "Notice":
        """Makes a notice of what is wrong with a camera."""
        return replace(cls.from_values(error.code, severity, {**error.values, "camera": camera}), message=error.message)

    def sentence(self, language: str = sentences.ENGLISH) -> str:
        """Returns the text to show."""
        return sentences.translate(self.code, self.values, language, self.message)


class ActiveNotices:
    """The current notices of all nodes. Not thread safe."""

    def __init__(self) -> None:
        self._said: Dict[str, Tuple[float, List[Notice]]] = {}

    def update(self, source: str, notices: Iterable[Notice], now: float) -> None:
        """Adopts a node's notices at a time [s]; replaces its former ones."""
        self._said[source] = (now, list(notices))

    def current(self, now: float) -> List[Notice]:
        """Returns the notices that hold at a time [s], most severe first; a jump back in time drops none."""
        held = [notice for heard, notices in self._said.values() if now - heard <= EXPIRY_TIME for notice in notices]
        codes = {notice.code for notice in held}
        held = [notice for notice in held if codes.isdisjoint(_SAID_OF_ALL.get(notice.code, ()))]
        errors = [notice for notice in held if notice.severity == Severity.ERROR and notice.camera]
        told = {notice.camera for notice in errors if notice.code not in _EXPLAINED}
        held = [notice for notice in held if notice.code not in _EXPLAINED or notice.camera not in told]
        return sorted(held, key=lambda notice: (-notice.severity, notice.code, notice.robot, notice.border_id))
