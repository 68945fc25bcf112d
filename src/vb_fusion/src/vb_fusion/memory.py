"""What lets a growing drawing be extracted again for the price of what is new.

Each expensive stage is a loop over rows in the order of time that does not look ahead: its state after a row depends
on the rows up to there only. So the states are kept, and the loop goes on behind the last row that is still the same.
A stage that is given all rows at once and one that is given them bit by bit come to the same result.
"""
from __future__ import annotations

from typing import List

import numpy as np


def unchanged(before: np.ndarray, now: np.ndarray) -> int:
    """How many leading rows of two arrays (N, k) and (M, k) are equal."""
    count = min(len(before), len(now))
    changed = np.flatnonzero((before[:count] != now[:count]).any(axis=1))
    return int(changed[0]) if len(changed) else count


class Memory:
    """The state of a loop after each of the rows that it has seen."""

    def __init__(self) -> None:
        self._rows = np.zeros((0, 0))
        self.states: List = []

    def resume(self, rows: np.ndarray) -> int:
        """The first of the rows (N, k) that the loop has to run over; `states` are those of the rows before it."""
        same = unchanged(self._rows, rows) if self._rows.shape[1] == rows.shape[1] else 0
        self._rows = rows
        del self.states[same:]
        return same
