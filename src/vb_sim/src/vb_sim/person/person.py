"""The simulated person: perception, actions, and the skills that all methods share.

A skill is a generator that is resumed once per step and ends when the person is done. It uses only what a person in the
room could perceive: their own and the robot's position, the feedback that a camera sees the spot, the answers to
commands, and the display.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from typing import Callable, Generator, Optional, Tuple

import numpy as np

from vb_core import geometry
from vb_core.geometry import Pose
from vb_core.grid_map import FREE, UNKNOWN, GridMap, sample
from vb_sim.model_params import ParticipantModel
from vb_sim.person.hand import Stroke, Tremor, load_styles
from vb_sim.person.walking import Walker
from vb_sim.floor_plan import physical_map
from vb_sim.world import Point2, Scenario, World

Step = Generator[None, None, None]
FEEDBACK_GAP = 0.3  # [s] since the last feedback after which the spot counts as unseen
OWN_SPOT = 0.5  # [m] from the person's spot, within which a dot on the display counts as this spot

DEFAULT = "default"  # the interaction's state in which nobody draws
HOLD_STILL = "spot_not_seen_robot_looks"  # code of a notice on the display
COMMANDS = ("define_border", "define_seed", "guide_robot", "save", "cancel")


@dataclass(frozen=True)
class CommandReply:
    """The system's answer to a command."""

    success: bool
    code: str
    message: str


@dataclass
class Perception:
    """What the person perceives at one time."""

    now: float = 0.0  # [s]
    robot: Optional[Pose] = None  # true pose (x, y, yaw) [m, m, rad] of the robot that the person sees; None before
    last_seen: float = -math.inf  # [s] time of the last feedback that a camera sees the spot
    last_seen_by_robot: float = -math.inf  # [s] the same for a robot's camera
    has_seed: bool = False  # whether the display shows a seed point
    state: str = DEFAULT  # name of the state that the display shows
    hold_requested_at: float = -math.inf  # [s] when the display last asked the person to hold still for a coming robot
    answer: CommandReply = CommandReply(True, "ok", "")  # the answer to the newest answered command
    answered: int = 0  # the number of that command

    def record_spot(self, spot: Optional[Point2], stamp: float, sighting: Point2, mobile: bool) -> None:
        """Records that a camera saw a spot, if it is the person's.

        Args:
            spot: (x, y) [m] of the person's spot now; None while the laser is off.
            stamp: [s] of the camera's image.
            sighting: (x, y) [m] of the spot that the camera saw.
            mobile: whether it is a robot's camera.
        """
        # a spot from seconds ago, or from the future, is not feedback
        is_recent = -0.2 < self.now - stamp < 1.0
        if spot is None or not is_recent or math.dist(sighting, spot) > OWN_SPOT:
            return
        # the feedback's time is now, when the person hears the sound, and not the time of the image
        self.last_seen = self.now
        if mobile:
            self.last_seen_by_robot = self.now


@dataclass(frozen=True)
class Action:
    """What the person does at one time."""

    laser: Optional[Point2]  # (x, y) [m] of the spot; None while the laser is off
    pose: Pose  # (x, y, yaw) [m, m, rad]
    doing: str  # what the person does, in words
    command: str = ""  # the command to give now; empty if there is none
    number: int = 0  # the command's number
    source: str = "participant"  # how the command is given: "participant" by voice, or "buttons"
    outcome: str = ""  # "saved" or "gave_up" at the end of the run; empty before


class ParticipantGaveUp(Exception):
    """The person gave up. The message says why."""


class DrawingSlip(Exception):
    """The person noticed a mistake in the drawing."""


