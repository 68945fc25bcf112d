"""Simulates a person who walks among furniture and chooses positions for pointing."""

from __future__ import annotations

import contextlib
import itertools
import math
from typing import Optional, Tuple

import numpy as np
from shapely.geometry import LineString, Point

from vb_core import geometry
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_sim.model_params import ParticipantModel
from vb_sim.robot.path_planner import Costmap, Planner

ROBOT_DISTANCE = 0.5  # [m] minimum distance between the centres of a person and a robot
PREFERRED_CLEARANCE = 0.15  # [m] clearance that a person prefers to obstacles
NEAREST_STAND = 0.8  # [m] from the spot, below which the person's body blocks the view


def distance_to_chain(point: np.ndarray, chain: np.ndarray) -> float:
    """Measures the distance [m] from a point (2,) [m] to a chain (N, 2) [m]."""
    return Point(point).distance(LineString(chain) if len(chain) > 1 else Point(chain[0]))


class Walker:
    """A person's position and path in a room.

    Args:
        grid: the physical map.
        position: (2,) [m] the person's position.

    Attributes:
        robot: (2,) [m] the robot's position, which the person sees; None until it is known.
    """

    def __init__(self, grid: GridMap, model: ParticipantModel, position: np.ndarray) -> None:
        self._grid = grid
        self._model = model
        self._planner = Planner(Costmap(grid, model.body_radius, inflation=PREFERRED_CLEARANCE))
        self._path = np.zeros((0, 2))
        self._waiting_time = 0.0
        self._planner_with_robot: Optional[Tuple[np.ndarray, Planner]] = None
        self.position = np.asarray(position, dtype=float)
        self.yaw = 0.0
        self.robot: Optional[np.ndarray] = None

    @property
    def walking(self) -> bool:
        """Whether the person is still walking."""
        return len(self._path) > 0

    def find_position_near(
        self, position: np.ndarray, nearest: float, farthest: float, rng: np.random.Generator
    ) -> np.ndarray:
        """Chooses a random position (2,) [m], `nearest` to `farthest` [m] from `position`, with a path between them."""
        for _ in range(200):
            angle = rng.uniform(0.0, 2.0 * math.pi)
            distance = rng.uniform(nearest, farthest)
            candidate = position + distance * np.array([math.cos(angle), math.sin(angle)])
            path = self._plan(candidate, position)
            if len(path) and geometry.chain_length(path) < farthest + 1.0:
                return candidate
        return np.asarray(position, dtype=float)

    def walk_to(self, position: np.ndarray) -> None:
        """Starts walking to a position (2,) [m], or within 0.4 m of an inaccessible one, if a path leads there."""
        self._path = self._plan(self.position, np.asarray(position, dtype=float), self.robot, 0.4)
        self._waiting_time = 0.0

    def go_to_point_at(self, spot: np.ndarray, line: np.ndarray, away_from: Optional[np.ndarray] = None) -> None:
        """Starts walking to the nearest position, if any, that suits pointing at a spot (2,) [m].

        Args:
            line: (N, 2) [m] the line being drawn, on which the person does not stand.
            away_from: (2,) [m] a position to leave, from which the body may hide the spot.
        """
        candidates = []
        angles = np.linspace(0.0, 2.0 * math.pi, 24, endpoint=False)
        for radius, angle in itertools.product((1.0, 1.4, 1.8, 2.2), angles):
            candidate = spot + radius * np.array([math.cos(angle), math.sin(angle)])
            is_aside = away_from is None or np.linalg.norm(candidate - away_from) > 0.7
            if is_aside and self.is_good_position(candidate, spot, line):
                candidates.append(candidate)
        for candidate in sorted(candidates, key=lambda candidate: math.dist(candidate, self.position))[:6]:
            path = self._plan(self.position, candidate, self.robot)
            # skips a position on the other side of a wall, to which the path is long
            longest_path = 2.0 * math.dist(candidate, self.position) + 1.0
            if len(path) and geometry.chain_length(path) < longest_path:
                return self.walk_to(candidate)

    def stop(self) -> None:
        """Stops the person."""
        self._path = np.zeros((0, 2))

    def step(self, dt: float, look_at: Optional[np.ndarray]) -> None:
        """Walks for `dt` [s] without running into the robot, and turns to `look_at` (2,) [m] or the goal."""
        remaining = self._model.walking_speed * dt
        target = look_at
        while remaining > 0.0 and len(self._path):
            to_next = self._path[0] - self.position
            distance = float(np.linalg.norm(to_next))
            stride = min(remaining, distance)
            position = self.position + to_next / distance * stride if distance > 1e-9 else self._path[0]
            if self._runs_into(position):
                self._waiting_time += dt
                if self._waiting_time > 1.0:
                    self.walk_to(self._path[-1])
                break
            self.position = position
            target = self._path[-1] if look_at is None else look_at
            remaining -= max(stride, 1e-6)
            if distance <= stride + 1e-9:
                self._path = self._path[1:]
        if target is not None and np.linalg.norm(target - self.position) > 0.05:
            heading = math.atan2(target[1] - self.position[1], target[0] - self.position[0])
            turn = geometry.wrap_angle(heading - self.yaw)
            limit = self._model.turning_speed * dt
            self.yaw = geometry.wrap_angle(self.yaw + min(max(turn, -limit), limit))

    def is_good_position(self, position: np.ndarray, spot: np.ndarray, line: np.ndarray) -> bool:
        """Returns whether a position (2,) [m] is in reach of the spot, off the line, and out of the robot's way."""
        distance = float(np.linalg.norm(position - spot))
        if not (NEAREST_STAND <= distance <= self._model.reach and self._planner.is_traversable(position)):
            return False
        if len(line) and distance_to_chain(position, line) < 0.4:
            return False
        if self.robot is None:
            return True
        if np.linalg.norm(position - self.robot) < ROBOT_DISTANCE + 0.1:
            return False
        return distance_to_chain(position, np.array([self.robot, spot])) >= 0.45

    def _runs_into(self, position: np.ndarray) -> bool:
        if self.robot is None:
            return False
        distance = float(np.linalg.norm(position - self.robot))
        present_distance = float(np.linalg.norm(self.position - self.robot))
        return distance < min(ROBOT_DISTANCE, present_distance)

    def _plan(
        self, start: np.ndarray, goal: np.ndarray, robot: Optional[np.ndarray] = None, tolerance: float = 0.0
    ) -> np.ndarray:
        """Plans a path (N, 2) [m]. Returns (0, 2) if there is none."""
        # if a robot stands in a doorway, a path through it is better than none, as the robot may move away
        planners = [self._planner] if robot is None else [self._planner_avoiding(robot), self._planner]
        for planner in planners:
            with contextlib.suppress(CodedError):
                return planner.plan(start, goal, tolerance)
        return np.zeros((0, 2))

    def _planner_avoiding(self, robot: np.ndarray) -> Planner:
        """Returns a planner with the robot as an obstacle, and reuses it while the robot hardly moves."""
        if self._planner_with_robot is None or np.linalg.norm(self._planner_with_robot[0] - robot) > 0.1:
            rows, columns = np.indices(self._grid.shape)
            column, row = self._grid.world_to_grid(robot)[0]
            radius = self._model.body_radius
            distances = np.hypot(rows - row, columns - column) * self._grid.resolution
            # a disc stands for the robot; its radius and the person's add up to the distance that the person keeps
            costmap = Costmap(self._grid, radius, distances < ROBOT_DISTANCE - radius, PREFERRED_CLEARANCE)
            self._planner_with_robot = (np.array(robot), Planner(costmap))
        return self._planner_with_robot[1]
