"""Maps that change: which place they show, where its borders lie, and that nothing is opened silently."""

import tracemalloc

import numpy as np
import pytest

from integrators import GRID, OUTSIDE, ROOM, closed_off, first_status, flat, integrator, keep_out
from refusals import refused
from vb_testing import assert_fields
from vb_core import sentences
from vb_core.grid_map import GridMap, Transform
from vb_map_integration.places import registration
from vb_map_integration.places.walls import WallMap


# ----------------------------------------------------------------- registration
def register(old, new):
    return registration.register_maps(WallMap(old), WallMap(new))


@pytest.mark.parametrize("resolution", [0.03, 0.05])  # [m] of the new map; the old one's is 0.05
@pytest.mark.parametrize("motion", [(0.25, 0, 0), (0, 0, np.radians(3.0)), (-4.0, 2.0, np.pi), (3.3, 1.1, -2.0)])
def test_a_moved_map_is_found(motion, resolution):
    truth = Transform(*motion)
    registration = register(flat(), flat(truth, resolution, seed=1))
    distances = np.linalg.norm(registration.transform.apply(OUTSIDE) - truth.apply(OUTSIDE), axis=1)
    assert registration.is_certain
    assert distances.max() < 0.05


def test_floors_with_equal_outer_walls_are_not_confused():
    assert not register(flat(), flat(plan=1, seed=1)).is_certain


def test_a_room_that_looks_the_same_when_turned_is_not_sure():
    assert not register(GRID, GRID.with_data(np.ascontiguousarray(GRID.data[::-1, ::-1]))).is_certain


def test_a_large_map_or_a_tiny_one_does_no_harm():
    large = flat()
    cells = np.full((1400, 1500), -1, np.int8)
    cells[300 : 300 + large.shape[0], 700 : 700 + large.shape[1]] = large.data
    cells[900:1200, ::60] = 100  # many straight walls
    cells[900:1200:3, 1::60] = 100
    cells[900:1200, 2::60] = 0
    cells[1200:1300, ::2] = 100  # and more cells than OpenCV remaps at once
    cells[1200:1300, 1::2] = 0
    moved = GridMap(cells, 0.05, (0.0, 0.0, 0.0))
    result = register(large, moved)
    truth = moved.grid_to_world([[699.5, 299.5]])[0] - large.origin[:2]
    shift = result.transform.apply([(4.5, 3.0)])[0] - (4.5, 3.0)
    assert not result.is_certain or np.linalg.norm(shift - truth) < 0.05
    for tiny in (np.array([[100]]), np.array([[100, 0, 100]]), np.array([[0], [100]])):
        result = register(large, GridMap(tiny.astype(np.int8), 0.05))
        assert result is None or not result.is_certain


@pytest.mark.parametrize("column", [60, 61, 62])
def test_floor_seen_by_one_beam_far_outside_the_walls_is_harmless(column):
    """A sample of the floor may miss the beam; then the drawn floor extends farther than the sample."""
    grid, below = flat(), 600
    data = np.vstack([np.full((below, grid.shape[1]), -1, np.int8), grid.data])
    data[: below + 100, column] = 0
    origin = (grid.origin[0], grid.origin[1] - below * grid.resolution, 0.0)
    result = register(grid, GridMap(data, grid.resolution, origin))
    assert np.hypot(result.transform.x, result.transform.y) < 0.1


def test_an_empty_canvas_costs_no_memory():
    """Otherwise a registration on a canvas of 4000 x 4000 cells takes up to 1 GB, whatever is drawn on it."""
    canvases = []
    for seed in (0, 1):
        home, cells = flat(seed=seed), np.full((4000, 4000), -1, np.int8)
        cells[1900 : 1900 + home.shape[0], 1800 : 1800 + home.shape[1]] = home.data
        canvases.append(GridMap(cells, home.resolution))
    tracemalloc.start()
    try:
        result = register(*canvases)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert result.is_certain
    assert peak < 100e6  # one canvas of floats has 128 MB


def test_maps_without_walls_are_not_registered():
    assert register(flat(), GRID.with_data(np.full(GRID.shape, -1, np.int8))) is None


