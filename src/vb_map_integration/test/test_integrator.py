"""Store, history, files and composition, without ROS."""
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_map_integration.border import VirtualBorder
from vb_map_integration.border_files import borders_from_yaml, borders_to_yaml
from vb_map_integration.integration import integrate
from vb_map_integration.integrator import IntegratorParams, MapIntegrator
from vb_map_integration.map_files import read_map, safe_path, write_map
from vb_map_integration.preview import ways
from vb_map_integration.recording import Recording


def room(height=120, width=160, origin=(-1.0, -1.0, 0.2)):
    data = np.zeros((height, width), np.int8)
    data[[0, -1]] = 100
    data[:, [0, -1]] = 100
    return GridMap(data, 0.05, origin)


GRID = room()


def at(*points, grid=GRID):
    return grid.grid_to_world(np.array(points, float))


def square(column, row, size=20, grid=GRID, **options):
    corners = at((column, row), (column + size, row), (column + size, row + size), (column, row + size), grid=grid)
    return VirtualBorder(corners, at((column + size / 2, row + size / 2), grid=grid)[0], closed=True, **options)


def integrator(root=None, grid=GRID, **params):
    result = MapIntegrator(IntegratorParams(**params), root)
    result.set_map(grid)
    return result


def expected(keeper):
    cells = keeper.physical
    for border in keeper.borders:
        if border.enabled:
            cells = cells.with_data(np.maximum(cells.data, integrate(keeper.physical, border).posterior.data))
    return cells.data


COMMANDS = st.lists(
    st.tuples(st.sampled_from(["add", "add", "add", "soft", "remove", "disable", "update", "undo", "redo", "clear"]),
              st.integers(2, 130), st.integers(2, 90)), max_size=25)


@settings(max_examples=25, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(COMMANDS)
def test_any_history_gives_the_map_of_the_borders_that_are_left(commands):
    keeper = integrator(check_ways=False)
    states = [()]
    undone = []
    for now, (command, column, row) in enumerate(commands, 1):
        ids = [border.id for border in keeper.borders]
        some = ids[column % len(ids)] if ids else "none"
        try:
            if command in ("add", "soft"):
                keeper.add(square(column, row, occupancy=0.5 if command == "soft" else 1.0), now)
            elif command == "remove":
                keeper.remove(some)
            elif command == "disable":
                keeper.enable(some, False, now)
            elif command == "update":
                keeper.update(square(column, row, id=some), now)
            else:
                getattr(keeper, command)()
        except CodedError as error:
            assert error.code in ("unknown_border", "nothing_to_undo", "nothing_to_redo", "nothing_to_clear")
            continue
        if command == "undo":
            undone.append(states.pop())
        elif command == "redo":
            states.append(undone.pop())
        else:
            states.append(keeper.borders)
            undone.clear()
        assert keeper.borders == states[-1]
        assert np.array_equal(keeper.posterior.data, expected(keeper))
    for _ in states[1:]:
        keeper.undo()
    assert keeper.borders == () and np.array_equal(keeper.posterior.data, GRID.data)


def test_refusals_change_nothing(tmp_path):
    keeper = integrator(tmp_path)
    keeper.add(square(10, 10), 1.0)
    before, cells, revision = keeper.borders, keeper.posterior.data.copy(), keeper.revision
    files = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    for code, action in (
        ("seed_outside_map", lambda: keeper.add(VirtualBorder(at((5, 5), (30, 5), (30, 30)), at((900, 5))[0], closed=True), 2.0)),
        ("id_not_empty", lambda: keeper.add(square(10, 10, id="b7"), 2.0)),
        ("unknown_border", lambda: keeper.update(square(10, 10, id="b7"), 2.0)),
        ("unknown_border", lambda: keeper.remove("b7")),
        ("already_expired", lambda: keeper.add(square(10, 10, expires=1.5), 2.0)),
        ("nothing_to_redo", keeper.redo),
        ("bad_name", lambda: keeper.save(tmp_path, "../out", False)),
    ):
        with pytest.raises(CodedError) as caught:
            action()
        assert caught.value.code == code
    assert keeper.borders == before and keeper.revision == revision
    assert np.array_equal(keeper.posterior.data, cells)
    assert files == {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}


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


def test_before_a_map_everything_is_refused():
    keeper = MapIntegrator(IntegratorParams(), None)
    for action in (lambda: keeper.add(square(10, 10), 1.0), keeper.clear, lambda: keeper.posterior):
        with pytest.raises(CodedError):
            action()


def test_an_expiry_turns_over_what_is_enabled():
    keeper = integrator()
    keeper.add(square(10, 10, expires=10.0), 1.0)
    keeper.add(square(60, 10), 1.0)
    keeper.enable("b2", False, 2.0, expires=20.0)  # "allow the kitchen" until 20
    assert keeper.expire(9.9) is None
    assert keeper.expire(10.0).ids == ("b1",)
    assert np.array_equal(keeper.posterior.data, GRID.data)
    assert keeper.expire(25.0).ids == ("b2",)
    assert [border.enabled for border in keeper.borders] == [False, True]
    assert keeper.area_m2("b2") == pytest.approx(1.0, rel=0.1)


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
        "edited": content.replace(b"occupancy: 1.0", b"occupancy: 0.1"),
    }[damage])
    second = MapIntegrator(IntegratorParams(), tmp_path)
    _, notes = second.set_map(GRID)
    assert "set aside" in notes[0]
    assert second.borders == first.borders[:1]
    assert next(tmp_path.glob("*/borders.yaml.damaged*")).exists()
    second.add(square(60, 60), 3.0)
    assert integrator(tmp_path).borders == second.borders


