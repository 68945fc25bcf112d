"""A robot's arbiter in a closed loop, without ROS: it drives a unicycle through an empty room."""

import math

import numpy as np

from plain_rooms import VIEW, empty, scan_of
from vb_core.geometry import map_to_base
from vb_core.interaction_tables import DEFAULT, GUIDE
from vb_core.robot_profile import RobotProfile
from vb_core.stop_latch import StopLatch
from vb_robot.driving.arbiter import Arbiter
from vb_robot.driving.command_gate import NAVIGATION, TELEOP
from vb_robot.driving.localization import PoseUncertainty
from vb_robot.driving.workspace import Workspace
from vb_robot.spot_sightings import Sighting
from vb_sim.robot.robot_body import advance

DT, PROFILE = 0.05, RobotProfile()


class Rig:
    """An arbiter on a unicycle in an empty room; inputs named in `silent` do not arrive."""

    def __init__(self, pose=(2.0, 2.5, 0.0), grid=None, camera="robot", cameras=("robot",)):
        self.now, self.pose = 100.0, pose
        self.silent = set()
        self.arbiter = Arbiter(PROFILE, camera, cameras)
        self.set_grid(grid or empty())
        self.camera, self.latch = camera, StopLatch()
        self.state = (DEFAULT, "", 0.0)
        self.spot = self.navigation = self.teleop = None
        self.ranges = np.full(360, math.inf)
        self.commands, self.cancelled = [], 0
        self.goal = False  # whether navigation has a goal
        self.pose_error = 0.0  # [m] by which the believed position is behind the true one
        self._said, self._stood, self.correction = -math.inf, 0.0, 0.0

    def set_grid(self, grid):
        self.arbiter.gate.workspace = Workspace(grid, empty(), PROFILE.radius, uncertainty=PoseUncertainty().meters)

    def set_state(self, state, interaction="a"):
        interaction = "" if state == DEFAULT else interaction
        self.state = (state, interaction, self.now)
        self._said = -math.inf

    def see(self, place, camera):
        """Tells the arbiter that a robot's camera sees the spot."""
        self.arbiter.add(Sighting(self.now, tuple(place), camera, True))

    def step(self, seconds=DT):
        for _ in range(max(1, int(round(seconds / DT)))):
            self._step()
        return self.commands[-1]

    def _step(self):
        self.now += DT
        if "state" not in self.silent and self.now - self._said >= 0.1 - 1e-9:
            self._said = self.now
            self.arbiter.set_state(*self.state, self.now)
            self.arbiter.stops.update_from_latch(self.latch.stopped, self.latch.stops)
        if "pose" not in self.silent:
            if "localisation" not in self.silent:
                self.correction = self.now + 0.3  # dated ahead, as AMCL does
            x, y, yaw = self.pose
            believed = x - self.pose_error * math.cos(yaw), y - self.pose_error * math.sin(yaw), yaw
            self.arbiter.gate.set_pose(believed, self.now, self.correction)
        if "scan" not in self.silent:
            self.arbiter.gate.set_scan(scan_of(self.ranges), self.now)
        if self.spot is not None and VIEW.sees(map_to_base(np.array([self.spot]), self.pose))[0]:
            self.see(self.spot, self.camera)
        for source, velocity in ((NAVIGATION, self.navigation), (TELEOP, self.teleop)):
            if velocity is not None:
                self.arbiter.request(source, *velocity, self.now)
        # its clock stops while the world goes on
        self._stood = self.arbiter.gate.clock_age = self._stood + DT if "clock" in self.silent else 0.0
        if "goal" not in self.silent and self.goal:
            self.arbiter.set_goal_active(True, self.now)
        command = self.arbiter.step(self.now)
        self.cancelled += command.cancel
        self.commands.append(command)
        self.pose = advance(self.pose, command.v * DT, command.w * DT)

    def drives(self, v=0.3, w=0.0):
        """Lets navigation drive the robot, and checks that it does; returns the rig."""
        self.navigation = (v, w)
        assert self.step(1.0).v == v
        return self

    def follows(self, distance=1.6):
        """Guides the robot to a spot ahead, and checks that it follows; returns the rig."""
        self.set_state(GUIDE)
        self.spot = (self.pose[0] + distance, self.pose[1])
        self.step(0.8)
        assert self.commands[-1].source == "follow"
        assert self.commands[-1].v > 0.1
        return self