# ----------------------------------------------------------------- recognition
def test_ten_seconds_of_slam_do_not_lose_the_border(restart):
    """Day 1: a static map. Day 2: SLAM from scratch. Day 3: the static map must still have its border."""
    restart(flat(), borders=[keep_out()])
    slam = restart(None)
    for width in (0.6, 2.0):
        slam.set_map(flat(Transform(5.0, 5.0, 1.0), seed=2, known=(4.0, 4.0 + width)))
        assert (slam.needs_confirmation, len(slam.borders)) == (True, 1)
        asked = next(notice for notice in slam.notices if notice.code == "borders_unconfirmed")
        # the notice names the border, since nobody named the place
        assert sentences.border_name(slam.borders[0].name) in asked.sentence()
    third = restart(flat())
    assert (closed_off(third), third.needs_confirmation) == (True, False)


@pytest.mark.parametrize("truth", [Transform(0.25, 0.0, 0.0), Transform(0.0, 0.0, np.radians(3.0))])
def test_borders_move_with_the_map(restart, truth):
    """Otherwise a map moved by 0.25 m or turned by 3 degrees has no border at all."""
    keeper = restart(flat(), borders=[keep_out()])
    keeper.set_map(flat(truth, seed=3))
    assert (keeper.needs_confirmation, closed_off(keeper, truth)) == (False, True)
    assert np.abs(keeper.borders[0].points - truth.apply(keep_out().points)).max() < 0.05
    # a border drawn on the moved map lies correctly in the first one
    keeper.add(keep_out(truth.after(Transform(3.0, -3.0, 0.0)), name="second"), 2.0)
    keeper.set_map(flat())
    assert np.array_equal(keeper.borders[0].points, keep_out().points)
    assert np.abs(keeper.borders[1].points - Transform(3.0, -3.0, 0.0).apply(keep_out().points)).max() < 0.05


def test_many_small_shifts_never_leave_the_walls(restart):
    """Otherwise thirty shifts of two cells each pass as the same place, with the border 3 m away from its walls."""
    keeper = restart(flat(), borders=[keep_out()])
    for step in (1, 2, 15, 30):
        truth = Transform(0.1 * step, 0.0, 0.0)
        keeper.set_map(flat(truth, seed=step))
        if not keeper.needs_confirmation:
            assert np.abs(keeper.borders[0].points - truth.apply(keep_out().points)).max() < 0.06
            assert closed_off(keeper, truth)


def test_in_doubt_borders_stay_in_force_until_somebody_confirms(restart):
    keeper = restart(flat(), borders=[keep_out()])
    keeper.set_map(flat(plan=1, seed=4))
    assert (keeper.needs_confirmation, closed_off(keeper)) == (True, True)
    with refused("confirm_map_first"):
        keeper.add(keep_out(), 2.0)
    keeper.confirm(False, "upstairs")
    assert (keeper.needs_confirmation, keeper.borders, keeper.map_name) == (False, (), "upstairs")
    keeper.add(keep_out(name="bath"), 4.0)
    keeper.set_enabled("b1", False, 4.0)  # of the other map
    keeper.set_map(flat())
    assert [(border.id, border.enabled) for border in keeper.borders] == [("b1", False)]
    keeper.confirm(True, "ground floor")
    again = restart(flat(plan=1, seed=4))
    assert ([border.name for border in again.borders], again.map_name) == (["bath"], "upstairs")


def test_floors_with_the_same_walls_are_distinguished_by_their_names(restart):
    for name in ("ground", "upstairs"):
        keeper = restart(flat(seed=len(name)), map_name=name)
        assert keeper.borders == ()
        keeper.add(keep_out(name=name), 1.0)
    for seed, name in enumerate(("upstairs", "ground"), 10):
        keeper = restart(flat(seed=seed), map_name=name)
        assert ([border.name for border in keeper.borders], keeper.needs_confirmation) == ([name], False)
    # without a name both fit, so a person is asked
    keeper = restart(flat(seed=20))
    assert (keeper.needs_confirmation, len(keeper.borders)) == (True, 1)


def test_a_place_without_borders_keeps_neither_its_name_nor_the_named_place_from_others(restart):
    """Otherwise borders drawn on the second map of "upstairs" are gone on the third if the first one's was removed."""
    keeper = restart(flat(), map_name="upstairs")
    keeper.remove(keeper.add(keep_out(), 1.0).ids[0])
    keeper.set_map(flat(seed=1))
    keeper.add(keep_out(name="rug"), 2.0)
    for seed in (2, 1, 0):
        keeper = restart(flat(seed=seed), map_name="upstairs")
        assert (closed_off(keeper), keeper.map_name) == (True, "upstairs")
        assert (keeper.notices, [border.name for border in keeper.borders]) == ([], ["rug"])
    keeper.add(keep_out(Transform(6.4, 0.0, 0.0)), 3.0)  # now the first map belongs to that place
    places = {stored_map.place for stored_map in keeper._database.maps().values()}
    assert places == {keeper._database.find_place("upstairs")}


