"""Answers to commands. A repeated command is carried out once, and gets the same answer each time. No ROS."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from dataclasses import dataclass, field
from typing import Callable, Dict, Mapping

from vb_core import sentences
from vb_core.errors import CodedError

_MAX_ANSWERS = 64  # a sender repeats within seconds, and no person gives this many commands in that time


@dataclass(frozen=True)
class Answer:
    """The answer to the person: whether the command succeeded, and the code and values of the sentence.

    Attributes:
        fallback: another node's English sentence, in case our catalogue lacks its code.
    """

    success: bool
    code: str
    values: Mapping[str, str] = field(default_factory=dict)
    fallback: str = ""

    @property
    def message(self) -> str:
        """The sentence in English."""
        return sentences.translate(self.code, self.values, default=self.fallback)

    @staticmethod
    def from_error(error: CodedError) -> "Answer":
        """Makes an answer from an error."""
        return Answer(False, error.code, {name: str(value) for name, value in error.values.items()}, error.message)


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
        """Carries out a command unless one with this id was, and returns its answer. Without an id ("") it always does."""
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
            except BaseException as error:  # no answer: a repeated command is carried out
                with self._lock:
                    self._answers.pop(identity, None)
                future.set_exception(error)
        try:
            return future.result(timeout=self._timeout)
        except FutureTimeout:
            return Answer(False, "busy")
