"""What is kept on the disk: borders, history, maps, recordings."""
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_map_integration import border_folders
from vb_map_integration.border import VirtualBorder
from vb_map_integration.border_files import borders_from_yaml, borders_to_yaml
from vb_map_integration.integrator import IntegratorParams, MapIntegrator
from vb_map_integration.journal import Journal
from vb_map_integration.map_files import read_map, safe_path, write_map
from vb_map_integration.recording import Recording
from vb_map_integration.store import BorderStore

sys.path.insert(0, str(Path(__file__).resolve().parent))
from keepers import GRID, at, integrator, square  # noqa: E402


def test_a_full_disk_refuses_and_changes_nothing(tmp_path, monkeypatch):
    keeper = integrator(tmp_path)
    keeper.add(square(10, 10), 1.0)
    cells = keeper.posterior.data.copy()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(CodedError) as caught:
        keeper.add(square(50, 50), 2.0)
    assert caught.value.code == "cannot_write"
    assert len(keeper.borders) == 1 and np.array_equal(keeper.posterior.data, cells)


def test_borders_come_back_after_a_restart(tmp_path):
    first = integrator(tmp_path)
    first.add(square(10, 10, name="kitchen", robots=("ada",)), 1.0)
    first.add(square(60, 10, occupancy=0.3), 2.0)
    first.remove("b2")
    first.add(VirtualBorder(at((80, 30), (80, 90)), at((120, 60))[0]), 3.0)
    second = integrator(tmp_path)
    assert second.borders == first.borders
    assert second.revision == first.revision
    assert np.array_equal(second.posterior.data, first.posterior.data)
    assert second.add(square(30, 50), 4.0).ids == ("b4",)  # ids are never used twice


@pytest.mark.parametrize("damage", ["truncated", "empty", "binary", "edited"])
def test_a_damaged_file_is_set_aside_and_the_backup_is_used(tmp_path, damage):
    first = integrator(tmp_path)
    first.add(square(10, 10), 1.0)
    first.add(square(60, 10), 2.0)
    path = next(tmp_path.glob("*/borders.yaml"))
    content = path.read_bytes()
    path.write_bytes({
        "truncated": content[: len(content) * 2 // 3], "empty": b"", "binary": bytes(range(256)),
        "edited": content.replace(b'"occupancy": 1.0', b'"occupancy": 0.1'),
    }[damage])
    second = MapIntegrator(IntegratorParams(), tmp_path)
    _, notes = second.set_map(GRID)
    assert "set aside" in notes[0]
    assert second.borders == first.borders  # the backup's, and what the journal says came after
    assert next(tmp_path.glob("*/borders.yaml.damaged*")).exists()
    second.add(square(60, 60), 3.0)
    assert integrator(tmp_path).borders == second.borders


def command(keeper, number):
    """One of an endless row of changes, the same ones each time."""
    if number % 5 == 3:
        keeper.undo()
    elif number % 7 == 4:
        keeper.remove(keeper.borders[0].id)
    else:
        keeper.add(square(5 + number % 100, 5 + number % 60), float(number))


WRITER = """
import sys
sys.path.insert(0, {test!r})
from pathlib import Path
from test_files import command, integrator
keeper = integrator(Path({root!r}), check_ways=False)
while True:
    command(keeper, keeper.revision)
    print(keeper.revision, flush=True)
"""


def test_a_kill_at_any_moment_loses_at_most_the_change_under_way(tmp_path):
    code = WRITER.format(test=str(Path(__file__).parent), root=str(tmp_path))
    random = np.random.default_rng(1)
    oracle = integrator(check_ways=False)
    for _ in range(4):
        process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
        for _ in range(random.integers(2, 30)):
            said = int(process.stdout.readline())
        threading.Event().wait(random.uniform(0.0, 0.01))  # anywhere within a change
        process.send_signal(signal.SIGKILL)
        rest = process.communicate()[0].split()
        said = int(rest[-1]) if rest else said
        keeper = MapIntegrator(IntegratorParams(check_ways=False), tmp_path)
        assert keeper.set_map(GRID) == (True, ())
        assert keeper.revision in (said, said + 1)
        while oracle.revision < keeper.revision:
            command(oracle, oracle.revision)
        assert keeper.borders == oracle.borders
        assert np.array_equal(keeper.posterior.data, oracle.posterior.data)
    # and everything can still be undone
    for _ in range(6):
        assert keeper.undo().ids == oracle.undo().ids
        assert keeper.borders == oracle.borders


def test_undo_and_redo_survive_a_restart(tmp_path):
    first = integrator(tmp_path)
    first.add(square(10, 10, expires=5.0), 1.0)
    first.add(square(60, 10), 2.0)
    first.remove("b1")
    first.undo()
    first.expire(6.0)  # is no command: undo goes past it
    second = integrator(tmp_path)
    assert second.redo().ids == ("b1",) and [border.id for border in second.borders] == ["b2"]
    second.undo()
    third = integrator(tmp_path)
    third.undo()
    third.undo()
    assert third.borders == ()
    fourth = integrator(tmp_path)
    for expected in (["b1"], ["b1", "b2"], ["b2"]):
        fourth.redo()
        assert [border.id for border in fourth.borders] == expected
    with pytest.raises(CodedError):
        fourth.redo()


@pytest.mark.parametrize("damage, undoable", [("cut", 0), ("line", 2), ("gone", 0)])
def test_a_damaged_journal_costs_no_border_that_its_file_has(tmp_path, damage, undoable):
    first = integrator(tmp_path)
    for number in range(4):
        first.add(square(10 + 25 * number, 10), 1.0 + number)
    path = next(tmp_path.glob("*/journal.jsonl"))
    lines = path.read_bytes().splitlines(keepends=True)
    if damage == "gone":
        path.unlink()
    else:
        path.write_bytes({"cut": b"".join(lines)[:-20], "line": lines[0] + b"?\n" + b"".join(lines[2:])}[damage])
    second = integrator(tmp_path)
    assert second.borders == first.borders
    for _ in range(undoable):
        second.undo()
    with pytest.raises(CodedError) as caught:
        second.undo()
    assert caught.value.code == "nothing_to_undo"
    second.add(square(10, 60), 9.0)
    assert integrator(tmp_path).undo().ids == ("b5",)


def test_many_borders_are_written_after_some_changes_and_none_is_lost(tmp_path, monkeypatch):
    monkeypatch.setattr(border_folders, "BORDERS_PER_CHANGE", 2)
    first = integrator(tmp_path, check_ways=False)
    sizes = set()
    for number in range(12):
        first.add(square(5 + 10 * number, 10), 1.0 + number)
        path = next(tmp_path.glob("*/borders.yaml"))
        sizes.add(path.stat().st_size)
        if number % 4 == 3:
            assert integrator(tmp_path).borders == first.borders
    assert len(sizes) < 12
    # whichever file is damaged, the other and the journal have it all
    path.write_bytes(b"borders: [")
    assert integrator(tmp_path).borders == first.borders


def test_a_line_missing_after_the_borders_file_is_said(tmp_path, monkeypatch):
    first = integrator(tmp_path, check_ways=False)
    first.add(square(10, 10), 1.0)
    monkeypatch.setattr(border_folders, "BORDERS_PER_CHANGE", 0.01)  # from now on the journal alone
    for number in range(3):
        first.add(square(40 + 25 * number, 10), 2.0 + number)
    path = next(tmp_path.glob("*/journal.jsonl"))
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:2] + lines[3:]))
    second = MapIntegrator(IntegratorParams(), tmp_path)
    _, notes = second.set_map(GRID)
    assert "journal.jsonl is damaged" in notes[0]
    assert second.borders == first.borders[:2]
    assert integrator(tmp_path).borders == second.borders


