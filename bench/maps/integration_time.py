#!/usr/bin/env python3
"""Times integration and changes for several map sizes, and also for another version if one is given.

    python3 bench/maps/integration_time.py [--sizes 320x200 4000x4000] [--borders 10 500] [--other REVISION|SRC]

The map is a house of many rooms with doors and table legs, in which flood fills take longer than in a single room.
Times are medians [ms] of thread time over --rounds; versions do the same operations in turns. The column `there` gives
the number of borders on the map before. The time of a change includes its check, the files and the composed map.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any, Callable, Dict

import numpy as np

from bench.harness import ResultTable, arguments, import_from, time_in_turns, versions
from vb_core.grid_map import GridMap


def house(width: int, height: int) -> GridMap:
    """Returns a map of rooms of 160 x 100 cells, with doors and table legs."""
    data = np.zeros((height, width), np.int8)
    for wall in (data[::100], data[:, ::160], data[-1], data[:, -1]):
        wall[...] = 100
    for row in range(50, height - 1, 100):
        data[row : row + 30, 160 : width - 1 : 160] = 0
    for column in range(80, width - 1, 160):
        data[100 : height - 1 : 100, column : column + 30] = 0
    data[40::100, 40::160] = 100
    return GridMap(data, 0.025, (-10.0, -5.0, 0.0))


def border(grid: GridMap, points: np.ndarray, draw: Callable[[], np.ndarray], closed: bool) -> Dict[str, Any]:
    """Returns a border of points (column, row), whose seed is the first drawn point on free floor."""
    seed = draw()
    while grid.data[int(round(seed[1])), int(round(seed[0]))] != 0:
        seed = draw()
    return {"points": grid.grid_to_world(points), "seed": grid.grid_to_world(seed)[0], "closed": closed}


def polygon(grid: GridMap, random: np.random.Generator, share: float) -> Dict[str, Any]:
    """Returns a polygon with 100 points, whose diameter is a share of the map's shorter side."""
    height, width = grid.shape
    radius = 0.5 * share * min(height, width)
    center = random.uniform((radius, radius), (width - radius, height - radius))
    angles = np.linspace(0.0, 2.0 * np.pi, 100, endpoint=False)
    reach = radius * (0.9 + 0.1 * np.cos(7 * angles))
    points = center + np.column_stack([reach * np.cos(angles), reach * np.sin(angles)])
    return border(grid, points, lambda: center + random.uniform(-0.5, 0.5, 2) * radius, closed=True)


def curve(grid: GridMap, random: np.random.Generator) -> Dict[str, Any]:
    """Returns a curve of 100 points across half of the map, whose extensions cross rooms and doors."""
    height, width = grid.shape
    x = width * random.uniform(0.3, 0.7)
    rows = np.linspace(0.25, 0.75, 100) * height
    points = np.column_stack([x + 3.0 * np.sin(rows / 20.0), rows])
    seed_center = np.array([x - 0.2 * width, 0.5 * height])
    return border(grid, points, lambda: seed_center + random.uniform(-5.0, 5.0, 2), closed=False)


class Version:
    """One version of the package with its own database."""

    def __init__(self, source: Any, grid: GridMap, count: int) -> None:
        package = "vb_map_integration"
        modules = [f"{package}.{name}" for name in ("border", "border_region", "map_integrator")]
        self.border, self.regions, self.keeping, maps = import_from(source, *modules, "vb_core.grid_map")
        self.grid = maps.GridMap(grid.data, grid.resolution, grid.origin)
        self.random = np.random.default_rng(1)
        self.folder = Path(tempfile.mkdtemp(prefix="bench_integration_"))
        self.keeper: Any = None
        self.start()
        for number in range(count):
            self.keeper.add(self.make(polygon, 0.1), 1.0 + number)
        self.keeper.add(self.make(polygon, 0.1), 1e4)

    def start(self) -> None:
        if self.keeper is not None:
            self.keeper.close()
        self.keeper = self.keeping.MapIntegrator(self.folder)
        self.keeper.set_map(self.grid)

    def make(self, kind: Callable[..., Dict[str, Any]], *more: float) -> Any:
        return self.border.VirtualBorder(**kind(self.grid, self.random, *more))

    def operations(self) -> Dict[str, Callable[[], Any]]:
        """Returns the operations to time, in the order of each round."""
        compute_region = self.regions.compute_region
        return {
            "integrate a small polygon": lambda: compute_region(self.grid, self.make(polygon, 0.1)).posterior,
            "integrate a large polygon": lambda: compute_region(self.grid, self.make(polygon, 0.7)).posterior,
            "integrate a curve": lambda: compute_region(self.grid, self.make(curve)).posterior,
            "add": lambda: self.keeper.add(self.make(polygon, 0.1), 2e4),
            "undo": lambda: self.keeper.undo(),
            "redo": lambda: self.keeper.redo(),
            "rename": lambda: self.keeper.rename(self.keeper.borders[-1].id, "name", 3e4),
            "remove": lambda: self.keeper.remove(self.keeper.borders[-1].id),
            "start": self.start,
        }


def main() -> None:
    parser = arguments(__doc__, other=True)
    parser.add_argument("--sizes", nargs="+", default=["320x200", "1000x1000", "4000x4000"], metavar="WxH")
    parser.add_argument("--borders", nargs="+", type=int, default=[10], help="number on the map before")
    parser.add_argument("--rounds", type=int, default=9)
    options = parser.parse_args()
    table = ResultTable(options.csv)
    for size in options.sizes:
        grid = house(*map(int, size.split("x")))
        for count in options.borders:
            actions = {name: Version(source, grid, count).operations() for name, source in versions(options).items()}
            for operation in actions["this"]:
                version_actions = {name: operations[operation] for name, operations in actions.items()}
                table.add(
                    cells=size, there=count, operation=operation, **time_in_turns(version_actions, options.rounds)
                )


if __name__ == "__main__":
    main()
