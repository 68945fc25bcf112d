"""The database on disk: nothing acknowledged is lost or moved, and every repair is reported."""

import datetime
import shutil
import signal
import subprocess
import sys
import threading
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from integrators import GRID, integrator, square
from refusals import refused
from vb_core import files
from vb_core.errors import CodedError
from vb_map_integration.storage import border_database as module
from vb_map_integration.storage import durable_values
from vb_map_integration.storage.durable_values import FILE, DurableValues
from vb_map_integration.map_integrator import MapIntegrator

HERE = Path(__file__).parent


def codes(keeper):
    return [notice.code for notice in keeper.notices]


def again(restart):
    """Restarts the integrator and returns its borders and the codes of its notices."""
    keeper = restart()
    return keeper.borders, codes(keeper)


def closed(restart, count=3):
    """Adds borders, closes the database and returns the borders."""
    with closing(restart()) as keeper:
        for number in range(count):
            keeper.add(square(10 + 25 * number, 10, name=f"number {number}"), 1.0 + number)
    return keeper.borders


def test_the_history_is_bounded(monkeypatch):
    monkeypatch.setattr(module, "MAX_CHANGES", 5)
    keeper = integrator(borders=[square(10 + number, 10) for number in range(9)])
    for _ in range(5):
        keeper.undo()
    with refused("nothing_to_undo"):
        keeper.undo()
    assert len(keeper.borders) == 4


def test_a_second_integrator_is_refused(restart, tmp_path, monkeypatch):
    """Otherwise both hand out the id b1, and one border is gone after a restart."""
    monkeypatch.setattr(durable_values, "LOCK_TIMEOUT", 0.1)
    first = restart()
    with refused("database_in_use"):
        MapIntegrator(tmp_path)
    first.add(square(10, 10), 1.0)
    assert again(restart) == (first.borders, [])


def test_a_repeated_request_is_carried_out_once(restart):
    first = restart()
    assert first.add(square(10, 10), 1.0, request_id="r1").ids == ("b1",)
    second = restart()
    assert second.add(square(10, 10), 2.0, request_id="r1").ids == ("b1",)
    assert second.add(square(10, 10), 2.0, request_id="r2").ids == ("b2",)
    assert len(second.borders) == 2
    second.undo("u1")
    third = restart()
    assert (third.undo("u1").ids, [border.id for border in third.borders]) == (("b2",), ["b1"])
    third.redo("r3")
    assert (third.redo("r3").ids, len(third.borders)) == (("b2",), 2)


def command(keeper, number):
    """Carries out change `number` of an endless sequence, which is the same each time."""
    if number % 5 == 3:
        keeper.undo()
    elif number % 7 == 4 and keeper.borders:
        keeper.remove(keeper.borders[0].id)
    else:
        keeper.add(square(5 + number % 100, 5 + number % 60), float(number), request_id=f"n{number}")


WRITER = """
import sys
from pathlib import Path
from test_border_database import command, integrator
keeper = integrator(Path(sys.argv[1]))
while True:
    command(keeper, keeper.revision)
    print(keeper.revision, flush=True)
"""


def test_a_kill_at_any_moment_loses_nothing_that_was_answered(restart, tmp_path):
    random = np.random.default_rng(1)
    for _ in range(3):
        process = subprocess.Popen([sys.executable, "-c", WRITER, tmp_path], stdout=subprocess.PIPE, cwd=HERE)
        for _ in range(random.integers(2, 20)):
            said = int(process.stdout.readline())
        threading.Event().wait(random.uniform(0.0, 0.01))  # at any moment of a change
        process.send_signal(signal.SIGKILL)
        rest = process.communicate()[0].split()
        said = int(rest[-1]) if rest else said
        with closing(restart()) as keeper:
            assert said <= keeper.revision <= said + 1
            assert codes(keeper) == []


# the disk is full after the borders were stored
FULL_DISK = """
import resource, signal, sys
from pathlib import Path
from integrators import integrator, square
from vb_core.errors import CodedError
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.RLIM_INFINITY))
keeper = integrator(Path(sys.argv[1]))
for number in range(3):
    try:
        keeper.add(square(50, 50), 2.0)
        print("taken")
    except CodedError as error:
        print(error.code, *(key for key, status in keeper.borders_in_force.statuses.items() if status.is_in_force))
"""


@pytest.mark.parametrize("size", [0, 1000])
def test_on_a_full_disk_borders_act_and_each_change_is_refused(restart, tmp_path, size):
    """Otherwise the addition is acknowledged, and the border vanishes later."""
    borders = closed(restart, 2)
    command = [sys.executable, "-c", FULL_DISK, str(tmp_path), str(size)]
    done = subprocess.run(command, stdout=subprocess.PIPE, universal_newlines=True, check=True, cwd=HERE)
    assert done.stdout.splitlines() == ["cannot_write b1 b2"] * 3
    assert (again(restart), list(tmp_path.glob(".borders*"))) == ((borders, []), [])


