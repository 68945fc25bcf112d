"""The notices about a map and the borders on it."""

from __future__ import annotations

import time
from typing import Dict, Iterable, List, Sequence

from vb_core.notices import Notice, Severity
from vb_map_integration.border import VirtualBorder
from vb_map_integration.in_force import Verdict

_NAMED = 3  # borders by which a place is described


def find_notices(verdicts: Sequence[Verdict], is_certain: bool, place: str) -> List[Notice]:
    """Finds what people should know about a map, and about borders that are not what they were on it.

    Args:
        is_certain: whether it is known which place the map shows.
        place: its name; "" if it has none.
    """
    notices = []
    waiting = [one.border for one in verdicts if one.can_be_confirmed]
    if not is_certain:
        values = {"count": str(len(verdicts)), **_describe_place(place, [one.border for one in verdicts])}
        notices.append(Notice("borders_unconfirmed", Severity.WARNING, values=values))
    elif waiting:
        values = {"count": str(len(waiting)), "borders": _names(waiting)}
        notices.append(Notice("borders_to_confirm", Severity.WARNING, values=values))
    return notices + [
        Notice(one.code, Severity.WARNING, border_id=one.border.id, values=one.values) for one in verdicts if one.code
    ]


def _describe_place(name: str, borders: Iterable[VirtualBorder]) -> Dict[str, str]:
    """Describes a place to people: by the name that they gave it, else by its borders and their date."""
    if name:
        return {"place": "$find_place", "map": name}
    drawn = sorted(borders, key=lambda border: border.created)
    if not drawn:
        return {"place": "$place_before"}
    date = time.strftime("%Y-%m-%d", time.localtime(drawn[0].created))
    return {"place": "$place_of_borders", "borders": _names(drawn), "date": date}


def _names(borders: Sequence[VirtualBorder]) -> str:
    """Names the first of some borders."""
    return ", ".join(border.name for border in borders[:_NAMED]) + (", ..." if len(borders) > _NAMED else "")
