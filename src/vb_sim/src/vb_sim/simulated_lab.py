"""The simulated lab as a whole: its robots, and the person among them."""

from __future__ import annotations

import math
from typing import List, Optional, Tuple

import numpy as np

from vb_sim.room.floor_plan import physical_map
from vb_sim.models import Models
from vb_sim.room.raycast import DistanceField, cast_disc
from vb_sim.robot.robot_body import RobotBody
from vb_sim.room.world import World


class Lab:
    """Steps the robots. Not thread-safe: the caller must hold a lock.

    Attributes:
        person: (x, y, yaw) [m, m, rad] of the participant, None if nobody is there.
    """

    def __init__(self, world: World, models: Models = Models(), seed: int = 0) -> None:
        self.world, self.models = world, models
        self.field = DistanceField(physical_map(world))
        sequence = np.random.SeedSequence(seed).spawn(len(world.robots) + 1)
        self._scan_rng = np.random.default_rng(sequence[-1])
        self.robots: List[RobotBody] = [
            RobotBody(item.start_pose(), item.radius, models, self.field.clearance, np.random.default_rng(child))
            for item, child in zip(world.robots, sequence)
        ]
        self.person: Optional[Tuple[float, float, float]] = None
        self.now = 0.0

    def step(self, dt: float, now: float) -> None:
        """Advances all robots by `dt` [s], to the time `now` [s]."""
        self.now = now
        for body in self.robots:
            body.step(dt, now)

    def scan(self, index: int) -> Tuple[np.ndarray, np.ndarray]:
        """Simulates one robot's scanner: angles (N,) [rad] in the robot's frame and ranges (N,) [m].

        As in REP 117, inf means that nothing is in range, -inf that something is nearer than the scanner can measure.
        """
        model = self.models.scan
        angles = -math.pi + 2.0 * math.pi / model.beams * np.arange(model.beams)
        x, y, yaw = self.robots[index].pose
        ranges = self.field.cast((x, y), angles + yaw, model.range_max)
        discs = [(body.pose[:2], robot.radius) for body, robot in zip(self.robots, self.world.robots)]
        del discs[index]  # a robot does not see itself
        if self.person is not None:
            discs.append((self.person[:2], model.person_radius))
        for center, radius in discs:
            ranges = np.minimum(ranges, cast_disc((x, y), angles + yaw, center, radius))
        ranges = ranges + model.range_sigma * self._scan_rng.standard_normal(model.beams)
        ranges[ranges > model.range_max] = np.inf
        ranges[ranges < model.range_min] = -np.inf
        return angles, ranges
