"""Handles repeated commands: each id is carried out once, and gets the same answer each time. No ROS."""

from __future__ import annotations

import collections
import threading
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from typing import Callable

from vb_voice_wizard.session import Answer

_KEPT = 64  # answers; a sender repeats within seconds, and no person gives this many commands in that time


class AnswerCache:
    """Remembers the answers to the newest commands. Thread safe.

    Args:
        timeout: [s] how long a repeated command waits for the answer to the first one.
    """

    def __init__(self, timeout: float) -> None:
        self._timeout = timeout
        self._lock = threading.Lock()
        self._answers: "collections.OrderedDict[str, Future]" = collections.OrderedDict()

    def carry_out(self, identity: str, do: Callable[[], Answer]) -> Answer:
        """Carries out a command with this id unless it was before, and returns its answer; "" means no id."""
        if not identity:
            return do()
        with self._lock:
            first = identity not in self._answers
            slot = self._answers.setdefault(identity, Future())
            while len(self._answers) > _KEPT:
                self._answers.popitem(last=False)
        if first:
            try:
                slot.set_result(do())
            except BaseException as error:  # not an answer: a repeated command is carried out
                with self._lock:
                    self._answers.pop(identity, None)
                slot.set_exception(error)
        try:
            return slot.result(timeout=self._timeout)
        except FutureTimeout:
            return Answer(False, "busy")
