"""The drives of drives.py: goals round each scenario's border and inside it, drawn by a seed."""

import functools

import numpy as np

from bench.harness import TOP
from vb_core.grid_map import distance_to, sample
from vb_core.navigation_parameters import PATH_MARGIN
from vb_map_integration.border import VirtualBorder as Border
from vb_map_integration.integration import integrate
from vb_robot.clearance_map import STOP_MARGIN, ClearanceMap
from vb_sim.room.floor_plan import physical_map
from vb_sim.room.world import load_world

WORLDS = TOP / "src" / "vb_sim" / "worlds"
SCENARIOS = ("carpet", "corner", "room")
RADIUS = 0.18  # [m] of the larger robot: both drive to the same places
ROUNDS, NOSES = 40, 20  # goals round each border; borders put in front of the robot, and as many boxes on the path
INSIDE = 2  # goals inside each border
MIN_LEG = 0.6  # [m] at least, between two poses


@functools.lru_cache(maxsize=None)
def places(scenario: str, seed: int):
    """Returns poses (x, y, yaw) [m, m, deg]: a chain round a scenario's border, and some inside the restricted area.

    In the chain a robot of RADIUS has the room that the dispatcher requires, and a path from each pose to the next.
    """
    world = load_world(str(WORLDS / "lab.yaml"))
    what, grid = world.scenarios[scenario], physical_map(world)
    posterior = integrate(grid, Border(np.array(what.border), np.array(what.seed), 1.0, what.closed)).posterior
    restricted = posterior.data > np.maximum(grid.data, 0)
    rng = np.random.default_rng([seed, SCENARIOS.index(scenario)])
    clearance_map = ClearanceMap(posterior, RADIUS + PATH_MARGIN)
    cells = posterior.cell_to_world(np.argwhere(clearance_map.clearance >= RADIUS + STOP_MARGIN))
    yaws = rng.integers(-180, 180, 1000)
    chain = [(*cells[rng.integers(len(cells))], 0)]
    if scenario == "corner":  # the unrestricted floor may have other parts, such as behind furniture
        chain = [(6.8, 4.2, 0)]
    while len(chain) <= ROUNDS // 2:
        here = np.array(chain[-1][:2])
        drawn = cells[rng.integers(len(cells), size=300)]
        drawn = drawn[
            (np.linalg.norm(drawn - here, axis=1) >= MIN_LEG) & np.isfinite(clearance_map.path_lengths(here, drawn))
        ]
        if not len(drawn):
            chain[-1] = (*cells[rng.integers(len(cells))], 0)  # no path leads on from here
            continue
        lines = here + np.linspace(0.0, 1.0, 100)[None, :, None] * (drawn - here)[:, None, :]
        through = sample(posterior, restricted, lines.reshape(-1, 2)).reshape(len(drawn), -1).any(axis=1)
        chain.append((*drawn[int(np.argmax(through))], int(yaws[len(chain)])))
    inside = posterior.cell_to_world(
        np.argwhere(restricted & (distance_to(~restricted) * posterior.resolution > RADIUS))
    )
    inside = [(*inside[rng.integers(len(inside))], 0) for _ in range(INSIDE)]
    return [tuple(float(round(value, 3)) for value in place) for place in (*chain, *inside)]


def tasks(seed: int):
    """Yields the drives, (kind, scenario, number, from, to), in turns, so that each part of them covers all."""
    for begin in range(0, ROUNDS, 10):
        for scenario in SCENARIOS:
            chain, inside = places(scenario, seed)[:-INSIDE], places(scenario, seed)[-INSIDE:]
            both = chain + chain[-2::-1]
            yield from (("round", scenario, i, both[i], both[i + 1]) for i in range(begin, begin + 10))
            if begin == 0:
                yield from (("inside", scenario, i, both[10], goal) for i, goal in enumerate(inside))
        share = NOSES * 10 // ROUNDS
        for kind in ("nose", "box"):
            numbers = range(begin // 10 * share, (begin // 10 + 1) * share)
            yield from ((kind, "", i, (7.0, 0.9, 180), None) for i in numbers)
