"""The simulated lab as a whole: its robots and their laser scanners, which also see the person, and its time."""

from __future__ import annotations

import math
import threading
from typing import List, Optional, Set, Tuple

import numpy as np

from vb_core.geometry import Pose
from vb_core.grid_map import OCCUPIED, GridMap, distance_transform
from vb_sim.model_params import Models
from vb_sim.robot.robot_body import RobotBody
from vb_sim.floor_plan import physical_map
from vb_sim.world import Point2, World


class DistanceField:
    """Distances from any point to a map's nearest obstacle, which also speed up ray casting.

    Args:
        grid: a world's physical map, not rotated. Cells that are not free are obstacles, including the unknown cells
            behind the walls.
    """

    def __init__(self, grid: GridMap) -> None:
        self._resolution = grid.resolution
        self._origin = np.array(grid.origin[:2])
        free = np.pad((grid.data >= 0) & (grid.data < OCCUPIED), 1)  # the rim of obstacles ends every beam
        cells = distance_transform(~free)
        # from the cell's centre to the obstacle's edge, half a cell before the obstacle's centre
        self._distance = np.maximum(cells.astype(float) - 0.5, 0.0) * grid.resolution
        self._rows, self._columns = free.shape
        # How far a beam may advance from any point of a cell; 0 in obstacles. Two cells' corners may be 1.4 cells
        # nearer to each other than their centres, but then the beam crosses only a corner of an obstacle's cell.
        safe_steps = np.maximum((cells - 1.0) * grid.resolution, 0.5 * grid.resolution)
        self._steps = np.where(free, safe_steps, 0.0).astype(np.float64).ravel()

    def clearance(self, x: float, y: float) -> float:
        """Returns the interpolated distance [m] from a point to the nearest obstacle's edge; 0 off the map."""
        column = (x - self._origin[0]) / self._resolution + 0.5  # + 1 for the rim, - 0.5 to the cell's centre
        row = (y - self._origin[1]) / self._resolution + 0.5
        c, r = math.floor(column), math.floor(row)
        if not (0 <= c < self._columns - 1 and 0 <= r < self._rows - 1):
            return 0.0
        # bilinear interpolation between the centres of four cells
        right, up = column - c, row - r
        row_weights = np.array([1 - up, up])
        column_weights = np.array([1 - right, right])
        distances = self._distance[r : r + 2, c : c + 2]
        return float(row_weights @ distances @ column_weights)

    def cast_rays(self, origin: Point2, angles: np.ndarray, range_max: float) -> np.ndarray:
        """Returns the ranges (N,) [m] of beams from `origin` [m] at `angles` (N,) [rad] in the map; inf without a hit.

        Uses sphere tracing: each beam advances by the distance that is known to be free, which may be a hundred cells
        of open floor. Only beams that graze a wall advance by half cells.
        """
        direction_x = np.cos(angles) / self._resolution
        direction_y = np.sin(angles) / self._resolution
        start_x = (origin[0] - self._origin[0]) / self._resolution + 1.0
        start_y = (origin[1] - self._origin[1]) / self._resolution + 1.0
        result = np.full(len(angles), np.inf)
        if not (0 <= start_x < self._columns and 0 <= start_y < self._rows):
            return result
        ranges = np.zeros(len(angles))
        beams = np.arange(len(angles))
        while len(beams):
            rows = (start_y + ranges * direction_y).astype(np.int32)
            columns = (start_x + ranges * direction_x).astype(np.int32)
            steps = self._steps[rows * self._columns + columns]
            free = steps > 0.0  # a step of 0 marks an obstacle
            result[beams[~free]] = ranges[~free]
            beams = beams[free]
            ranges = ranges[free] + steps[free]
            direction_x, direction_y = direction_x[free], direction_y[free]
        result[result > range_max] = np.inf
        return result