WRITER = """
import sys
sys.path.insert(0, {test!r})
from pathlib import Path
from test_integrator import integrator, square
keeper = integrator(Path({root!r}), check_ways=False)
for k in range(1, 100000):
    keeper.add(square(5 + k % 100, 5 + k % 60), float(k))
    print(k, flush=True)
"""


def test_a_kill_at_any_moment_loses_at_most_the_change_under_way(tmp_path):
    for round_number in range(3):
        known = len(integrator(tmp_path, check_ways=False).borders)
        process = subprocess.Popen(
            [sys.executable, "-c", WRITER.format(test=str(Path(__file__).parent), root=str(tmp_path))], stdout=subprocess.PIPE
        )
        for _ in range(5 + 4 * round_number):
            done = int(process.stdout.readline())
        process.send_signal(signal.SIGKILL)
        rest = process.communicate()[0].split()
        done = int(rest[-1]) if rest else done
        keeper = MapIntegrator(IntegratorParams(), tmp_path)
        _, notes = keeper.set_map(GRID)
        assert notes == ()
        assert len(keeper.borders) in (known + done, known + done + 1)


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


def test_borders_for_other_robots_are_left_out():
    keeper = integrator(robot_name="ada")
    keeper.add(square(10, 10, robots=("bob",)), 1.0)
    assert np.array_equal(keeper.posterior.data, GRID.data)
    keeper.add(square(50, 10, robots=("ada", "bob")), 1.0)
    assert keeper.area_m2("b2") > 0


def test_yaml_round_trip():
    borders = [square(10, 10, id="b1", name="Küche: 'x' # y"), VirtualBorder(at((1, 2), (3, 4)), at((5, 6))[0], 0.123456789)]
    again, rest = borders_from_yaml(borders_to_yaml(borders))
    assert again == borders and rest == {}
    for text in ("", "borders: 3", "borders: [1]", "borders:\n- {points: [[0, 0], [1, 1]]}", "borders:\n- {x: 1}", "[", "\x00"):
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


