"""The content of the page: sections of JSON, each with a revision.

A section is serialised once, when it changes. A browser that knows revision N gets the sections that are newer. All
browsers get the same text, and a slow browser does not get the versions of a section that have already been replaced.
"""

from __future__ import annotations

import itertools
import json
import math
import threading
from string import ascii_uppercase
from typing import Any, Callable, Dict, List, Optional, Tuple

from vb_core.errors import CodedError


def json_number(value: float, digits: int = 3) -> Optional[float]:
    """Rounds a number for JSON. Returns None if it is not finite."""
    return round(float(value), digits) if math.isfinite(value) else None


def coarse_age(seconds: float) -> int:
    """Rounds an age [s] down to 0, 3, 5, 10, 20 ... 60, 120 ... 3600, as a screen reader reads out each change."""
    steps = (3, 5, *range(10, 60, 10), *range(60, 3600, 60), 3600)
    return max([step for step in steps if step <= seconds], default=0)


def compact_json(value: Any) -> str:
    """Serialises a value for a browser as JSON without spaces. Raises ValueError if a number is not finite."""
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def make_answer(code: str, ok: bool, values: Dict[str, str], message: str) -> Dict[str, Any]:
    """Makes the answer to a request: a code, the values for the sentence with this code, and the sentence in English."""
    return {"ok": ok, "code": code, "values": values, "message": message}


def answer_from_error(error: CodedError) -> Dict[str, Any]:
    """Converts an error to an answer."""
    values = {name: str(value) for name, value in error.values.items()}
    return make_answer(error.code, False, values, error.message)


class PageView:
    """The page's sections. Thread safe.

    Args:
        on_change: called, from any thread, after a section has changed.
    """

    def __init__(self, on_change: Callable[[], None] = lambda: None) -> None:
        self.on_change = on_change
        self._lock = threading.Lock()
        self._sections: Dict[str, Tuple[int, str]] = {}  # each section's (revision, JSON)
        self._revision = 0

    def put(self, section: str, value: Any) -> None:
        """Replaces a section. Browsers get it if it has changed."""
        text = compact_json(value)
        with self._lock:
            if self._sections.get(section, (0, None))[1] == text:
                return
            self._revision += 1
            self._sections[section] = (self._revision, text)
        self.on_change()

    def changes_since(self, revision: int) -> Tuple[int, str]:
        """Returns the current revision, and a message with all sections newer than `revision`, "" if there are none."""
        with self._lock:
            current = self._revision
            newer = {name: text for name, (changed, text) in self._sections.items() if changed > revision}
        if not newer:
            return current, ""
        members = ",".join(f'"{name}":{text}' for name, text in newer.items())
        return current, '{"view":{' + members + "}}"


def mark_borders(previous_marks: Dict[str, str], ids: List[str]) -> Dict[str, str]:
    """Gives each border a short mark, which the page shows where there is no room for its name. Returns them by id.

    A border keeps its mark from `previous_marks`. A new border gets the first of A to Z, A1 to Z1, ... not used there.

    >>> mark_borders({"rug": "A", "bed": "B"}, ["bed", "sofa"])
    {'bed': 'B', 'sofa': 'C'}
    """
    all_marks = (letter + str(turn or "") for turn in itertools.count() for letter in ascii_uppercase)
    free_marks = (mark for mark in all_marks if mark not in previous_marks.values())
    return {key: previous_marks[key] if key in previous_marks else next(free_marks) for key in ids}
