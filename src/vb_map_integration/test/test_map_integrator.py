"""Changes, history, checks and combined borders, without ROS."""

import tempfile
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from examples import STEADY
from integrators import GRID, at, expected, integrator, square
from refusals import refused
from vb_core.grid_map import GridMap
from vb_map_integration.border import VirtualBorder
from vb_map_integration.border_region import compute_region
from vb_map_integration.restricted_cells import Region, apply_regions, count_free_parts, join_regions

KINDS = ["add", "add", "add", "soft", "remove", "disable", "update", "undo", "redo", "restart"]
STEPS = st.lists(st.tuples(st.sampled_from(KINDS), st.integers(2, 130), st.integers(2, 90)), max_size=25)
UNDO_AND_REDO_ALL = [(kind, 0, 0) for kind in [*25 * ["undo"], "restart", *25 * ["redo"]]]


def possible_changes(keeper, column, row, now):
    """Returns functions that change the borders, by their kinds. The column also decides which border is changed."""
    changes = {command: getattr(keeper, command) for command in keeper.available_commands}
    changes["add"] = lambda: keeper.add(square(column, row), now)
    changes["soft"] = lambda: keeper.add(square(column, row, occupancy=0.5), now)
    if keeper.borders:
        some_id = keeper.borders[column % len(keeper.borders)].id
        changes["remove"] = lambda: keeper.remove(some_id)
        changes["disable"] = lambda: keeper.set_enabled(some_id, False, now)
        changes["update"] = lambda: keeper.update(square(column, row, id=some_id), now)
    return changes


@settings(STEADY, max_examples=25)
@given(STEPS)
def test_the_map_shows_the_remaining_borders_after_any_history(steps):
    folder = tempfile.TemporaryDirectory()
    keeper = integrator(Path(folder.name))
    states = [()]  # the borders after each change that is made or may be redone
    newest = 0  # the index in it of the newest change that is made
    used_ids = set()
    for now, (kind, column, row) in enumerate([*steps, *UNDO_AND_REDO_ALL], 1):
        changes = possible_changes(keeper, column, row, now)
        if kind == "restart":
            revision = keeper.revision
            keeper.close()
            keeper = integrator(Path(folder.name))
            assert keeper.revision == revision
            assert keeper.notices == []
        elif kind in changes:
            changed_ids = set(changes[kind]().ids)
            newest += -1 if kind == "undo" else 1
            if kind not in ("undo", "redo"):
                states[newest:] = [keeper.borders]
            if kind in ("add", "soft"):
                assert not changed_ids & used_ids
                used_ids |= changed_ids
        for command in {"undo", "redo"} - set(keeper.available_commands):
            with refused(f"nothing_to_{command}"):
                getattr(keeper, command)()
        assert keeper.borders == states[newest]
        possible = {"undo": newest > 0, "redo": newest < len(states) - 1}
        assert keeper.available_commands == [name for name in possible if possible[name]]
        assert np.array_equal(keeper.map_with_borders.data, expected(keeper))
    keeper.close()


def test_refusals_change_nothing(restart, tmp_path):
    keeper = restart(borders=[square(10, 10)])

    def read_state():
        files = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
        return keeper.borders, keeper.revision, keeper.map_with_borders.data.tolist(), files

    before = read_state()
    for code, action in (
        ("seed_outside_map", lambda: keeper.add(square(10, 10).replace(seed=at((900, 5))[0]), 2.0)),
        ("id_not_empty", lambda: keeper.add(square(10, 10, id="b7"), 2.0)),
        ("unknown_border", lambda: keeper.update(square(10, 10, id="b7"), 2.0)),
        ("unknown_border", lambda: keeper.remove("b7")),
        ("unknown_border", lambda: keeper.set_enabled("b7", False, 2.0)),
        ("nothing_to_redo", keeper.redo),
        ("bad_file_name", lambda: keeper.save(tmp_path, "../out", False)),
    ):
        with refused(code):
            action()
    assert read_state() == before


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
    keeper = integrator(grid=None)
    for action in (lambda: keeper.add(square(10, 10), 1.0), lambda: keeper.map_with_borders):
        with refused("no_map"):
            action()


def test_preview_changes_nothing_and_says_that_the_floor_is_split(monkeypatch):
    keeper = integrator()
    before = keeper.map_with_borders.data.copy()
    band = VirtualBorder(at((70, -5), (90, -5), (90, 125), (70, 125)), at((80, 60))[0], closed=True)
    check = keeper.check(band, at((20, 60)))
    assert check.free_parts == 2
    assert "splits_free_space" in [issue.code for issue in check.issues]
    assert np.array_equal(keeper.map_with_borders.data, before)
    assert keeper.borders == ()
    # what was checked is not computed again, nor is a border that does not change
    spy = Mock(wraps=compute_region)
    monkeypatch.setattr("vb_map_integration.borders_in_force.compute_region", spy)
    outcome = keeper.add(band, 1.0)
    keeper.add(square(20, 60), 2.0)
    assert spy.call_count == 2
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
        monkeypatch.setattr("vb_map_integration.restricted_cells.MAX_CELLS", 2000)
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
    ada, bob, zoe = (keeper.map_with_borders_for(name).data for name in ("ada", "bob", "zoe"))
    assert np.array_equal(zoe, common)
    assert (ada == 100).sum() > (common == 100).sum()
    assert (bob == 100).sum() > (common == 100).sum()
    assert np.array_equal(np.maximum(ada, bob), keeper.map_with_borders.data), "the common map has them all"
    assert not np.array_equal(ada, bob)
    keeper.undo()
    keeper.undo()
    assert np.array_equal(keeper.map_with_borders_for("ada").data, common)
    keeper.undo()
    assert np.array_equal(keeper.map_with_borders_for("ada").data, GRID.data)