class Person:
    """A person's body, hand and speech, controlled by a `ParticipantScript`.

    Args:
        scenario: the task.
        method: "nrs" or "robot_only". A person keeps one style, but aim, tremor and mistakes differ between scenarios
            and methods, because nobody repeats a movement or a mistake.
        random_seed: seed of everything that differs between people.

    Attributes:
        perception: what the person perceives now.
        spot: (2,) [m] where the person means to point; None while the laser is off.
        seed: (2,) [m] the seed that the person means to show, which may be on the wrong side of the border.
        doing: what the person does, in words.
        dt: [s] since the last step.
        last_answer: the answer to the last command.
    """

    def __init__(
        self, world: World, scenario: Scenario, model: ParticipantModel, method: str, random_seed: int
    ) -> None:
        self._run_seeds = [random_seed, zlib.crc32(f"{scenario.key} {method}".encode())]
        self.rng = np.random.default_rng(self._run_seeds)
        self.model = model
        self.scenario = scenario
        self.grid: GridMap = physical_map(world)
        # without ceiling cameras, a person begins by leading the robot
        start = scenario.stand if method == "nrs" else world.robots[0].start[:2]
        start_near = np.array(start, dtype=float)
        self.walker = Walker(self.grid, model, start_near)
        self.walker.position = self.walker.find_position_near(start_near, 1.2, 2.0, self.rng)
        self.drawing_speed = float(self.rng.uniform(model.drawing_speed[0], max(model.drawing_speed)))
        self._tremor = Tremor(model.tremor, model.tremor_band, self.rng)
        self.perception = Perception()
        self.spot: Optional[np.ndarray] = None
        # a person draws in the style of the same real person in all scenarios and with all methods
        style_index = np.random.default_rng([random_seed, 2]).integers(len(load_styles()))
        self.style = load_styles()[int(style_index)]
        self.doing = "comes in"
        self.dt = 0.0
        self.last_answer = self.perception.answer
        self._command = ""
        self._number = 0
        self._source = "participant"
        self._draw_mistakes()

    def _draw_mistakes(self) -> None:
        """Chooses this person's mistakes. Generators of their own leave all else as it would be without mistakes."""
        self._wrong_word_rng = np.random.default_rng([*self._run_seeds, 3])
        rng = np.random.default_rng([*self._run_seeds, 1])
        slips, is_wrong_side = rng.random(2) < (self.model.slip, self.model.wrong_side)
        # [share of the border] at which the hand slips, and to which side
        self._slip: Optional[Tuple[float, float]] = None
        if slips:
            self._slip = (rng.uniform(0.2, 0.9), rng.choice([-1.0, 1.0]))
        self.seed = self._mirrored_seed() if is_wrong_side else self.scenario.seed.copy()

    def _mirrored_seed(self) -> np.ndarray:
        """Returns the seed mirrored at the nearest suitable point of the border, or the seed itself if none suits."""
        seed = self.scenario.seed
        chain = geometry.resample_chain(self.scenario.border, 0.05, self.scenario.closed)
        for point in sorted(chain, key=lambda point: math.dist(point, seed)):
            mirrored = seed + 2.0 * (point - seed)
            neighborhood = mirrored + 0.15 * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
            distances = np.linalg.norm(chain - mirrored, axis=1)
            if self.is_floor(neighborhood).all() and distances.min() > 0.25:
                return mirrored
        return seed.copy()

    # ------------------------------------------------------------ steps
    def step(self, perception: Perception, script: Step) -> None:
        """Sets the perception, resumes the script, and walks for the time since the last perception."""
        is_first = self.perception.now == 0.0
        self.dt = 0.0 if is_first else min(max(perception.now - self.perception.now, 0.0), 0.1)
        self.perception = perception
        self.walker.robot = None if perception.robot is None else np.array(perception.robot[:2])
        self._command = ""
        next(script)
        self.walker.step(self.dt, self.spot)

    def action(self, outcome: str) -> Action:
        """Returns the person's current action."""
        pose = (*map(float, self.walker.position), self.walker.yaw)
        beam = None
        if self.spot is not None:
            trembling = self.spot + self._tremor.at(self.perception.now)
            # near a wall, people keep the spot on the floor
            x, y = trembling if self.is_floor(trembling)[0] else self.spot
            beam = float(x), float(y)
        return Action(beam, pose, self.doing, self._command, self._number, self._source, outcome)

    def is_floor(self, points: np.ndarray) -> np.ndarray:
        """Returns (N,) bool: whether points (N, 2) [m] are on the floor, where cameras can see a spot."""
        return sample(self.grid, self.grid.data, points, UNKNOWN) == FREE

    def spot_lost_time(self, by_robot: bool = False) -> float:
        """Returns the time [s] since the last feedback that a camera sees the spot: any camera, or only a robot's."""
        last_seen = self.perception.last_seen_by_robot if by_robot else self.perception.last_seen
        return self.perception.now - last_seen

    # ------------------------------------------------------------ skills
    def wait(self, seconds: float, is_over: Callable[[], bool] = lambda: False) -> Step:
        """Waits for `seconds` [s], or until `is_over` returns true."""
        end = self.perception.now + seconds
        while self.perception.now < end and not is_over():
            yield

    def react(self) -> Step:
        """Waits for a random reaction time."""
        yield from self.wait(self.model.reaction_time * float(self.rng.uniform(0.7, 1.6)))

    def arrive(self, seconds: float = math.inf) -> Step:
        """Waits until the person has arrived at the goal, or `seconds` [s] have passed."""
        yield from self.wait(seconds, lambda: not self.walker.walking)

    def walk_within_reach(self, spot: np.ndarray, line: np.ndarray) -> None:
        """Starts walking to within reach of the spot, unless it is already in reach."""
        distance = np.linalg.norm(self.walker.position - spot)
        if not self.walker.walking and distance > self.model.reach:
            self.walker.go_to_point_at(spot, line)

    def step_aside(self, spot: np.ndarray, line: np.ndarray) -> None:
        """Starts walking to another side of the spot, in case the person's body hides it."""
        self.walker.go_to_point_at(spot, line, self.walker.position)

    def give_command(self, command: str, source: str = "participant") -> Step:
        """Gives a command and waits for the answer, which is stored in `last_answer`."""
        activity = self.doing
        self.doing = f"says {command.replace('_', ' ')}"
        yield from self.wait(self.model.speaking_time)
        self._number += 1
        self._command, self._source = command, source
        yield
        yield from self.wait(20.0, lambda: self.perception.answered == self._number)
        self.last_answer = CommandReply(False, "no_response", "nobody answered")
        if self.perception.answered == self._number:
            self.last_answer = self.perception.answer
        self.doing = activity

    def repeat_command(self, command: str, source: str = "participant") -> Step:
        """Gives a command up to six times, until it succeeds.

        Raises:
            ParticipantGaveUp: if it never succeeds.
            DrawingSlip: if the person first gave a wrong command, which changed the state.
        """
        yield from self._maybe_give_wrong_command(command, source)
        for _ in range(6):
            yield from self.give_command(command, source)
            if self.last_answer.success:
                return
            yield from self.wait(1.0)
        raise ParticipantGaveUp(f"{command} was not accepted: {self.last_answer.message} [{self.last_answer.code}]")

    def _maybe_give_wrong_command(self, command: str, source: str) -> Step:
        """Sometimes gives another command first: the person misspoke, or was misheard. The display shows its effect.

        Raises:
            DrawingSlip: if the state changed, so that the person must start over.
        """
        others = [candidate for candidate in COMMANDS if candidate != command]
        misspeaks = self._wrong_word_rng.random() < self.model.wrong_word
        other = others[self._wrong_word_rng.integers(len(others))]
        if not misspeaks or command == "cancel":
            return
        state_before = self.perception.state
        yield from self.give_command(other, source)
        yield from self.look()
        yield from self.react()
        if self.perception.state != state_before:
            raise DrawingSlip()

    def look(self) -> Step:
        """Looks at the display for a random time."""
        yield from self.wait(self.model.look_time * float(self.rng.uniform(0.5, 1.5)))

    def move_spot(self, target: np.ndarray, speed: float) -> Step:
        """Moves the spot straight to a target (2,) [m] at a speed [m/s]."""
        target = np.asarray(target, dtype=float)
        if self.spot is None:
            self.spot = target.copy()
        while np.linalg.norm(target - self.spot) > 1e-6:
            self.step_spot(target, speed * self.dt)
            yield

    def step_spot(self, target: np.ndarray, stride: float) -> None:
        """Moves the spot towards a target (2,) [m], by at most `stride` [m]."""
        offset = target - self.spot
        distance = float(np.linalg.norm(offset))
        self.spot = self.spot + offset / distance * min(stride, distance)

    def new_stroke(self, border: np.ndarray) -> Stroke:
        """Returns a new stroke along `border` (N, 2) [m], which is the scenario's, perhaps in another order."""
        return Stroke(border, self.scenario.closed, self.model, self.rng, self.is_floor, self.style)

    def slip_at_random(self, stroke: Stroke, arc: float, speed: float) -> Step:
        """Lets the hand slip at one point of the stroke, at most once per run.

        Raises:
            DrawingSlip: once the person has noticed the slip.
        """
        if self._slip is None or arc < self._slip[0] * stroke.length:
            return
        side = self._slip[1]
        self._slip = None
        along = stroke.at(min(arc + 0.05, stroke.length)) - stroke.at(max(arc - 0.05, 0.0))
        across = np.array([-along[1], along[0]]) / max(float(np.linalg.norm(along)), 1e-9)
        aside = stroke.at(arc) + self.model.slip_size * side * across
        yield from self.move_spot(aside if self.is_floor(aside)[0] else stroke.at(arc), speed)
        yield from self.react()
        self.spot = None
        raise DrawingSlip()

    def hold_until_seen(self, seconds: float, patience: float, by_robot: bool = False) -> Step:
        """Holds the spot until it was seen for `seconds` [s] in total, or `patience` [s] more have passed."""
        seen_time = 0.0
        start = self.perception.now
        while seen_time < seconds and self.perception.now - start < patience + seconds:
            if self.spot_lost_time(by_robot) < FEEDBACK_GAP:
                seen_time += self.dt
            yield

    def wait_for_seed(self, seconds: float) -> Step:
        """Waits until the display shows the seed, which takes a moment, or `seconds` [s] have passed."""
        yield from self.wait(seconds, lambda: self.perception.has_seed)
