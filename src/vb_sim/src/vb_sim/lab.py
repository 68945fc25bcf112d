"""The simulated lab as a whole: its robots, and what the participant does in it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import List, Tuple

import numpy as np

from vb_sim.room.floor_plan import physical_map
from vb_sim.robot.motion_models import LocalizationModel, RobotModel, ScanModel
from vb_sim.room.raycast import DistanceField, cast_disc
from vb_sim.robot.robot_body import RobotBody
from vb_sim.room.world import World

PARTICIPANT_SILENCE = 0.5  # [s] after which the participant counts as gone


@dataclass(frozen=True)
class Participant:
    """The participant's last message."""

    laser_on: bool = False
    laser: Tuple[float, float] = (0.0, 0.0)
    laser_color: str = "red"
    present: bool = False
    pose: Tuple[float, float, float] = (0.0, 0.0, 0.0)
    doing: str = ""
    stamp: float = field(default=-math.inf)


class Lab:
    """Steps everything that moves. Not thread-safe: the caller holds a lock."""

    def __init__(
        self,
        world: World,
        robot: RobotModel = RobotModel(),
        localization: LocalizationModel = LocalizationModel(),
        scan: ScanModel = ScanModel(),
        seed: int = 0,
    ) -> None:
        self.world = world
        self.field = DistanceField(physical_map(world))
        self.scan_model = scan
        sequence = np.random.SeedSequence(seed).spawn(len(world.robots) + 1)
        self._scan_rng = np.random.default_rng(sequence[-1])
        self.robots: List[RobotBody] = [
            RobotBody(
                item.start_pose(), item.radius, robot, localization, self.field.clearance, np.random.default_rng(child)
            )
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
        self._participant = participant

    def participant(self) -> Participant:
        """Returns what the participant does; laser off and no person if silent for too long."""
        if self.now - self._participant.stamp > PARTICIPANT_SILENCE:
            # a laser pointer goes out when the hand lets go; the person himself does not vanish
            return Participant(present=self._participant.present, pose=self._participant.pose)
        return self._participant

    def scan(self, index: int) -> Tuple[np.ndarray, np.ndarray]:
        """Simulates one robot's scanner: angles (N,) [rad] in the robot's frame and ranges (N,) [m].

        As REP 117 has it: inf where nothing is, -inf where something is nearer than the scanner can measure.
        """
        model = self.scan_model
        angles = -math.pi + 2.0 * math.pi / model.beams * np.arange(model.beams)
        x, y, yaw = self.robots[index].pose
        ranges = self.field.cast((x, y), angles + yaw, model.range_max)
        discs = [
            (body.pose[:2], item.radius)
            for other, (body, item) in enumerate(zip(self.robots, self.world.robots))
            if other != index
        ]
        participant = self.participant()
        if participant.present:
            discs.append((participant.pose[:2], model.person_radius))
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
