"""Collects the reasons to doubt a drawing, apart from the border's check; no ROS.

While a camera has an error, what it sees is missing from the line or misplaced, and remains so when the camera works
again. Therefore a camera's error makes the drawing doubtful until the interaction ends.
"""

from __future__ import annotations

from typing import Sequence, Set, Tuple

from vb_core.notices import Notice, Severity

# notices that a part of the drawing is not in the border, that a part of the border was not seen, or that the spot was
# held elsewhere for longer or later
DOUBTS = ("strokes_left_out", "piece_unseen", "seed_held_elsewhere")


class DrawingWarnings:
    """Collects the warnings about a drawing from the notices; not thread safe."""

    def __init__(self) -> None:
        self._standing: Tuple[Notice, ...] = ()
        self._failed: Set[str] = set()

    def start(self) -> None:
        """Begins another interaction, which is not concerned by errors that were over before."""
        self._failed = self._cameras()

    def update(self, notices: Sequence[Notice]) -> None:
        """Stores those of all current notices that concern the drawing."""
        self._standing = tuple(
            notice
            for notice in notices
            if notice.code in DOUBTS or (notice.camera and notice.severity is Severity.ERROR)
        )
        self._failed |= self._cameras()

    @property
    def all(self) -> Tuple[Notice, ...]:
        """Returns the current warnings, then one for each camera whose error is over."""
        over = sorted(self._failed - self._cameras())
        return self._standing + tuple(
            Notice("camera_failed_meanwhile", Severity.WARNING, camera=name, values={"camera": name}) for name in over
        )

    def _cameras(self) -> Set[str]:
        return {notice.camera for notice in self._standing if notice.camera}
