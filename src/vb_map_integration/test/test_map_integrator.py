"""Changes, history, checks and combined borders, without ROS."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from examples import STEADY
from integrators import GRID, at, expected, integrator, square
from refusals import refused
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_map_integration.border import VirtualBorder
from vb_map_integration.border_region import compute_region
from vb_map_integration import borders_in_force
from vb_map_integration.map_integrator import MapIntegrator
from vb_map_integration.region import Region, apply_regions, count_free_parts, join_regions

KINDS = ["add", "add", "add", "soft", "remove", "disable", "update", "undo", "redo", "restart"]
COMMANDS = st.lists(st.tuples(st.sampled_from(KINDS), st.integers(2, 130), st.integers(2, 90)), max_size=25)


@settings(STEADY, max_examples=25)
@given(COMMANDS)
def test_the_map_shows_the_remaining_borders_after_any_history(commands):
    """This also holds after restarts."""
    folder = tempfile.TemporaryDirectory()
    keeper = integrator(Path(folder.name))
    states, undone, given = [()], [], set()
    # at the end, everything is undone and redone
    back_and_forth = [(command, 0, 0) for command in [*25 * ["undo"], "restart", *25 * ["redo"]]]
    for now, (command, column, row) in enumerate([*commands, *back_and_forth], 1):
        ids = [border.id for border in keeper.borders]
        some = ids[column % len(ids)] if ids else "none"
        try:
            if command == "restart":
                revision = keeper.revision
                keeper.close()
                keeper = integrator(Path(folder.name))
                assert (keeper.revision, keeper.notices) == (revision, [])
            elif command in ("add", "soft"):
                (added,) = keeper.add(square(column, row, occupancy=0.5 if command == "soft" else 1.0), now).ids
                assert added not in given
                given.add(added)
            elif command == "remove":
                keeper.remove(some)
            elif command == "disable":
                keeper.set_enabled(some, False, now)
            elif command == "update":
                keeper.update(square(column, row, id=some), now)
            else:
                getattr(keeper, command)()
        except CodedError as error:
            assert error.code in ("unknown_border", "nothing_to_undo", "nothing_to_redo")
            continue
        if command == "undo":
            undone.append(states.pop())
        elif command == "redo":
            states.append(undone.pop())
        elif command != "restart":
            states.append(keeper.borders)
            undone.clear()
        assert keeper.borders == states[-1]
        possible = {"undo": len(states) > 1, "redo": len(undone) > 0}
        assert keeper.available_commands == [name for name in possible if possible[name]]
        assert np.array_equal(keeper.map_with_borders.data, expected(keeper))
    keeper.close()


def test_refusals_change_nothing(restart, tmp_path):
    keeper = restart(borders=[square(10, 10)])
    before, cells, revision = keeper.borders, keeper.map_with_borders.data.copy(), keeper.revision

    def read_files():
        return {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}

    files = read_files()
    for code, action in (
        ("seed_outside_map", lambda: keeper.add(square(10, 10).replace(seed=at((900, 5))[0]), 2.0)),
        ("id_not_empty", lambda: keeper.add(square(10, 10, id="b7"), 2.0)),
        ("unknown_border", lambda: keeper.update(square(10, 10, id="b7"), 2.0)),
        ("unknown_border", lambda: keeper.remove("b7")),
        ("nothing_to_redo", keeper.redo),
        ("bad_file_name", lambda: keeper.save(tmp_path, "../out", False)),
    ):
        with refused(code):
            action()
    assert (keeper.borders, keeper.revision) == (before, revision)
    assert np.array_equal(keeper.map_with_borders.data, cells)
    assert files == read_files()


def test_an_unnamed_border_is_numbered_by_those_that_are_there(restart):
    keeper = restart(borders=[square(column, 10, name="") for column in (10, 60)])
    keeper.remove("b1")
    keeper.add(square(10, 60, name=""), 3.0)
    assert [(border.id, border.name) for border in keeper.borders] == [("b2", "border 2"), ("b3", "border 1")]


def test_undo_and_redo_bring_back_no_name_that_another_has(restart):
    """An unnamed border may reuse a removed one's number: undo goes back in order, and removes the newer one first."""
    draw = np.random.default_rng(5)
    keeper = restart()
    for step in range(200):
        names = {border.id: border.name for border in keeper.borders}
        actions = [lambda: keeper.add(square(*draw.integers(5, 60, 2), name=""), float(step))]
        if names:
            actions += [lambda: keeper.remove(draw.choice(sorted(names)))] * 2
        actions += [getattr(keeper, command) for command in keeper.available_commands]
        actions[draw.integers(len(actions))]()
        after = [border.name for border in keeper.borders]
        assert len(set(after)) == len(after)
        # borders that stay keep their names
        assert all(names.get(border.id, border.name) == border.name for border in keeper.borders)