def test_a_long_journal_forgets_its_older_half(tmp_path):
    journal = Journal(tmp_path / "journal.jsonl", limit_bytes=20_000)
    store = BorderStore()
    for number in range(100):
        change = store.adding(square(10, 10), float(number))
        store = store.changed(change)
        journal.append(store.revision, "new", change)
    for kind, change in (("undo", store.undoing()), ("redo", None), ("undo", None)):
        change = change or (store.redoing() if kind == "redo" else store.undoing())
        store = store.changed(change, kind)
        journal.append(store.revision, kind, change)
    assert journal.replay(BorderStore())[0].borders == store.borders
    assert journal.too_long
    journal.shorten(store)
    assert not journal.too_long and journal.path.stat().st_size <= 10_000
    again, sound = journal.replay(store.with_history([], []))
    assert sound and again.redoable == store.redoable
    assert 0 < len(again.undoable) < 60 and again.undoable == store.undoable[-len(again.undoable) :]
    change = again.undoing()
    journal.append(again.revision + 1, "undo", change)
    assert journal.replay(store.with_history([], []))[0].borders == again.changed(change, "undo").borders


def test_borders_go_on_acting_whatever_the_disk_is_like(tmp_path, monkeypatch):
    first = integrator(tmp_path)
    first.add(square(10, 10), 1.0)
    first.add(square(60, 10), 2.0)
    next(tmp_path.glob("*/borders.yaml")).write_bytes(b"?")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    second = MapIntegrator(IntegratorParams(), tmp_path)
    assert any("No space left" in note for note in second.set_map(GRID)[1])
    assert second.borders == first.borders
    data = GRID.data.copy()
    data[50:52, 50] = 100
    assert any("No space left" in note for note in second.set_map(GRID.with_data(data))[1])
    assert second.borders == first.borders


def test_without_files_another_map_has_no_borders():
    keeper = integrator()
    keeper.add(square(10, 10), 1.0)
    data = np.full(GRID.shape, 100, np.int8)
    data[5:60, 5:150] = 0
    _, notes = keeper.set_map(GRID.with_data(data))
    assert keeper.borders == () and "another map" in notes[0]
    assert np.array_equal(keeper.posterior.data, data)


