"""A small stand-in for the whole system, to test simulated people without ROS: cameras, robot, commands."""

import math

import numpy as np

from vb_core import geometry
from vb_sim.person.person import CommandReply, Perception
from vb_sim.robot.robot_body import advance

DT = 0.04  # [s] at half the real rate: the same behaviour in half the computing time
COMMANDS = {"define_border": "border", "define_seed": "seed", "guide_robot": "guide"}


class System:
    """Answers commands; sees the spot where `covered` is true or in the robot's view; the robot comes or follows."""

    def __init__(self, script, robot, covered, dispatch_after=2.0, follows=False, refuse_saves=()):
        self.script, self.robot, self.covered = script, robot, covered
        self.follows, self.dispatch_after = follows, dispatch_after
        self.refusals = list(refuse_saves)
        self.perception = Perception(now=100.0, robot=robot)
        self.border, self.seed, self.commands, self.actions, self.robots = [], [], [], [], []
        self.sources = set()
        self._arrives = self._answer_at = None

    def from_robot(self, spot):
        """Returns the distance [m] and bearing [rad] of the spot from the robot."""
        x, y, yaw = self.robot
        return math.dist(spot, (x, y)), geometry.wrap_angle(math.atan2(spot[1] - y, spot[0] - x) - yaw)

    def robot_sees(self, spot):
        distance, bearing = self.from_robot(spot)
        return 0.45 < distance < 3.0 and abs(bearing) < math.radians(29.0)

    def run(self, limit, dt=DT):
        while self.perception.now < 100.0 + limit:
            action = self.script.step(Perception(**vars(self.perception)))
            self.actions.append(action)
            self.robots.append(self.robot)
            if action.outcome:
                return action.outcome
            self.perception.now += dt
            self._see(action)
            self._command(action)
            self._drive(action, dt)
        return "time is up"

    def _see(self, action):
        state = self.perception.state
        if action.laser is None or state == "default":
            return
        by_robot = self.robot_sees(action.laser)
        covered = self.covered(np.array(action.laser))
        if covered and not self.follows and self._arrives is None:
            self._arrives = self.perception.now + self.dispatch_after
        if by_robot:
            self.perception.last_seen_by_robot = self.perception.now
        if covered or by_robot:
            self.perception.last_seen = self.perception.now
            if state == "border":
                self.border.append(action.laser)
            if state == "seed":
                self.seed.append(action.laser)
                self.perception.has_seed = len(self.seed) >= 10

    def _command(self, action):
        if action.command:
            self.commands.append(action.command)
            self.sources.add(action.source)
            self._answer_at = (self.perception.now + 0.1, action)
        if self._answer_at and self.perception.now >= self._answer_at[0]:
            action = self._answer_at[1]
            self._answer_at = None
            answer = CommandReply(True, "ok", "")
            if action.command == "save":
                code = self.refusals.pop(0) if self.refusals else ""
                answer = CommandReply(not code, code or "ok", code)
                if not code:
                    self.perception.state = "default"
            elif action.command == "cancel":
                self.perception.state = "default"
                self.border, self.seed, self.perception.has_seed = [], [], False
            else:
                self.perception.state = COMMANDS[action.command]
            self.perception.answer, self.perception.answered = answer, action.number

    def _drive(self, action, dt):
        if self._arrives is not None and self.perception.now >= self._arrives and action.laser is not None:
            # placed where it sees the spot, in place of driving there
            spot = np.array(action.laser)
            if not self.robot_sees(spot):
                self.robot = (spot[0], spot[1] - 1.0, math.pi / 2)
                self._arrives = self.perception.now + self.dispatch_after
        elif self.follows and action.laser is not None and self.robot_sees(action.laser):
            distance, bearing = self.from_robot(action.laser)
            wanted_distance = 1.0 if distance > 0.8 else 0.8
            speed = float(np.clip(0.8 * (distance - wanted_distance), -0.1, 0.2))
            speed *= max(0.0, 1.0 - abs(bearing) / 0.44)
            self.robot = advance(self.robot, speed * dt, float(np.clip(1.8 * bearing, -0.8, 0.8)) * dt)
        self.perception.robot = self.robot
