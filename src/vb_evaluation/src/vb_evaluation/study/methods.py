"""Interaction methods: which cameras look, who drives the robot, and what the person does."""
from __future__ import annotations

from typing import Dict, Tuple, Type

import numpy as np

from vb_sim.participant import ParticipantScript
from vb_sim.participant_nrs import NetworkRobotSystemScript
from vb_sim.participant_robot_only import RobotOnlyScript
from vb_sim.world import Scenario, World


class Method:
    """A method of interacting. To add one: a subclass, and its name in METHODS.

    Attributes:
        title: for people.
        script: what the person does.
        dispatch: whether the robot is sent to the spot.
        follow: whether the robot follows the spot while a border is drawn: "auto", "true" or "false".
    """

    title = ""
    script: Type[ParticipantScript]
    dispatch = False
    follow = "auto"

    @staticmethod
    def cameras(world: World) -> Tuple[str, ...]:
        """The ceiling cameras that look, by name."""
        return tuple(camera.name for camera in world.cameras)

    @staticmethod
    def start_near(world: World, scenario: Scenario) -> np.ndarray:
        """(2,) [m] the person comes from somewhere near this place."""
        return scenario.stand


class NetworkRobotSystem(Method):
    """The paper's: ceiling cameras, and a robot that comes on its own."""

    title = "network robot system"
    script = NetworkRobotSystemScript
    dispatch = True


class RobotOnly(Method):
    """The paper's baseline: nothing but the robot."""

    title = "robot only"
    script = RobotOnlyScript

    @staticmethod
    def cameras(world: World) -> Tuple[str, ...]:
        return ()

    @staticmethod
    def start_near(world: World, scenario: Scenario) -> np.ndarray:
        return np.array(world.robots[0].start[:2])


METHODS: Dict[str, Type[Method]] = {"nrs": NetworkRobotSystem, "robot_only": RobotOnly}
