"""Collects what makes a drawing doubtful, apart from the border's check; no ROS.

The idea: while a camera has an error, what it sees is missing from the line or at a wrong place, and so it stays in the
line when the camera works again. So an error of a camera makes the drawing doubtful until the interaction ends.
"""

from __future__ import annotations

from typing import Sequence, Set, Tuple

from vb_core.notices import Notice, Severity

# notices that a part of what was drawn is not in the border, that a part of the border was not seen, or that another place
# was pointed at longer
DOUBTS = ("strokes_left_out", "piece_unseen", "seed_held_elsewhere")


class DrawingWarnings:
    """Collects them from the notices; not thread safe."""

    def __init__(self) -> None:
        self._standing: Tuple[Notice, ...] = ()
        self._failed: Set[str] = set()

    def start(self) -> None:
        """Begins another interaction: errors that were over before it do not concern it."""
        self._failed = self._cameras()

    def update(self, notices: Sequence[Notice]) -> None:
        """Stores all current notices."""
        self._standing = tuple(
            notice
            for notice in notices
            if notice.code in DOUBTS or (notice.camera and notice.severity is Severity.ERROR)
        )
        self._failed |= self._cameras()

    @property
    def all(self) -> Tuple[Notice, ...]:
        """Returns the current warnings, then the cameras that failed meanwhile."""
        over = sorted(self._failed - self._cameras())
        return self._standing + tuple(
            Notice("camera_failed_meanwhile", Severity.WARNING, camera=name, values={"camera": name}) for name in over
        )

    def _cameras(self) -> Set[str]:
        return {notice.camera for notice in self._standing if notice.camera}