def test_an_unusable_folder_refuses_borders_but_not_the_map(tmp_path):
    """Otherwise borders that cannot be stored are accepted, and vanish."""
    (tmp_path / "file").write_text("")
    with closing(integrator(tmp_path / "file" / "store")) as keeper:
        has_plain_map = np.array_equal(keeper.map_with_borders.data, GRID.data)
        assert (has_plain_map, codes(keeper)) == (True, ["database_read_only"])
        with refused("cannot_write"):
            keeper.add(square(10, 10), 1.0)
        assert keeper.borders == ()
        (tmp_path / "file").unlink()
        assert (keeper.add(square(10, 10), 1.0).ids, codes(keeper)) == (("b1",), [])


def test_a_repair_that_cannot_be_written_is_said_until_it_can(restart, tmp_path, monkeypatch):
    borders = closed(restart, 2)
    (tmp_path / FILE).write_bytes(b"?")

    def fail(*_):
        raise CodedError("cannot_write", what="", reason="disk is full")

    with monkeypatch.context() as full:
        full.setattr(files, "write_together", fail)
        keeper = restart()
    assert (keeper.borders, codes(keeper)) == (borders, ["database_repaired", "database_read_only"])
    keeper.undo()
    assert codes(keeper) == ["database_repaired"]
    assert again(restart) == (keeper.borders, [])