def cast_disc(origin: Point2, angles: np.ndarray, center: Point2, radius: float) -> np.ndarray:
    """Returns the ranges (N,) [m] at which beams hit a disc, for instance a person's legs; inf if they miss it."""
    to_center = np.asarray(center, dtype=float) - np.asarray(origin, dtype=float)
    along = np.cos(angles) * to_center[0] + np.sin(angles) * to_center[1]
    squared_offset = to_center @ to_center - along**2  # of the beam from the centre
    squared_half_chord = radius**2 - squared_offset
    with np.errstate(invalid="ignore"):
        ranges = along - np.sqrt(squared_half_chord)
    is_hit = (squared_half_chord > 0) & (ranges > 0)
    return np.where(is_hit, ranges, np.inf)


class SimulatedLab:
    """Steps the robots and simulates their scanners. It is not thread-safe: the caller must hold a lock.

    Attributes:
        person: (x, y, yaw) [m, m, rad] of the participant, or None.
    """

    def __init__(self, world: World, models: Models = Models(), seed: int = 0) -> None:
        self.world, self.models = world, models
        self.field = DistanceField(physical_map(world))
        sequence = np.random.SeedSequence(seed).spawn(len(world.robots) + 1)
        self._scan_rng = np.random.default_rng(sequence[-1])
        self.robots: List[RobotBody] = [
            RobotBody(robot, models, self.field.clearance, np.random.default_rng(child))
            for robot, child in zip(world.robots, sequence)
        ]
        self.person: Optional[Pose] = None
        self.now = 0.0

    def step(self, dt: float, now: float) -> None:
        """Moves all robots for `dt` [s], up to time `now` [s]."""
        self.now = now
        for body in self.robots:
            body.step(dt, now)

    def scan(self, index: int) -> Tuple[np.ndarray, np.ndarray]:
        """Returns the angles (N,) [rad], robot's frame, and ranges (N,) [m] that one robot's scanner measures.

        As in REP 117, inf means that nothing is in range, and -inf that an object is too near to be measured.
        """
        model = self.models.scan
        angles = -math.pi + 2.0 * math.pi / model.beams * np.arange(model.beams)
        x, y, yaw = self.robots[index].pose
        ranges = self.field.cast_rays((x, y), angles + yaw, model.range_max)
        bodies = zip(self.robots, self.world.robots)
        discs = [(body.pose[:2], robot.radius) for body, robot in bodies]
        del discs[index]  # a robot does not see itself
        if self.person is not None:
            discs.append((self.person[:2], model.person_radius))
        for center, radius in discs:
            ranges = np.minimum(ranges, cast_disc((x, y), angles + yaw, center, radius))
        ranges = ranges + model.range_sigma * self._scan_rng.standard_normal(model.beams)
        ranges[ranges > model.range_max] = np.inf
        ranges[ranges < model.range_min] = -np.inf
        return angles, ranges


class Lockstep:
    """Makes simulated time wait for the nodes that drive a robot, so that they are in time even on a busy computer.

    While all nodes arrive in every step, `wait` returns once they have. A node that is silent for `timeout` probably
    has nothing to do: from then on `wait` returns at once, until all nodes arrive within one step again.

    Args:
        expected: the names of these nodes.
        timeout: [s] of wall time for which `wait` waits at most.
    """

    def __init__(self, expected: Tuple[str, ...], timeout: float = 1.0) -> None:
        self._expected = set(expected)
        self._timeout = timeout
        self._arrived: Set[str] = set()
        self._active = False
        self._condition = threading.Condition()

    def arrive(self, name: str) -> None:
        """Records that a node has published in this step. Any thread may call it."""
        with self._condition:
            self._arrived.add(name)
            self._condition.notify_all()

    def wait(self) -> None:
        """Ends a step. If all nodes arrived in the last step, waits until all have arrived in this one."""
        with self._condition:
            if self._active:
                self._condition.wait_for(lambda: self._arrived >= self._expected, self._timeout)
            self._active = self._arrived >= self._expected
            self._arrived.clear()
