"""Weekly times at which a border is in force, for instance "mon-fri 08:00-12:00; sat 10:00-11:00"."""

from __future__ import annotations

import datetime
import re
from functools import lru_cache
from typing import List, NamedTuple, Tuple

from vb_map_integration.borders.issues import IntegrationError

DAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")
_PART = re.compile(r"(?:([a-z]{3}(?:-[a-z]{3})?(?:,[a-z]{3}(?:-[a-z]{3})?)*|daily) )?(\d\d?):(\d\d)-(\d\d?):(\d\d)")
_DAY, _WEEK = 24 * 60, 7 * 24 * 60


class WeeklyInterval(NamedTuple):
    """A part of the week in minutes after Monday 00:00; the end, which is not part of it, may be in the next week."""

    start: int
    end: int


@lru_cache(maxsize=1024)
def parse_schedule(text: str) -> Tuple[WeeklyInterval, ...]:
    """Parses a schedule into its spans; none for an empty one.

    Days are mon .. sun, lists ("mon,wed") and ranges ("sat-mon"), or "daily", which may be left out. An end at or
    before the start is on the next day: "daily 22:00-06:00".

    Raises:
        IntegrationError: "bad_schedule".
    """
    spans: List[WeeklyInterval] = []
    if not isinstance(text, str) or len(text) > 500:
        raise IntegrationError("bad_schedule", text=str(text)[:50])
    for part in filter(None, (part.strip().lower() for part in text.split(";"))):
        found = _PART.fullmatch(" ".join(part.replace(", ", ",").split()))
        if found is None:
            raise IntegrationError("bad_schedule", text=part)
        hour, minute, end_hour, end_minute = (int(value) for value in found.groups()[1:])
        start, end = 60 * hour + minute, 60 * end_hour + end_minute
        if start >= _DAY or end > _DAY or minute > 59 or end_minute > 59:
            raise IntegrationError("bad_schedule", text=part)
        for day in _days(found.group(1) or "daily", part):
            spans.append(WeeklyInterval(day * _DAY + start, day * _DAY + end + (_DAY if end <= start else 0)))
    return tuple(spans)


def _days(text: str, part: str) -> List[int]:
    if text == "daily":
        return list(range(7))
    days: List[int] = []
    for piece in text.split(","):
        first, _, last = piece.partition("-")
        if first not in DAYS or (last and last not in DAYS):
            raise IntegrationError("bad_schedule", text=part)
        start = DAYS.index(first)
        days += [(start + k) % 7 for k in range((DAYS.index(last or first) - start) % 7 + 1)]
    return days


def is_scheduled(text: str, now: float) -> bool:
    """Returns whether a schedule covers a time [s, since 1970], in the computer's time zone; an empty one always does."""
    spans = parse_schedule(text)
    if not spans:
        return True
    local = datetime.datetime.fromtimestamp(now)
    minute = local.weekday() * _DAY + local.hour * 60 + local.minute
    if any(span.start <= moment < span.end for span in spans for moment in (minute, minute + _WEEK)):
        return True
    # what the clock left out when it was put forward is made up for: a border that would begin in it begins after it
    before = datetime.datetime.fromtimestamp(now - 3600.0)
    skipped = (local - before).total_seconds() - 3600.0
    return skipped > 0.0 and any(
        span.start <= moment - 60 < span.end for span in spans for moment in (minute, minute + _WEEK)
    )
