"""What is kept on the disk: nothing that was acknowledged is lost or moved, and what was repaired is said."""

import datetime
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from vb_core import sentences
from vb_core.errors import CodedError
from vb_map_integration.storage import database as module
from vb_map_integration.storage import sqlite_files as files
from vb_map_integration.storage import database_files
from vb_map_integration.storage.database import Database
from vb_map_integration.storage.database_files import FILE
from vb_map_integration.integrator import IntegratorParams, MapIntegrator

from integrators import GRID, integrator, square


def codes(keeper):
    return [notice.code for notice in keeper.notices]


def again(tmp_path):
    """The borders and what is said after a restart."""
    keeper = integrator(tmp_path)
    found = keeper.borders, codes(keeper)
    keeper.close()
    return found


def closed(tmp_path, count=3):
    """The borders of a database that was used and closed."""
    keeper = integrator(tmp_path)
    for number in range(count):
        keeper.add(square(10 + 25 * number, 10, name=f"number {number}"), 1.0 + number)
    keeper.close()
    return keeper.borders


def test_a_border_that_nobody_named_is_shown_in_the_readers_language(tmp_path):
    keeper = integrator(tmp_path)
    keeper.add(square(10, 10), 1.0)
    assert sentences.border_name(keeper.borders[0].name, "de") == "Grenze 1"
    keeper.close()


def test_borders_come_back_after_a_restart(tmp_path):
    first = integrator(tmp_path)
    first.add(square(10, 10, name="kitchen", robots=("ada",)), 1.0)
    first.add(square(60, 10, occupancy=0.3), 2.0)
    first.remove("b2")
    first.close()
    second = integrator(tmp_path)
    assert second.borders == first.borders and second.revision == first.revision and codes(second) == []
    assert np.array_equal(second.map_with_borders.data, first.map_with_borders.data)
    assert second.add(square(30, 50), 4.0).ids == ("b3",)  # ids are never used twice
    second.close()


def test_undo_and_redo_survive_a_restart(tmp_path):
    first = integrator(tmp_path)
    first.add(square(10, 10), 1.0)
    first.add(square(60, 10), 2.0)
    first.remove("b1")
    first.undo()
    first.close()
    second = integrator(tmp_path)
    assert second.available_commands == ["undo", "redo"]
    assert second.redo().ids == ("b1",) and [border.id for border in second.borders] == ["b2"]
    second.undo()
    second.close()
    third = integrator(tmp_path)
    third.undo()
    third.undo()
    assert third.borders == () and third.available_commands == ["redo"]
    third.close()
    fourth = integrator(tmp_path)
    for expected in (["b1"], ["b1", "b2"], ["b2"]):
        fourth.redo()
        assert [border.id for border in fourth.borders] == expected
    with pytest.raises(CodedError) as caught:
        fourth.redo()
    assert caught.value.code == "nothing_to_redo" and fourth.available_commands == ["undo"]
    fourth.close()


def test_the_history_is_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "MAX_CHANGES", 5)
    keeper = integrator(check_reachability=False)
    for number in range(9):
        keeper.add(square(10 + number, 10), 1.0 + number)
    for _ in range(5):
        keeper.undo()
    with pytest.raises(CodedError) as caught:
        keeper.undo()
    assert caught.value.code == "nothing_to_undo" and len(keeper.borders) == 4


def test_a_change_that_could_not_be_written_is_refused_and_nothing_is_kept(tmp_path, monkeypatch):
    """Was answered as success, and the border vanished later."""
    keeper = integrator(tmp_path)
    keeper.add(square(10, 10), 1.0)
    cells = keeper.map_with_borders.data.copy()
    size = sum(path.stat().st_size for path in tmp_path.glob(f"{FILE}*"))
    # as on a full disk: no file may grow any more
    code = f"""
import resource, signal, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from pathlib import Path
from integrators import integrator, square
from vb_core.errors import CodedError
keeper = integrator(Path({str(tmp_path)!r}))
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, resource.RLIM_INFINITY))
for number in range(3):
    try:
        keeper.add(square(50, 50), 2.0)
        print("taken")
    except CodedError as error:
        print(error.code, len(keeper.borders))
"""
    keeper.close()
    done = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, universal_newlines=True, check=True)
    assert done.stdout.split() == ["cannot_write", "1"] * 3
    second = integrator(tmp_path)
    assert second.borders == keeper.borders and np.array_equal(second.map_with_borders.data, cells)
    assert size > 4096 and codes(second) == []
    second.close()


