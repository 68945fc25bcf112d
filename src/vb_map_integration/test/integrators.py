"""Maps of a room and of a flat, borders in them, and integrators that keep them."""

import numpy as np
import shapely

from vb_core.grid_map import GridMap, Transform, sample
from vb_map_integration.border import VirtualBorder
from vb_map_integration.border_region import compute_region
from vb_map_integration.map_integrator import MapIntegrator


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


OUTSIDE = [(0, 0), (9, 0), (9, 6), (0, 6), (0, 0)]
PLANS = [
    shapely.from_wkt(f"MULTILINESTRING ((0 0, 9 0, 9 6, 0 6, 0 0), {walls})")
    for walls in (
        "(3.1 0, 3.1 1.2), (3.1 2.1, 3.1 6), (3.1 3.7, 4.4 3.7), (5.3 3.7, 9 3.7), (7 3.7, 7 6)",
        "(5.6 0, 5.6 3), (5.6 4, 5.6 6), (0 2.2, 1.5 2.2), (2.4 2.2, 5.6 2.2), (2 2.2, 2 6)",
    )
]


def flat(transform=Transform(), resolution=0.05, seed=0, plan=0, known=(0.0, 9.0)):
    """Returns a map of a flat of 9 m x 6 m with four different rooms, as from SLAM: ragged, at any pose.

    Args:
        plan: 0, or 1 for another floor with the same outer walls.
        known: [m] the range of its width that was explored.
    """
    random = np.random.default_rng(seed)
    corners = transform.apply([(0, 0), (9, 0), (9, 6), (0, 6)])
    origin = corners.min(axis=0) - 0.37
    columns, rows = np.ceil((corners.max(axis=0) + 0.4 - origin) / resolution).astype(int)
    grid = GridMap(np.full((rows, columns), -1, np.int8), resolution, (float(origin[0]), float(origin[1]), 0.0))
    cells = np.argwhere(np.ones(grid.shape, bool))
    place = transform.inverse.apply(grid.cell_to_world(cells))
    inside = (place > 0).all(axis=1) & (place < (9, 6)).all(axis=1)
    distance = shapely.distance(PLANS[plan], shapely.points(place))
    values = np.where(distance < 0.06 + 0.02 * random.random(len(place)), 100, np.where(inside, 0, -1))
    values[(place[:, 0] < known[0]) | (place[:, 0] > known[1])] = -1
    return grid.with_data(values.astype(np.int8).reshape(grid.shape))


ROOM = Transform(1.0, 4.0, 0.0)  # a square in the room at the upper left


def keep_out(transform=Transform(), **options):
    """Returns the outline of that square, moved."""
    *corners, seed = transform.apply(ROOM.apply([(0, 0), (1, 0), (1, 1), (0, 1), (0.5, 0.5)]))
    return VirtualBorder(corners, seed, closed=True, **options)


def closed_at(keeper, x, y):
    """Returns whether a point [m] is closed in the map that navigation gets."""
    return sample(keeper.map_with_borders, keeper.map_with_borders.data, [(x, y)])[0] == 100


def closed_off(keeper, transform=Transform()):
    """Returns whether the middle of the border is closed."""
    return closed_at(keeper, *transform.apply(keep_out().seed[None])[0])


def integrator(root=None, grid=GRID, borders=(), **params):
    """Makes an integrator with a map, and adds borders at the time 1.0."""
    result = MapIntegrator(root, **params)
    if grid is not None:
        result.set_map(grid)
    for border in borders:
        result.add(border, 1.0)
    return result


def first_status(keeper):
    """Returns the first border's fields and status, and whether a person must confirm the map, for `assert_fields`."""
    status = next(iter(keeper.borders_in_force.statuses.values()))
    fields = {"is_in_force": status.is_in_force, "reason": status.reason, "area_m2": status.area_m2}
    return {**vars(status.map_border), **fields, "needs_confirmation": keeper.needs_confirmation}


def expected(keeper):
    """Returns the cells of the map with borders, computed border by border."""
    grid = keeper.physical_map
    posteriors = [compute_region(grid, border).posterior.data for border in keeper.borders if border.enabled]
    return np.max([grid.data, *posteriors], axis=0)
