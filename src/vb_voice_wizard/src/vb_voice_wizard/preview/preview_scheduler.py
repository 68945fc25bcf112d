"""Decides when the preview of saving is computed again, and collects the reasons to doubt a drawing. No ROS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Sequence, Set, Tuple

import numpy as np

from vb_core.notices import Notice, Severity

PREVIEW_PERIOD = 0.5  # [s] between two previews: faster than people read
RETRY_DELAY = 2.0  # [s] after which a service that did not answer is called again
VISIBLE_MOVE = 0.02  # [m] a vertex or seed that moved less causes no visible change: a map cell is larger
MAX_TIME_SHARE = 0.25  # share of the time that previews may take: the same computer searches the images
# notices of a stroke that is not in the border, of a piece that was not seen, and of a spot that was held elsewhere
DOUBTS = ("strokes_left_out", "piece_unseen", "seed_held_elsewhere")


def comparison_key(points: np.ndarray) -> bytes:
    """Returns a key of points (N, 2) [m] that differs once a point has moved visibly, or b"" if there are none."""
    return np.round(points / VISIBLE_MOVE).astype(np.int32).tobytes()


@dataclass(frozen=True)
class PreviewInputs:
    """Everything that a preview depends on; equal inputs give previews that look the same.

    Attributes:
        interaction_id: id of the current interaction; "": none.
        chain, seed: `comparison_key` of the border and the seed so far, map frame.
        borders: changes with every change of the map or the borders in it.
        missing_reason: why there is no border or no seed, if known.
        warnings: what else makes the drawing doubtful (`DrawingWarnings`).
    """

    interaction_id: str = ""
    chain: bytes = b""
    seed: bytes = b""
    borders: Tuple[float, int] = (0.0, 0)
    missing_reason: Notice = Notice("")
    warnings: Tuple[Notice, ...] = ()

    @property
    def is_complete(self) -> bool:
        """Whether there is something to preview."""
        return bool(self.interaction_id and self.chain and self.seed)


class PreviewScheduler:
    """Decides when the next preview is due.

    The pace is in wall time, as it limits the previews' share of the computer.

    Attributes:
        shown: the inputs of the last preview.
    """

    def __init__(self) -> None:
        self.shown: Optional[PreviewInputs] = None
        self._not_before = float("-inf")
        self._retry_at: Optional[float] = None

    def delay(self, inputs: PreviewInputs, now: float) -> Optional[float]:
        """Returns the time [s] until these inputs need a preview, 0 for now, or None for never unless they change."""
        if self.shown is None or inputs.interaction_id != self.shown.interaction_id:
            return 0.0
        if inputs == self.shown:
            return None if self._retry_at is None else max(0.0, self._retry_at - now)
        return max(0.0, self._not_before - now)

    def record_preview(self, inputs: PreviewInputs, started: float, now: float, answered: bool) -> None:
        """Records that a preview was made.

        Args:
            inputs: the inputs of the preview.
            started, now: [s] when work on it began and ended.
            answered: False if a service did not answer; the preview is then tried again.
        """
        self.shown = inputs
        self._retry_at = None if answered else now + RETRY_DELAY
        self._not_before = max(started + PREVIEW_PERIOD, now + (now - started) * (1.0 / MAX_TIME_SHARE - 1.0))


class DrawingWarnings:
    """Collects the reasons to doubt a drawing from the notices. Not thread safe.

    While a camera has an error, what it sees is missing from the line or misplaced, and remains so when the camera
    works again. Therefore a camera's error makes the drawing doubtful until the interaction ends.
    """

    def __init__(self) -> None:
        self._current: Tuple[Notice, ...] = ()
        self._failed_cameras: Set[str] = set()  # all that had an error since the drawing began

    def start(self) -> None:
        """Begins another interaction, which is not concerned by errors that were over before."""
        self._failed_cameras = self._faulty_cameras()

    def update(self, notices: Sequence[Notice]) -> None:
        """Stores those of all current notices that concern the drawing."""
        self._current = tuple(
            notice
            for notice in notices
            if notice.code in DOUBTS or (notice.camera and notice.severity is Severity.ERROR)
        )
        self._failed_cameras |= self._faulty_cameras()

    @property
    def all(self) -> Tuple[Notice, ...]:
        """The current warnings, then one for each camera whose error is over."""
        recovered = sorted(self._failed_cameras - self._faulty_cameras())
        return self._current + tuple(
            Notice("camera_failed_meanwhile", Severity.WARNING, camera=camera, values={"camera": camera})
            for camera in recovered
        )

    def _faulty_cameras(self) -> Set[str]:
        return {notice.camera for notice in self._current if notice.camera}