def test_with_a_full_disk_at_start_borders_act_and_no_change_is_taken(tmp_path):
    borders = closed(tmp_path, 2)
    code = f"""
import resource, signal, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from pathlib import Path
from integrators import integrator, square
from vb_core.errors import CodedError
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))
keeper = integrator(Path({str(tmp_path)!r}))
try:
    keeper.add(square(50, 50), 2.0)
except CodedError as error:
    acting = [border.id for border in keeper.borders if keeper.status(border)[0]]
    print(error.code, *acting, *(notice.code for notice in keeper.notices))
"""
    done = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, universal_newlines=True, check=True)
    assert done.stdout.split() == ["cannot_write", "b1", "b2", "database_read_only"]
    assert again(tmp_path) == (borders, [])


def test_a_schedule_is_followed_on_a_full_disk_too(tmp_path, monkeypatch):
    start = datetime.datetime(2026, 11, 23, 7, 59).timestamp()  # a Monday
    keeper = MapIntegrator(IntegratorParams(), tmp_path)
    keeper.set_map(GRID, start)
    keeper.add(square(10, 10, schedule="mon 08:00-12:00"), start)

    def fail(*_):
        raise sqlite3.OperationalError("disk is full")

    monkeypatch.setattr(files, "run", fail)
    assert keeper.follow_schedules(start + 1.0) == () and not keeper.status(keeper.borders[0])[0]
    assert keeper.follow_schedules(start + 60.0) == keeper.borders and keeper.status(keeper.borders[0]) == (True, "")
    assert (keeper.map_with_borders.data == 100).sum() > (GRID.data == 100).sum()
    keeper.close()


def test_with_a_folder_that_cannot_be_used_the_map_comes_and_no_border_is_taken(tmp_path):
    """Borders that could not be kept were taken, and vanished."""
    (tmp_path / "file").write_text("")
    keeper = integrator(tmp_path / "file" / "store")
    assert np.array_equal(keeper.map_with_borders.data, GRID.data) and "database_read_only" in codes(keeper)
    with pytest.raises(CodedError) as caught:
        keeper.add(square(10, 10), 1.0)
    assert caught.value.code == "cannot_write" and keeper.borders == ()
    assert not keeper.reopen()
    (tmp_path / "file").unlink()
    assert keeper.reopen() and codes(keeper) == [] and not keeper.reopen()
    assert keeper.add(square(10, 10), 1.0).ids == ("b1",)
    keeper.close()


def test_a_disk_that_can_be_written_again_keeps_the_borders_that_acted(tmp_path, monkeypatch):
    borders = closed(tmp_path, 2)

    def fail(_):
        raise OSError("No space left on device")

    with monkeypatch.context() as full:
        full.setattr(files, "try_to_write", fail)
        keeper = integrator(tmp_path)
        assert keeper.borders == borders and not keeper.reopen()
    cells = keeper.map_with_borders.data.copy()
    assert keeper.reopen() and keeper.borders == borders and np.array_equal(keeper.map_with_borders.data, cells)
    assert keeper.undo().ids
    keeper.close()


def test_a_second_integrator_is_refused(tmp_path, monkeypatch):
    """Both gave the id b1, and one border was gone after a restart."""
    monkeypatch.setattr(database_files, "LOCK_TIMEOUT", 0.1)
    first = integrator(tmp_path)
    with pytest.raises(CodedError) as caught:
        MapIntegrator(IntegratorParams(), tmp_path)
    assert caught.value.code == "database_in_use"
    first.add(square(10, 10), 1.0)
    first.close()
    assert again(tmp_path) == (first.borders, [])


def test_a_repeated_request_adds_one_border(tmp_path):
    first = integrator(tmp_path)
    assert first.add(square(10, 10), 1.0, request_id="r1").ids == ("b1",)
    first.close()
    second = integrator(tmp_path)
    assert second.add(square(10, 10), 2.0, request_id="r1").ids == ("b1",)
    assert second.add(square(10, 10), 2.0, request_id="r2").ids == ("b2",)
    assert len(second.borders) == 2
    second.close()


def command(keeper, number):
    """One of an endless row of changes, the same ones each time."""
    if number % 5 == 3:
        keeper.undo()
    elif number % 7 == 4 and keeper.borders:
        keeper.remove(keeper.borders[0].id)
    else:
        keeper.add(square(5 + number % 100, 5 + number % 60), float(number), request_id=f"n{number}")


