"""The display's sentences beside the last answer: other nodes' notices, and a spot that no camera sees.

Everything comes as a code with values; the sentence is looked up in the display's language, and no wording is read.
"""

from __future__ import annotations

from typing import List, Optional, Sequence, Tuple

from vb_core import notices, sentences
from vb_core.grid_map import GridMap
from vb_core.vocabulary import STATES
from vb_feedback.display.text_panel import PanelNotice

# more sentences cannot be read from across the room, and letters would get too small
_MAX_NOTICES = 3
# codes of others that themselves say that no camera sees the spot, and what follows
_ABOUT_THE_SPOT = (
    "spot_not_seen_robot_looks",
    "spot_not_seen_no_robot",
    "floor_ahead_not_seen",
    "spot_not_seen_check_laser",
)


def select_others(held: Sequence[notices.Notice], language: str) -> List[PanelNotice]:
    """Selects other nodes' notices, the most severe first; each sentence once, and no more than can be read."""
    found: List[PanelNotice] = []
    for notice in held:
        shown = PanelNotice(notice.sentence(language), notice.severity >= notices.Severity.WARNING)
        if shown not in found:
            found.append(shown)
    return found[:_MAX_NOTICES]


# [m] the spot that was lost so near to floor that no camera sees has gone there
_NEAR = 0.6


def coverage_notices(
    state: str,
    cameras_seeing_spot: Sequence[str],
    lost: Optional[Tuple[float, float]],
    coverage: Optional[GridMap],
    robots: bool,
    held: Sequence[notices.Notice],
    language: str,
) -> List[PanelNotice]:
    """Returns why no spot is seen while spots are wanted.

    Args:
        state: the interaction's.
        cameras_seeing_spot: their names.
        lost: (x, y) [m] where the spot was seen last; None if that is only a moment ago, or never was.
        coverage: how many stationary cameras see each cell; None if that is not known.
        robots: whether there is a robot that can be sent.
        held: what other nodes say; the dispatcher and the interaction manager know better.
    """
    if state not in STATES or not STATES[state].collects or cameras_seeing_spot or lost is None:
        return []
    if any(notice.code in _ABOUT_THE_SPOT for notice in held):
        return []
    comes = "_robot_comes" if robots else ""
    if coverage is None:
        return [PanelNotice(sentences.translate("spot_not_seen" + comes, {}, language))]
    if _sees_all(coverage, lost):
        # it was switched off
        return []
    return [PanelNotice(sentences.translate("place_not_seen" + comes, {}, language), warning=True)]


def _sees_all(coverage: GridMap, place: Tuple[float, float]) -> bool:
    """Returns whether stationary cameras see all the floor about a place."""
    row, column = coverage.world_to_cell([place])[0]
    reach = int(round(_NEAR / coverage.resolution))
    rows = slice(max(0, row - reach), max(0, row + reach + 1))
    part = coverage.data[rows, max(0, column - reach) : max(0, column + reach + 1)]
    return bool(part.size) and not bool((part == 0).any())
