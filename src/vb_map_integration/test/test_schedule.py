"""When a schedule is in force, against a calendar, and which texts are none."""

import datetime
import time

import pytest

from refusals import refused
from vb_map_integration.borders.schedule import is_scheduled, parse_schedule

MONDAY = datetime.datetime(2026, 11, 23)
# by schedule, the hours of the week in which it is in force: (day, first hour, hour after the last)
IN_FORCE = {
    "": [(0, 0, 168)],
    "daily 08:00-12:00": [(day, 8, 12) for day in range(7)],
    "08:00-12:00": [(day, 8, 12) for day in range(7)],
    "mon-fri 08:00-12:00; sat 22:00-02:00": [*((day, 8, 12) for day in range(5)), (5, 22, 26)],
    "wed 10:00-11:00": [(2, 10, 11)],
    "tue, thu-fri 10:00-11:00": [(1, 10, 11), (3, 10, 11), (4, 10, 11)],
    "sat-mon 10:00-24:00": [(5, 10, 24), (6, 10, 24), (0, 10, 24)],
    "sun 22:00-02:00": [(6, 22, 26), (-1, 22, 26)],
    "fri 06:00-06:00": [(4, 6, 30)],
}


@pytest.mark.parametrize("text", IN_FORCE, ids=lambda text: text or "none")
def test_a_schedule_is_in_force_in_its_hours_and_in_no_other(text):
    hours = {24 * day + hour for day, first, end in IN_FORCE[text] for hour in range(first, end)}
    for hour in range(168):
        for minute in (0, 59):
            moment = MONDAY + datetime.timedelta(hours=hour, minutes=minute)
            assert is_scheduled(text, moment.timestamp()) == (hour in hours), moment


@pytest.mark.parametrize(
    "text",
    [
        "mon 8-12",
        "xyz 08:00-09:00",
        "mon-xyz 08:00-09:00",
        "mon 24:00-01:00",
        "mon 23:00-24:01",
        "08:60-09:00",
        "08:00-08:60",
        "mon 08:00-09:00;" * 32,
        800,
    ],
)
def test_what_is_no_schedule_is_refused_in_few_words(text):
    with refused("bad_schedule") as caught:
        parse_schedule(text)
    assert str(text).startswith(caught.value.values["text"])
    assert 0 < len(caught.value.values["text"]) <= 50


@pytest.fixture
def summer_time(monkeypatch):
    monkeypatch.setenv("TZ", "Europe/Berlin")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


@pytest.mark.parametrize("day", ["2026-03-29", "2026-10-25", "2026-11-23"])
def test_a_scheduled_hour_is_never_left_out(summer_time, day):
    """On the night on which the clock is put forward, "daily 02:00-03:00" was in force for no minute."""
    start = datetime.datetime.fromisoformat(day).timestamp()
    minutes = [number for number in range(8 * 60) if is_scheduled("daily 02:00-03:00", start + 60.0 * number)]
    assert len(minutes) == (120 if day == "2026-10-25" else 60)  # in autumn the clock shows the hour twice
    assert minutes == list(range(minutes[0], minutes[-1] + 1))
    assert not any(is_scheduled("daily 05:00-06:00", start + 60.0 * number) for number in range(4 * 60))