WRITER = """
import sys
sys.path.insert(0, {test!r})
from pathlib import Path
from test_database import command, integrator
keeper = integrator(Path({root!r}), check_reachability=False)
while True:
    number = int(keeper._database.get_value("number") or 0)
    command(keeper, number)
    keeper._database.set_value("number", str(number + 1))
    print(keeper.revision, flush=True)
"""


def test_a_kill_at_any_moment_loses_nothing_that_was_answered(tmp_path):
    code = WRITER.format(test=str(Path(__file__).parent), root=str(tmp_path))
    random = np.random.default_rng(1)
    for _ in range(3):
        process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
        for _ in range(random.integers(2, 20)):
            said = int(process.stdout.readline())
        threading.Event().wait(random.uniform(0.0, 0.01))  # anywhere within a change
        process.send_signal(signal.SIGKILL)
        rest = process.communicate()[0].split()
        said = int(rest[-1]) if rest else said
        keeper = integrator(tmp_path, check_reachability=False)
        assert said <= keeper.revision <= said + 2 and codes(keeper) == []
        keeper.close()


@pytest.mark.parametrize("name", [FILE, "borders.twin.db"])
@pytest.mark.parametrize("damage", ["truncated", "empty", "binary", "gone", "edited"])
def test_a_damaged_file_is_repaired_and_reported(tmp_path, name, damage):
    borders = closed(tmp_path)
    path = tmp_path / name
    content = path.read_bytes()
    if damage == "gone":
        path.unlink()
    else:
        path.write_bytes(
            {
                "truncated": content[: len(content) * 2 // 3],
                "empty": b"",
                "binary": bytes(range(256)) * 40,
                "edited": content.replace(b'"occupancy":1.0', b'"occupancy":0.1'),
            }[damage]
        )
    found, said = again(tmp_path)
    assert found == borders
    expected = "database_repaired" if name == FILE else "replica_repaired"
    # a replica that is gone, or has not one table, is only written again
    assert said == [expected] or (name != FILE and damage in ("gone", "empty"))
    assert again(tmp_path) == (borders, [])


def test_any_single_damaged_byte_costs_nothing(tmp_path):
    """Of 110 single bytes in map.npz 32 ended every start, and others cost the borders without a word."""
    borders = closed(tmp_path / "sound")
    random = np.random.default_rng(3)
    for number in range(12):
        folder = tmp_path / str(number)
        shutil.copytree(str(tmp_path / "sound"), str(folder))
        path = sorted(path for path in folder.glob("*.db*") if path.stat().st_size)[number % 2]
        content = bytearray(path.read_bytes())
        place = random.integers(len(content))
        content[place] ^= int(random.integers(1, 256))
        path.write_bytes(bytes(content))
        assert again(folder)[0] == borders, (path, place)


def test_with_both_files_damaged_the_newest_copy_is_taken_and_the_loss_is_reported(tmp_path):
    borders = closed(tmp_path)
    keeper = integrator(tmp_path)
    keeper.add(square(10, 60), 9.0)  # later than the copy of the day
    keeper.close()
    for name in (FILE, "borders.twin.db"):
        (tmp_path / name).write_bytes(b"?" * 9000)
    found, said = again(tmp_path)
    assert found == borders and said == ["borders_lost_since"]  # the copy is as of the last start
    shutil.rmtree(str(tmp_path / "copies"))
    for name in (FILE, "borders.twin.db"):
        (tmp_path / name).write_bytes(b"?" * 9000)
    assert again(tmp_path) == ((), ["borders_lost"])


def test_a_copy_is_chosen_by_its_revision_and_not_by_its_date(tmp_path):
    """A copy of an empty database with a date in 2036 won over one with 21 borders."""
    (tmp_path / "empty").mkdir()
    integrator(tmp_path / "empty").close()
    borders = closed(tmp_path / "used")
    integrator(tmp_path / "used").close()  # the copy is as of the last start
    shutil.copyfile(str(tmp_path / "empty" / FILE), str(tmp_path / "used" / "copies" / "borders-2036-01-01.db"))
    for name in (FILE, "borders.twin.db"):
        (tmp_path / "used" / name).write_bytes(b"?" * 9000)
    assert again(tmp_path / "used") == (borders, ["borders_lost_since"])


def test_a_database_of_a_newer_version_is_refused_and_left_alone(tmp_path):
    """It was called damaged, set aside, and all borders were gone."""
    closed(tmp_path)
    for name in (FILE, "borders.twin.db"):
        connection = sqlite3.connect(str(tmp_path / name))
        connection.execute("PRAGMA user_version = 2")
        connection.close()
    for _ in range(2):  # the lock is given back
        with pytest.raises(CodedError) as caught:
            Database(tmp_path)
        assert caught.value.code == "database_newer"
    connection = sqlite3.connect(str(tmp_path / FILE))
    assert connection.execute("SELECT count(*) FROM borders").fetchone() == (3,)
    connection.close()
    assert not (tmp_path / "damaged").exists()


@pytest.mark.parametrize("command", ["add", "undo", "rename", "confirm"])
def test_a_database_overwritten_while_it_runs_is_an_error_with_a_code_and_repaired(tmp_path, command):
    """They failed with sqlite3.DatabaseError, which ended the thread that asked."""
    keeper = integrator(tmp_path)
    for number in range(3):
        keeper.add(square(10 + 25 * number, 10), 1.0 + number)
    borders = keeper.borders
    for name in (FILE, f"{FILE}-wal", f"{FILE}-shm"):
        (tmp_path / name).write_bytes(b"?" * 9000)
    actions = {
        "add": lambda: keeper.add(square(50, 50), 5.0),
        "undo": keeper.undo,
        "rename": lambda: keeper.rename("b1", "rug", 5.0),
        "confirm": lambda: keeper.confirm(True, "home", 5.0),
    }
    with pytest.raises(CodedError) as caught:
        actions[command]()
    assert caught.value.code in ("database_failed", "cannot_write") and keeper.borders == borders
    assert keeper.reopen(6.0) and codes(keeper) == ["database_repaired"] and keeper.borders == borders
    actions[command]()
    keeper.close()


def test_files_deleted_while_it_runs_are_written_again(tmp_path):
    """An addition was answered with success, and after a restart no border was there."""
    keeper = integrator(tmp_path)
    keeper.add(square(10, 10), 1.0)
    for path in tmp_path.glob("borders*"):
        path.unlink()
    with pytest.raises(CodedError) as caught:
        keeper.add(square(50, 50), 2.0)
    assert caught.value.code == "cannot_write" and len(keeper.borders) == 1
    assert keeper.reopen() and keeper.add(square(50, 50), 3.0).ids == ("b2",)
    found = keeper.borders
    keeper.close()
    assert again(tmp_path) == (found, [])


def test_with_the_lock_deleted_the_second_integrator_takes_over_and_the_first_one_ends(tmp_path, monkeypatch):
    """Both handed out the id b1."""
    monkeypatch.setattr(database_files, "LOCK_TIMEOUT", 0.1)
    first = integrator(tmp_path)
    (tmp_path / f"{FILE}.lock").unlink()
    second = integrator(tmp_path)
    assert second.add(square(10, 10), 1.0).ids == ("b1",)
    with pytest.raises(CodedError) as caught:
        first.add(square(50, 50), 1.0)
    assert caught.value.code == "cannot_write"
    with pytest.raises(CodedError) as caught:
        first.reopen()
    assert caught.value.code == "database_in_use"
    assert second.add(square(50, 50), 2.0).ids == ("b2",)
    second.close()
    assert len(again(tmp_path)[0]) == 2


def test_daily_copies_are_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(database_files, "MAX_COPIES", 3)
    day = [datetime.date(2026, 1, 1)]
    database = Database(tmp_path, today=lambda: day[0])
    for number in range(6):
        day[0] = datetime.date(2026, 1, 1 + number)
        database.set_value("x", str(number))
    assert [path.stem[-2:] for path in database.copies()] == ["06", "05", "04"]
    database.close()


def test_os_is_not_needed_for_memory_only():
    keeper = integrator()
    keeper.add(square(10, 10), 1.0)
    keeper.undo()
    assert keeper.borders == () and not os.path.exists(":memory:")


def test_a_copy_is_restored_by_putting_it_in_the_place_of_the_files(tmp_path):
    borders = closed(tmp_path, 2)
    keeper = integrator(tmp_path)  # each start renews the copy
    copy = next((tmp_path / "copies").glob("*.db")).read_bytes()
    keeper.remove("b1")
    keeper.close()
    for path in tmp_path.glob("borders*db*"):
        path.unlink()
    (tmp_path / FILE).write_bytes(copy)
    assert again(tmp_path) == (borders, [])