def test_a_map_that_grows_cell_by_cell_stays_confirmed(restart):
    keeper = restart(flat(known=(0.0, 4.0)), borders=[keep_out()])
    for width in (5.0, 6.0, 7.0, 9.0):
        keeper.set_map(flat(known=(0.0, width)))
        assert (closed_off(keeper), keeper.needs_confirmation) == (True, False)
    # nor is anybody asked about a border on floor that the first map does not know
    keeper.add(keep_out(Transform(6.4, 0.0, 0.0)), 2.0)
    assert (keeper.needs_confirmation, closed_off(keeper, Transform(6.4, 0.0, 0.0))) == (False, True)


# ----------------------------------------------------------------- borders in force, or why not
def test_undo_and_switches_keep_what_does_not_act():
    """Otherwise they answer "changed back", and the display shows in red a border that restricts not one cell."""
    keeper = integrator(grid=flat(), borders=[keep_out(), keep_out(Transform(5.0, -3.0, 0.0))])
    keeper.remove("b1")
    walled = flat()
    walled.data[walled.world_to_cell(ROOM.apply([(-0.4, -0.4)]))[0][0] :, :] = 100
    keeper.set_map(walled)
    keeper.confirm(True, "")
    outcome = keeper.undo()
    assert [issue.code for issue in outcome.issues] == ["inactive_on_this_map"]
    assert_fields(first_status(keeper), enabled=True, is_in_force=False, reason="inactive_on_this_map")
    assert "inactive_on_this_map" in [notice.code for notice in keeper.notices]
    assert keeper.set_enabled("b1", False, 3.0).issues == ()
    assert [issue.code for issue in keeper.set_enabled("b1", True, 6.0).issues] == ["inactive_on_this_map"]
    # it can be switched and renamed all the same, by either service
    assert keeper.rename("b1", "old rug", 7.0).ids == ("b1",)
    keeper.update(keeper.borders[0].replace(enabled=False), 8.0)
    assert_fields(first_status(keeper), is_in_force=False, reason="disabled", needs_confirmation=False, name="old rug")


def test_a_changed_border_is_not_overwritten():
    keeper = integrator(grid=flat(), borders=[keep_out()])
    seen = keeper.revision
    keeper.rename("b1", "rug", 2.0, expected_revision=seen)
    for action in (
        lambda: keeper.update(keep_out(id="b1"), 3.0, expected_revision=seen),
        lambda: keeper.remove("b1", expected_revision=seen),
        lambda: keeper.set_enabled("b1", False, 3.0, expected_revision=seen),
        lambda: keeper.add(keep_out(), 3.0, expected_revision=seen),
    ):
        with refused("revision_conflict"):
            action()
    assert keeper.borders[0].name == "rug"


def test_slow_zones_limit_speeds_and_leave_the_map_alone():
    keeper = integrator(grid=flat(), borders=[keep_out(zone="slow", max_speed=speed) for speed in (0.3, 0.15)])
    assert np.array_equal(keeper.map_with_borders.data, keeper.physical_map.data)
    limits = keeper.borders_in_force.speed_limits
    assert (sorted(np.unique(limits.data)), (limits.data == 15).sum()) == ([0, 15], 400)
    keeper.undo()
    assert sorted(np.unique(keeper.borders_in_force.speed_limits.data)) == [0, 30]
    assert keeper.borders_in_force.statuses["b1"].area_m2 == pytest.approx(1.0)
    keeper.remove("b1")
    assert not keeper.borders_in_force.speed_limits.data.any()
    keeper.add(keep_out(zone="slow", max_speed=1.27), 1.0)
    assert keeper.borders_in_force.speed_limits.data.max() == 127


def test_a_zone_to_avoid_is_a_cost():
    keeper = integrator(grid=flat(), borders=[keep_out(zone="avoid", occupancy=0.4)])
    assert (keeper.map_with_borders.data == 40).sum() == 400
