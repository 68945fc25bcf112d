"""What the display says beside the last answer: what saving would do, a robot in a border, a spot nobody sees."""
from __future__ import annotations

from dataclasses import dataclass
from typing import List, Optional, Sequence, Tuple

from vb_core.grid_map import GridMap
from vb_feedback.words import Notice


@dataclass(frozen=True)
class Preview:
    """What saving now would do.

    Attributes:
        findings: (whether it is an error, sentence) of each.
    """

    success: bool
    message: str = ""
    findings: Tuple[Tuple[bool, str], ...] = ()
    area_m2: float = 0.0


def of_preview(preview: Optional[Preview]) -> List[Notice]:
    """Why save would be refused, or what it would restrict and what to mind."""
    if preview is None:
        return []
    if not preview.success:
        errors = [text for is_error, text in preview.findings if is_error]
        return [Notice(f"Save would be refused: {(errors or [preview.message])[0]}", warning=True)]
    notices = [Notice(f"Save would restrict {preview.area_m2:.2f} m2.")]
    warnings = [text for is_error, text in preview.findings if not is_error]
    if warnings:
        notices.append(Notice(f"Mind: {warnings[0]}", warning=True))
    return notices


class Workspace:
    """What the workspace monitor says: a robot in a border until it has left, anything else for a while.

    Args:
        linger_s: [s] how long a sentence about something that is over stays.
    """

    def __init__(self, linger_s: float) -> None:
        self._linger_s = linger_s
        self._standing = ""
        self._passing = ""
        self._since = 0.0

    def hear(self, sentence: str, now: float) -> None:
        """A sentence of the monitor at a time [s]; an empty one: all is well."""
        if not sentence:
            self._standing = self._passing = ""
            return
        sentence = sentence[:1].upper() + sentence[1:].rstrip(".") + "."
        if " is inside " in sentence or " touches " in sentence:
            self._standing, self._passing = sentence, ""
            return
        if " has left " in sentence:
            self._standing = ""
        self._passing, self._since = sentence, now

    def notices(self, now: float) -> List[Notice]:
        """What is to be said at a time [s]; time may jump back."""
        found = [Notice(self._standing, warning=True)] if self._standing else []
        if self._passing and 0.0 <= now - self._since <= self._linger_s:
            found.append(Notice(self._passing, warning=" has left " not in self._passing))
        return found


# [m] the spot that was lost so near to floor that no camera sees has gone there
_NEAR = 0.6


def of_spot(
    state: str, seeing: Sequence[str], lost: Optional[Tuple[float, float]], coverage: Optional[GridMap], robots: bool
) -> List[Notice]:
    """What is said while spots are wanted and none is seen.

    Args:
        state: the interaction's.
        seeing: the cameras that see the spot.
        lost: (x, y) [m] where the spot was seen last; None if that is only a moment ago, or never was.
        coverage: how many stationary cameras see each cell; None if that is not known.
        robots: whether there is a robot that can be sent.
    """
    if state not in ("border", "seed") or seeing or lost is None:
        return []
    if coverage is None:
        return [Notice("No camera sees a spot. Keep pointing: a robot comes." if robots else "No camera sees a spot.")]
    if _sees_all(coverage, lost):
        # it was switched off
        return []
    comes = "a robot will be sent" if robots else "draw where a camera sees it"
    return [Notice(f"No camera sees this place: {comes}.", warning=True)]


def _sees_all(coverage: GridMap, place: Tuple[float, float]) -> bool:
    """Whether stationary cameras see all the floor about a place."""
    row, column = coverage.world_to_cell([place])[0]
    reach = int(round(_NEAR / coverage.resolution))
    rows = slice(max(0, row - reach), max(0, row + reach + 1))
    part = coverage.data[rows, max(0, column - reach) : max(0, column + reach + 1)]
    return bool(part.size) and not bool((part == 0).any())