def test_another_map_has_other_borders_and_the_first_one_keeps_its_own(tmp_path):
    first = integrator(tmp_path)
    first.add(square(10, 10), 1.0)
    data = GRID.data.copy()
    data[20:100, 20:140] = 100
    data[30:90, 30:130] = -1
    other = GRID.with_data(data)
    second = MapIntegrator(IntegratorParams(), tmp_path)
    _, notes = second.set_map(other)
    assert second.borders == () and "belong to" in notes[0]
    assert np.array_equal(second.posterior.data, data)
    assert integrator(tmp_path).borders == first.borders
    second.set_map(GRID)
    assert second.borders == first.borders


def test_a_map_that_grows_keeps_its_borders(tmp_path):
    keeper = integrator(tmp_path, GRID)
    keeper.add(square(10, 10), 1.0)
    x, y, yaw = GRID.origin
    origin = GRID.grid_to_world([[-30.5, -20.5]])[0]
    grown = GridMap(np.full((200, 260), -1, np.int8), 0.05, (origin[0], origin[1], yaw))
    grown.data[20:140, 30:190] = GRID.data
    grown.data[60:80, 189:250] = 0
    changed, notes = keeper.set_map(grown)
    assert changed and "same place" in notes[0]
    assert len(keeper.borders) == 1
    assert (keeper.posterior.data[32:48, 42:58] == 100).all()
    assert keeper.set_map(grown) == (False, ())
    again = integrator(tmp_path, grown)
    assert again.borders == keeper.borders
    assert len(list(tmp_path.glob("*/borders.yaml"))) == 1


def test_a_folder_that_cannot_be_used_is_said_and_the_map_still_comes(tmp_path):
    (tmp_path / "file").write_text("")
    keeper = MapIntegrator(IntegratorParams(), tmp_path / "file" / "store")
    changed, notes = keeper.set_map(GRID)
    assert changed and "lost" in notes[0]
    keeper.add(square(10, 10), 1.0)
    assert (keeper.posterior.data == 100).sum() > (GRID.data == 100).sum()


def test_yaml_round_trip():
    curve = VirtualBorder(at((1, 2), (3, 4)), at((5, 6))[0], 0.123456789)
    borders = [square(10, 10, id="b1", name="Küche: 'x' # y"), curve]
    again, rest = borders_from_yaml(borders_to_yaml(borders))
    assert again == borders and rest == {}
    no_seed = "borders:\n- {points: [[0, 0], [1, 1]]}"
    for text in ("", "borders: 3", "borders: [1]", no_seed, "borders:\n- {x: 1}", "[", "\x00"):
        with pytest.raises(CodedError):
            borders_from_yaml(text)


@pytest.mark.parametrize("raw", [False, True])
def test_map_files_round_trip(tmp_path, raw):
    random = np.random.default_rng(1)
    values = np.arange(-1, 101) if raw else np.array([-1, 0, 100])
    grid = GridMap(random.choice(values, (37, 53)).astype(np.int8), 0.025, (-3.5, 2.25, -0.7))
    files = write_map(tmp_path / "lab", grid, raw)
    assert [path.name for path in files] == ["lab.pgm", "lab.yaml"]
    again = read_map(files[1])
    assert np.array_equal(again.data, grid.data) and again.same_geometry(grid)
    assert files[0].read_bytes()[:2] == b"P5"


def test_trinary_files_hold_what_map_saver_would_write(tmp_path):
    grid = GridMap(np.array([[0, 19, 25, 50, 64, 65, 100, -1]], np.int8), 0.05)
    again = read_map(write_map(tmp_path / "m", grid)[1])
    assert again.data.tolist() == [[0, 0, -1, -1, -1, 100, 100, -1]]


@pytest.mark.parametrize("name", ["../x", "/etc/x", "a/b", "", ".hidden", "a..b", "x\n", "a" * 200, "a\x00b"])
def test_names_cannot_leave_the_folder(tmp_path, name):
    with pytest.raises(CodedError) as caught:
        safe_path(tmp_path, name)
    assert caught.value.code == "bad_name"


@pytest.mark.parametrize(
    "text", ["", "[", "image: none.pgm", "image: m.pgm\nresolution: x\norigin: [0, 0, 0]", "mode: odd\nimage: m.pgm"]
)
def test_bad_map_files_are_refused(tmp_path, text):
    write_map(tmp_path / "m", GRID)
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(CodedError) as caught:
        read_map(path)
    assert caught.value.code in ("bad_map_file", "bad_map")


def test_a_recording_is_numbered_and_continued(tmp_path):
    keeper = integrator()
    recording = Recording(tmp_path)
    recording.record(keeper.posterior, keeper.borders, 1.0, {"revision": 0})
    keeper.add(square(10, 10, occupancy=0.75), 2.0)
    recording.record(keeper.posterior, keeper.borders, 2.0, {})
    path = Recording(tmp_path).record(keeper.posterior, keeper.borders, 3.0, {})
    assert path.name == "0003.yaml"
    assert np.array_equal(read_map(tmp_path / "0002.yaml").data, keeper.posterior.data)
    lines = (tmp_path / "index.jsonl").read_text().splitlines()
    assert ['"start"' in lines[0], '"added b1"' in lines[1], len(lines)] == [True, True, 3]
    assert borders_from_yaml((tmp_path / "0002.borders.yaml").read_text())[0] == list(keeper.borders)