@pytest.mark.parametrize("damage", ["truncated", "empty", "binary", "gone", "edited", "newer"])
def test_a_damaged_file_is_restored_from_the_copy_and_reported(restart, tmp_path, damage):
    borders = closed(restart)
    path, content = tmp_path / FILE, (tmp_path / FILE).read_bytes()
    damaged = {
        "truncated": content[: len(content) * 2 // 3],
        "empty": b"",
        "binary": bytes(range(256)) * 40,
        "edited": content.replace(b'"occupancy":1.0', b'"occupancy":0.1'),
        "newer": content.replace(b"[1,", b"[2,").replace(b"[1, ", b"[2, "),  # its checksum does not match
    }
    if damage == "gone":
        path.unlink()
    else:
        assert damaged[damage] != content
        path.write_bytes(damaged[damage])
    assert again(restart) == (borders, ["database_repaired"])
    assert (again(restart), path.read_bytes()) == ((borders, []), content)
    kept = [damaged[damage]] if damaged.get(damage) is not None else []
    assert [path.read_bytes() for path in tmp_path.glob("*.damaged")] == kept


def days(folder, *dates):
    """Writes values that change once on each of these days."""
    day = [datetime.date(2026, 1, 1)]
    with closing(DurableValues(folder, today=lambda: day[0])) as values:
        for number, date in enumerate(dates):
            day[0] = datetime.date(*map(int, date.split("-")))
            values.write({"x/y": number})


def test_the_newest_sound_copy_is_used_and_the_loss_reported(tmp_path):
    """A copy of an empty database with a date in 2036 must not win over one with 21 borders."""
    days(tmp_path, "2026-01-01", "2036-01-01", "2026-01-02", "2026-01-03")
    for path in (tmp_path / FILE, tmp_path / "copies" / "borders-2026-01-03.jsonl"):
        path.write_bytes(b"?" * 9000)
    with closing(DurableValues(tmp_path)) as values:
        notice = values.notices[0]
        assert (values.get("x/y"), notice.code, notice.values["date"]) == (2, "borders_lost_since", "2026-01-02")
    (tmp_path / FILE).write_bytes(b"?" * 9000)
    shutil.rmtree(str(tmp_path / "copies"))
    with closing(DurableValues(tmp_path)) as values:
        assert (values.values_of_kind("x"), [notice.code for notice in values.notices]) == ({}, ["borders_lost"])


def test_the_copies_are_those_of_the_last_days(tmp_path, monkeypatch):
    monkeypatch.setattr(durable_values, "MAX_COPIES", 3)
    days(tmp_path, *(f"2026-01-0{1 + number // 2}" for number in range(12)), "1970-01-01")
    names = [path.name[8:18] for path in sorted((tmp_path / "copies").iterdir())]
    assert names == ["1970-01-01", "2026-01-05", "2026-01-06"]  # even after the clock was reset
    shutil.copyfile(str(tmp_path / "copies" / "borders-2026-01-05.jsonl"), str(tmp_path / FILE))
    with closing(DurableValues(tmp_path)) as values:  # a copy is restored by replacing the file with it
        assert (values.get("x/y"), values.notices) == (9, [])  # as at the end of that day


def test_a_copy_restored_by_hand_outranks_later_copies(tmp_path):
    """Otherwise, if the file is damaged a day later, the discarded state comes back instead."""
    days(tmp_path, "2026-01-01", "2026-01-02", "2026-01-02")
    shutil.copyfile(str(tmp_path / "copies" / "borders-2026-01-01.jsonl"), str(tmp_path / FILE))
    days(tmp_path)
    (tmp_path / FILE).write_bytes(b"?")
    with closing(DurableValues(tmp_path)) as values:
        assert values.get("x/y") == 0
        assert values.revision > 3


def test_a_start_puts_its_days_copy_right(restart, tmp_path):
    before = closed(restart)
    (copy,) = (tmp_path / "copies").iterdir()
    copy.write_bytes(b"?")
    assert again(restart) == (before, [])
    (tmp_path / FILE).write_bytes(b"?")
    assert again(restart) == (before, ["database_repaired"])


def test_a_database_of_a_newer_version_is_refused_and_left_alone(restart, tmp_path, monkeypatch):
    """Otherwise it is taken for damaged and set aside, and all borders are gone."""
    with monkeypatch.context() as newer:
        newer.setattr(durable_values, "FORMAT", 2)
        closed(restart)
    before = {path: path.read_bytes() for path in tmp_path.glob("borders*")}
    for _ in range(2):  # the lock is released each time
        with refused("database_newer"):
            DurableValues(tmp_path)
    assert {path: path.read_bytes() for path in tmp_path.glob("borders*")} == before


@pytest.mark.parametrize("fault", ["deleted", "overwritten"])
def test_files_lost_at_run_time_return_with_the_next_change(restart, tmp_path, fault):
    """Otherwise an addition is acknowledged, and after a restart no border is there."""
    keeper = restart(borders=[square(10, 10)])
    if fault == "deleted":
        shutil.rmtree(str(tmp_path))
    else:
        for path in tmp_path.rglob("borders*.jsonl"):
            path.write_bytes(b"?" * 9000)
    assert keeper.add(square(50, 50), 2.0).ids == ("b2",)
    assert again(restart) == (keeper.borders, [])


def test_with_the_lock_deleted_the_second_integrator_takes_over(restart, tmp_path):
    """Otherwise both hand out the id b1."""
    first = integrator(tmp_path)
    (tmp_path / "borders.lock").unlink()
    second = restart()
    assert second.add(square(10, 10), 1.0).ids == ("b1",)
    for _ in range(2):
        with refused("database_in_use"):
            first.add(square(50, 50), 1.0)
        assert first.borders == ()
    assert again(restart) == (second.borders, [])


def test_a_refused_change_is_not_back_after_a_restart(restart, monkeypatch):
    """The file has been replaced, but then replacing its copy fails."""
    before = closed(restart)
    keeper, replace, left = restart(), files.os.replace, [1]

    def fail_once(source, target):
        if "copies" in target and left:
            left.pop()
            raise OSError(5, "Input/output error")
        replace(source, target)

    monkeypatch.setattr(files.os, "replace", fail_once)
    with refused("cannot_write"):
        keeper.add(square(10, 60, name="refused"), 9.0)
    assert not left
    assert again(restart) == (before, [])


@pytest.mark.parametrize("copies", [True, False])
def test_a_file_that_cannot_be_read_now_is_not_damaged(restart, tmp_path, monkeypatch, copies):
    before, read = closed(restart), Path.read_bytes

    def refuse(path):
        if path.name == FILE or not copies:
            raise PermissionError(13, "Permission denied", str(path))
        return read(path)

    with monkeypatch.context() as context:
        context.setattr(Path, "read_bytes", refuse)
        if copies:
            keeper = restart()
            assert keeper.borders == before
        else:
            with refused("cannot_read"):
                restart()
    assert (again(restart), list(tmp_path.glob("*.damaged"))) == ((before, []), [])


@pytest.mark.parametrize("written", [0, 1, 2])
def test_an_answer_about_the_place_is_atomic(restart, monkeypatch, written):
    """The disk is full after `written` writes: the answer is stored as a whole or not at all."""
    keeper = restart(borders=[square(10, 10)])
    other = GRID.with_data(np.roll(GRID.data, 1, axis=0))
    keeper.set_map(other)
    before, write, count = (keeper.borders, keeper.map_name), files.write_together, []

    def fill(*arguments):
        count.append(1)
        if len(count) > written:
            raise CodedError("cannot_write", what="x", reason="No space left on device")
        write(*arguments)

    taken = True
    with monkeypatch.context() as context:
        context.setattr(files, "write_together", fill)
        try:
            keeper.confirm(False, "attic")
        except CodedError:
            taken = False
    after = keeper.borders, keeper.map_name
    assert after == (((), "attic") if taken else before)
    second = restart(None)
    second.set_map(other)
    assert (second.borders, second.map_name) == after