@pytest.mark.parametrize("text", ["", "[", "image: none.pgm", "image: m.pgm\nresolution: x\norigin: [0, 0, 0]", "mode: odd\nimage: m.pgm"])
def test_bad_map_files_are_refused(tmp_path, text):
    write_map(tmp_path / "m", GRID)
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(CodedError) as caught:
        read_map(path)
    assert caught.value.code in ("bad_map_file", "bad_map")


def test_preview_changes_nothing_and_names_what_is_out_of_reach():
    keeper = integrator()
    before = keeper.posterior.data.copy()
    band = VirtualBorder(at((70, -5), (90, -5), (90, 125), (70, 125)), at((80, 60))[0], closed=True)
    check = keeper.check(band, {"robot": at((20, 60))[0]}, [at((30, 30))[0], at((130, 30))[0], at((80, 60))[0], at((900, 0))[0]])
    assert check.ways.free_parts == 2 and check.ways.unreachable == (1, 2, 3)
    assert "splits_free_space" in [found.code for found in check.findings]
    assert np.array_equal(keeper.posterior.data, before) and keeper.borders == ()
    outcome = keeper.add(band, 1.0)
    assert "splits_free_space" in [found.code for found in outcome.findings]
    # replacing the band by a small square joins the parts again
    check = keeper.check(square(70, 50, id=outcome.ids[0]), None, [at((130, 30))[0]])
    assert check.ways.free_parts == 1 and check.ways.unreachable == ()


def test_a_gap_narrower_than_the_robot_is_no_way():
    data = GRID.data.copy()
    data[:, 80] = 100
    data[50:56, 80] = 0  # 0.30 m
    grid = GRID.with_data(data)
    goal = [at((130, 50))[0]]
    assert ways(grid, goal, at((20, 50))[0], radius_m=0.18).unreachable == (0,)
    assert ways(grid, goal, at((20, 50))[0], radius_m=0.05).unreachable == ()


def test_a_large_map_is_looked_at_in_coarser_cells(monkeypatch):
    from vb_map_integration import preview

    data = np.zeros((100, 160), np.int8)
    data[:, 78:82] = 100
    data[40:61, 78:82] = 0  # a door of 1.05 m
    grid = GridMap(data, 0.05)
    goals = [(7.0, 2.5), (3.95, 1.0)]
    fine = ways(grid, goals, (1.0, 1.0))
    monkeypatch.setattr(preview, "MAX_CELLS", 2000)
    assert ways(grid, goals, (1.0, 1.0)) == fine == preview.Ways(1, (1,))


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


def test_the_hundredth_border_touches_no_other(monkeypatch):
    """Not a measurement: adding one paints one region, whatever else is there."""
    from vb_map_integration import composition

    keeper = integrator(check_ways=False)
    painted = []
    original = composition.Region.paint
    monkeypatch.setattr(composition.Region, "paint", lambda self, *args: (painted.append(1), original(self, *args)))
    for k in range(100):
        painted.clear()
        keeper.add(square(5 + k, 5 + k % 80), float(k + 1))
        assert len(painted) == 1


PURE = ["border", "border_files", "border_folders", "composition", "curve", "findings", "history_file", "integration", "integrator", "map_binding", "map_files",
        "preview", "raster", "recording", "store"]
BLOCKED = """
import sys
class Block:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("rospy", "tf2_ros", "cv_bridge") or name.split(".")[0].endswith("_msgs"):
            raise ImportError("blocked: " + name)
sys.meta_path.insert(0, Block())
import importlib
for name in {names!r}:
    importlib.import_module("vb_map_integration." + name)
"""


def test_pure_modules_need_no_ros():
    import vb_map_integration.border

    folder = Path(vb_map_integration.border.__file__).parent
    found = sorted(path.stem for path in folder.glob("*.py") if not path.stem.endswith("_node") and path.stem != "__init__")
    assert found == PURE
    subprocess.run([sys.executable, "-c", BLOCKED.format(names=found)], check=True)
