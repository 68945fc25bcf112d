"""A person's walking among the furniture, and the search for positions to point from."""

from __future__ import annotations

import contextlib
import math
from typing import Optional, Tuple

import numpy as np
from shapely.geometry import LineString, Point

from vb_core import geometry
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_sim.models import ParticipantModel
from vb_sim.robot.path_planner import Costmap, Planner

ROBOT_DISTANCE = 0.5  # [m] least distance between the centres of a person and a robot
BERTH = 0.15  # [m] clearance that a person keeps from obstacles where there is room
NEAREST_STAND = 0.8  # [m] from the spot: nearer, the person's body blocks the view


def distance_to_chain(point: np.ndarray, chain: np.ndarray) -> float:
    """Measures the distance [m] from a point (2,) [m] to a chain (N, 2) [m]."""
    return Point(point).distance(LineString(chain) if len(chain) > 1 else Point(chain[0]))


class Walker:
    """A person's position and path in a room.

    Args:
        grid: the physical map.
        here: (2,) [m] where the person is.

    Attributes:
        robot: (2,) [m] where the robot is, which the person sees; None until it is known.
    """

    def __init__(self, grid: GridMap, model: ParticipantModel, here: np.ndarray) -> None:
        self._grid = grid
        self._model = model
        self._planner = Planner(Costmap(grid, model.body_radius, inflation=BERTH))
        self._way = np.zeros((0, 2))
        self._waited = 0.0
        self._planner_with_robot: Optional[Tuple[np.ndarray, Planner]] = None
        self.here = np.asarray(here, dtype=float)
        self.yaw = 0.0
        self.robot: Optional[np.ndarray] = None

    @property
    def walking(self) -> bool:
        """Whether the person is still walking."""
        return len(self._way) > 0

    def find_place_near(
        self, place: np.ndarray, nearest: float, farthest: float, rng: np.random.Generator
    ) -> np.ndarray:
        """Draws a random position (2,) [m], `nearest` to `farthest` [m] from `place`, with a path to it."""
        for _ in range(200):
            angle, distance = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(nearest, farthest)
            candidate = place + distance * np.array([math.cos(angle), math.sin(angle)])
            way = self._plan(candidate, place)
            if len(way) and geometry.chain_length(way) < farthest + 1.0:
                return candidate
        return np.asarray(place, dtype=float)

    def go(self, place: np.ndarray) -> None:
        """Starts walking to a position (2,) [m], or within 0.4 m of it if it is too narrow, if there is a path."""
        self._way = self._plan(self.here, np.asarray(place, dtype=float), self.robot, 0.4)
        self._waited = 0.0

    def go_to_point_at(self, spot: np.ndarray, line: np.ndarray, away_from: Optional[np.ndarray] = None) -> None:
        """Starts walking to the nearest good position for pointing at a spot (2,) [m], if there is one.

        Args:
            line: (N, 2) [m] what is being drawn: the person does not stand on it.
            away_from: (2,) [m] a position to leave, since the body hides the spot from there.
        """
        angles = np.linspace(0.0, 2.0 * math.pi, 24, endpoint=False)
        around = [np.array([math.cos(angle), math.sin(angle)]) for angle in angles]
        places = [spot + radius * direction for radius in (1.0, 1.4, 1.8, 2.2) for direction in around]
        places = [place for place in places if self.is_good_place(place, spot, line)]
        if away_from is not None:
            places = [place for place in places if np.linalg.norm(place - away_from) > 0.7]
        for place in sorted(places, key=lambda place: float(np.linalg.norm(place - self.here)))[:6]:
            way = self._plan(self.here, place, self.robot)
            # the other side of a wall is near as the crow flies only
            if len(way) and geometry.chain_length(way) < 2.0 * np.linalg.norm(place - self.here) + 1.0:
                return self.go(place)

    def stop(self) -> None:
        """Stops the person."""
        self._way = np.zeros((0, 2))

    def step(self, dt: float, look_at: Optional[np.ndarray]) -> None:
        """Walks on for `dt` [s] without running into the robot, and turns to `look_at` (2,) [m] or the goal."""
        left = self._model.walking_speed * dt
        facing = look_at
        while left > 0.0 and len(self._way):
            to_next = self._way[0] - self.here
            distance = float(np.linalg.norm(to_next))
            stride = min(left, distance)
            after = self.here + to_next / distance * stride if distance > 1e-9 else self._way[0]
            if self._runs_into(after):
                self._waited += dt
                if self._waited > 1.0:
                    self.go(self._way[-1])
                break
            self.here = after
            facing = self._way[-1] if look_at is None else look_at
            left -= max(stride, 1e-6)
            if distance <= stride + 1e-9:
                self._way = self._way[1:]
        if facing is not None and np.linalg.norm(facing - self.here) > 0.05:
            wanted = math.atan2(facing[1] - self.here[1], facing[0] - self.here[0])
            turn = geometry.wrap_angle(wanted - self.yaw)
            limit = self._model.turning_speed * dt
            self.yaw = geometry.wrap_angle(self.yaw + min(max(turn, -limit), limit))

    def is_good_place(self, place: np.ndarray, spot: np.ndarray, line: np.ndarray) -> bool:
        """Returns whether a place (2,) [m] suits pointing: in reach, off the line, clear of the robot and its view."""
        distance = float(np.linalg.norm(place - spot))
        if not (NEAREST_STAND <= distance <= self._model.reach and self._planner.is_traversable(place)):
            return False
        if len(line) and distance_to_chain(place, line) < 0.4:
            return False
        if self.robot is None:
            return True
        return bool(
            np.linalg.norm(place - self.robot) >= ROBOT_DISTANCE + 0.1
            and distance_to_chain(place, np.array([self.robot, spot])) >= 0.45
        )

    def _runs_into(self, after: np.ndarray) -> bool:
        if self.robot is None:
            return False
        near = float(np.linalg.norm(after - self.robot))
        return near < ROBOT_DISTANCE and near < float(np.linalg.norm(self.here - self.robot))

    def _plan(
        self, start: np.ndarray, goal: np.ndarray, robot: Optional[np.ndarray] = None, tolerance: float = 0.0
    ) -> np.ndarray:
        """Plans a path (N, 2) [m]; (0, 2) if there is none."""
        # if no path leads round the robot (in a doorway, at the person's feet), plan as if it will move on
        planners = [self._planner] if robot is None else [self._planner_avoiding(robot), self._planner]
        for planner in planners:
            with contextlib.suppress(CodedError):
                return planner.plan(start, goal, tolerance)
        return np.zeros((0, 2))

    def _planner_avoiding(self, robot: np.ndarray) -> Planner:
        """Returns a planner for which the robot is an obstacle; kept while the robot stays about where it is."""
        if self._planner_with_robot is None or np.linalg.norm(self._planner_with_robot[0] - robot) > 0.1:
            rows, columns = np.indices(self._grid.shape)
            column, row = self._grid.world_to_grid(robot)[0]
            radius, away = self._model.body_radius, np.hypot(rows - row, columns - column) * self._grid.resolution
            # the disc's radius and the person's own make the distance that is kept
            costmap = Costmap(self._grid, radius, away < ROBOT_DISTANCE - radius, BERTH)
            self._planner_with_robot = (np.array(robot), Planner(costmap))
        return self._planner_with_robot[1]