def test_before_a_map_everything_is_refused():
    keeper = MapIntegrator(None)
    for action in (lambda: keeper.add(square(10, 10), 1.0), lambda: keeper.map_with_borders):
        with pytest.raises(CodedError):
            action()


def test_preview_changes_nothing_and_says_that_the_floor_is_split(monkeypatch):
    keeper = integrator()
    before = keeper.map_with_borders.data.copy()
    band = VirtualBorder(at((70, -5), (90, -5), (90, 125), (70, 125)), at((80, 60))[0], closed=True)
    check = keeper.check(band, at((20, 60)))
    assert (check.free_parts, "splits_free_space" in [issue.code for issue in check.issues]) == (2, True)
    assert (np.array_equal(keeper.map_with_borders.data, before), keeper.borders) == (True, ())
    # what was checked is not computed again, nor is a border that does not change
    computed = []
    monkeypatch.setattr(borders_in_force, "compute_region", lambda *of: computed.append(of) or compute_region(*of))
    outcome = keeper.add(band, 1.0)
    keeper.add(square(20, 60), 2.0)
    assert len(computed) == 2
    assert "splits_free_space" in [issue.code for issue in outcome.issues]
    # floor that is split already is not reported again for another border
    assert "splits_free_space" not in [issue.code for issue in keeper.check(square(20, 20)).issues]
    # replacing the band with a small square joins the parts again
    assert keeper.check(square(70, 50, id=outcome.ids[0])).free_parts == 1


@pytest.mark.parametrize("door, radius, parts", [(0.3, 0.18, 2), (0.3, 0.05, 1), (1.05, 0.45, 1), (0.0, 0.0, 2)])
def test_a_gap_narrower_than_the_robot_is_no_path(monkeypatch, door, radius, parts):
    data = np.zeros((100, 160), np.int8)
    data[:, 78:82] = 100
    data[40 : 40 + int(round(door / 0.05)), 78:82] = 0
    assert count_free_parts(GridMap(data, 0.05), radius) == parts
    if door != 0.3:  # a large map is examined in coarser cells
        monkeypatch.setattr("vb_map_integration.region.MAX_CELLS", 2000)
        assert count_free_parts(GridMap(data, 0.05), radius) == parts


def test_no_free_space_left_for_the_robot_is_reported():
    keeper = integrator()
    everything = VirtualBorder(at((-5, -5), (170, -5), (170, 130), (-5, 130)), at((80, 60))[0], closed=True)
    codes = [issue.code for issue in keeper.add(everything, 1.0).issues]
    assert {"outside_map", "covers_nearly_all", "no_free_space_left"} == set(codes)
    assert "no_free_space_left" not in [issue.code for issue in keeper.check(square(20, 20)).issues]  # none before


@pytest.mark.parametrize("seed", range(5))
def test_regions_with_different_windows_compare_and_join_by_cell(seed):
    random = np.random.default_rng(seed)
    regions = []
    for _ in range(2):
        top, left, height, width = random.integers((0, 0, 3, 3), (8, 8, 12, 12))
        mask = (random.random((height, width)) < 0.5).astype(np.uint8) * 255
        regions.append(Region((slice(top, top + height), slice(left, left + width)), mask, 100, True, 1.0))
    first, second = np.zeros((2, 20, 20), bool)
    first[regions[0].window], second[regions[1].window] = regions[0].mask, regions[1].mask
    assert regions[0].iou(regions[1]) == pytest.approx((first & second).sum() / (first | second).sum())
    grid = GridMap(np.full((20, 20), -1, np.int8), 0.05)
    for joined in (regions, [join_regions(regions)]):
        assert np.array_equal(apply_regions(grid, joined).data == 100, first | second) and (grid.data == -1).all()


def test_each_robot_has_the_borders_that_name_it_or_nobody():
    keeper = integrator(borders=[square(30, 30)])
    common = keeper.map_with_borders.data.copy()
    keeper.add(square(80, 30, robots=("ada",)), 2.0)
    keeper.add(square(80, 60, robots=("bob", "eve")), 3.0)
    everything = keeper.map_with_borders.data
    ada, bob, zoe = (keeper.map_with_borders_for(name).data for name in ("ada", "bob", "zoe"))
    assert np.array_equal(zoe, common)
    assert (ada == 100).sum() > (common == 100).sum()
    assert (bob == 100).sum() > (common == 100).sum()
    assert np.array_equal(np.maximum(ada, bob), everything), "the common map has them all"
    assert not np.array_equal(ada, bob)
    keeper.undo()
    keeper.undo()
    assert np.array_equal(keeper.map_with_borders_for("ada").data, common)
    keeper.undo()
    assert np.array_equal(keeper.map_with_borders_for("ada").data, GRID.data)
