"""The simulated lab as a whole: its robots, and what the participant does in it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import List, Optional, Tuple

import numpy as np

from vb_sim.room.floor_plan import physical_map
from vb_sim.models import Models
from vb_sim.room.raycast import DistanceField, cast_disc
from vb_sim.robot.robot_body import RobotBody
from vb_sim.room.world import World

PARTICIPANT_SILENCE = 0.5  # [s] after which the participant counts as gone


@dataclass(frozen=True)
class Participant:
    """The participant's last message.

    Attributes:
        laser: (x, y) [m] of the spot, None while it is off.
        pose: (x, y, yaw) [m, m, rad], None if nobody is there.
        stamp: [s]
    """

    laser: Optional[Tuple[float, float]] = None
    laser_color: str = "red"
    pose: Optional[Tuple[float, float, float]] = None
    doing: str = ""
    stamp: float = -math.inf


class Lab:
    """Steps everything that moves. Not thread-safe: the caller holds a lock."""

    def __init__(self, world: World, models: Models = Models(), seed: int = 0) -> None:
        self.world, self.models = world, models
        self.field = DistanceField(physical_map(world))
        sequence = np.random.SeedSequence(seed).spawn(len(world.robots) + 1)
        self._scan_rng = np.random.default_rng(sequence[-1])
        self.robots: List[RobotBody] = [
            RobotBody(item.start_pose(), item.radius, models, self.field.clearance, np.random.default_rng(child))
            for item, child in zip(world.robots, sequence)
        ]
        self._participant = Participant()
        self.now = 0.0

    def step(self, dt: float, now: float) -> None:
        """Moves everything on by `dt` [s] to the time `now` [s]."""
        self.now = now
        for body in self.robots:
            body.step(dt, now)

    def set_participant(self, participant: Participant) -> None:
        """Sets what the participant does now."""
        self._participant = replace(participant, stamp=self.now)

    def participant(self) -> Participant:
        """Returns what the participant does; one who is silent for too long stands there with the laser off."""
        if self.now - self._participant.stamp > PARTICIPANT_SILENCE:
            return Participant(pose=self._participant.pose)
        return self._participant

    def scan(self, index: int) -> Tuple[np.ndarray, np.ndarray]:
        """Simulates one robot's scanner: angles (N,) [rad] in the robot's frame and ranges (N,) [m].

        As REP 117 has it: inf where nothing is, -inf where something is nearer than the scanner can measure.
        """
        model = self.models.scan
        angles = -math.pi + 2.0 * math.pi / model.beams * np.arange(model.beams)
        x, y, yaw = self.robots[index].pose
        ranges = self.field.cast((x, y), angles + yaw, model.range_max)
        discs = [
            (body.pose[:2], item.radius)
            for other, (body, item) in enumerate(zip(self.robots, self.world.robots))
            if other != index
        ]
        person = self.participant().pose
        if person is not None:
            discs.append((person[:2], model.person_radius))
        for center, radius in discs:
            ranges = np.minimum(ranges, cast_disc((x, y), angles + yaw, center, radius))
        ranges = ranges + model.range_sigma * self._scan_rng.standard_normal(model.beams)
        ranges[ranges > model.range_max] = np.inf
        ranges[ranges < model.range_min] = -np.inf
        return angles, ranges

    def reset(self) -> None:
        """Puts every robot to its start."""
        for body in self.robots:
            body.reset()
