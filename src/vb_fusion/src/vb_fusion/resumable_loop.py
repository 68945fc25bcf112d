"""A loop that resumes after its last unchanged row, so that a growing drawing costs only what is new.

Each expensive stage is a loop over rows in the order of time that does not look ahead: its state after a row depends
on the rows up to there only. So the states are kept, and the loop goes on behind the last row that is still the same.
A stage that is given all rows at once and one that is given them bit by bit come to the same result.
"""

from __future__ import annotations

from typing import Tuple

import numpy as np


class ResumableLoop:
    """The state of a loop after each of the rows that it has seen."""

    def __init__(self) -> None:
        self._rows = np.zeros((0, 0))
        self._states = np.zeros((0, 0))

    def resume(self, rows: np.ndarray, width: int) -> Tuple[int, np.ndarray]:
        """Finds the row at which the loop continues.

        Args:
            rows: (N, k) what the loop runs over.
            width: of a state.

        Returns:
            The first row that the loop has to run over, and the states (N, width) after each row. Those of earlier rows
            are filled in; the loop fills in the others.
        """
        same = min(len(self._rows), len(rows))
        changed = np.not_equal(self._rows[:same], rows[:same]).ravel() if same else np.zeros(0, dtype=bool)
        if changed.any():
            same = int(changed.argmax()) // rows.shape[1]
        states = np.empty((len(rows), width))
        if same:
            states[:same] = self._states[:same]
        self._rows, self._states = rows, states
        return same, states
