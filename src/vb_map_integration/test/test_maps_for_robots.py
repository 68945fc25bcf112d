"""Borders that name robots hold for them alone."""

import numpy as np

from integrators import GRID, integrator, square


def test_each_robot_has_the_borders_that_name_it_or_nobody():
    keeper = integrator()
    keeper.add(square(30, 30), 1.0)
    common = keeper.map_with_borders.data.copy()
    keeper.add(square(80, 30, robots=("ada",)), 2.0)
    keeper.add(square(80, 60, robots=("bob", "eve")), 3.0)
    everything = keeper.map_with_borders.data
    ada, bob, zoe = (keeper.map_with_borders_for(name).data for name in ("ada", "bob", "zoe"))
    assert np.array_equal(zoe, common)
    assert (ada == 100).sum() > (common == 100).sum() and (bob == 100).sum() > (common == 100).sum()
    assert np.array_equal(np.maximum(ada, bob), everything), "the common map has them all"
    assert not np.array_equal(ada, bob)
    keeper.undo()
    keeper.undo()
    assert np.array_equal(keeper.map_with_borders_for("ada").data, common)
    keeper.undo()
    assert np.array_equal(keeper.map_with_borders_for("ada").data, GRID.data)
