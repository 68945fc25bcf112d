"""What people should know now: each node says all of it at once, and readers keep what still holds."""
from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import Dict, Iterable, List, Mapping, Tuple

from vb_core import sentences

REPEATED_AFTER = 1.0  # [s] a node says its notices again
FORGOTTEN_AFTER = 5.0  # [s] what a node said holds no longer once it has been silent for five repetitions


class Severity(enum.IntEnum):
    """The numbers are those of vb_msgs/Notice."""

    INFO = 0
    WARNING = 1
    ERROR = 2


@dataclass(frozen=True)
class Notice:
    """Something about a robot, a border or a camera; the fields are those of vb_msgs/Notice."""

    code: str
    severity: Severity = Severity.INFO
    robot: str = ""
    border_id: str = ""
    camera: str = ""
    values: Mapping[str, str] = field(default_factory=dict)
    message: str = ""

    def sentence(self, language: str = sentences.ENGLISH) -> str:
        """What people read."""
        return sentences.say(self.code, self.values, language, self.message)


class NoticeBook:
    """The notices of all nodes that hold now. Not thread safe."""

    def __init__(self) -> None:
        self._said: Dict[str, Tuple[float, List[Notice]]] = {}

    def hear(self, source: str, notices: Iterable[Notice], now: float) -> None:
        """All that a node has to say at a time [s]; replaces what it said before."""
        self._said[source] = (now, list(notices))

    def current(self, now: float) -> List[Notice]:
        """What holds at a time [s], the most severe first; time that jumped back forgets nothing."""
        held = [notice for heard, notices in self._said.values() if now - heard <= FORGOTTEN_AFTER for notice in notices]
        return sorted(held, key=lambda notice: (-notice.severity, notice.code, notice.robot, notice.border_id))
