"""Answers to commands. A repeated command is carried out once, and gets the same answer each time. No ROS."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from dataclasses import dataclass, field
from typing import Callable, Dict, Mapping

from vb_core import sentences
from vb_core.errors import CodedError

_MAX_ANSWERS = 64  # more commands than a person gives within the seconds in which a sender repeats one


@dataclass(frozen=True)
class Answer:
    """The answer to a command: whether it succeeded, and the code and values of the sentence for the person."""

    success: bool
    code: str
    values: Mapping[str, str] = field(default_factory=dict)
    fallback: str = ""  # the English sentence of another node, used if the catalogue does not have the code

    @property
    def message(self) -> str:
        """The sentence in English."""
        return sentences.translate(self.code, self.values, default=self.fallback)

    @staticmethod
    def from_error(error: CodedError) -> "Answer":
        """Makes an answer from an error."""
        values = {name: str(value) for name, value in error.values.items()}
        return Answer(False, error.code, values, error.message)


class AnswerCache:
    """Remembers the answers to the newest commands. Thread safe.

    Args:
        timeout: [s] how long a repeated command waits for the answer to the first one.
    """

    def __init__(self, timeout: float) -> None:
        self._timeout = timeout
        self._lock = threading.Lock()
        self._answers: Dict[str, Future] = {}  # the oldest first

    def answer_once(self, identity: str, carry_out: Callable[[], Answer]) -> Answer:
        """Carries out a command, but only once for each id, and returns its answer. A command without an id is always new."""
        if not identity:
            return carry_out()
        with self._lock:
            is_first = identity not in self._answers
            future = self._answers.setdefault(identity, Future())
            if len(self._answers) > _MAX_ANSWERS:
                self._answers.pop(next(iter(self._answers)))
        if is_first:
            try:
                future.set_result(carry_out())
            except BaseException as error:  # there is no answer to repeat, so a repeated command is carried out again
                with self._lock:
                    self._answers.pop(identity, None)
                future.set_exception(error)
        try:
            return future.result(timeout=self._timeout)
        except FutureTimeout:
            return Answer(False, "busy")
