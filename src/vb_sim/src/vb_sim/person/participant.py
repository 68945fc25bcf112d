"""The simulated person: what they perceive and do, and the skills that both methods share.

A person's behaviour is a script (a generator) that is resumed once per step. It knows only what a person in the room
could know: where they and the robot are, the feedback that the spot is being seen, the answers to the commands, and
what the display shows.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from typing import Generator, Optional, Tuple

import numpy as np

from vb_core import geometry
from vb_core.grid_map import FREE, UNKNOWN, GridMap, sample
from vb_sim.room.floor_plan import physical_map
from vb_sim.person.hand import Stroke, Tremor, load_styles
from vb_sim.person.walking import Walker
from vb_sim.models import ParticipantModel
from vb_sim.room.world import Scenario, World

Step = Generator[None, None, None]
FEEDBACK_GAP = 0.3  # [s] since the last sound of "I see it" after which the spot counts as unseen
OWN_SPOT = 0.5  # [m] a dot on the display farther from the person's spot than this is not taken for it

DEFAULT = "default"
# codes of a notice on the display, and of an answer to a command
HOLD_STILL = "spot_not_seen_robot_looks"
CONFIRM_SAVE = "confirm_save"
COMMANDS = ("define_border", "define_seed", "guide_robot", "save", "cancel")


@dataclass(frozen=True)
class CommandReply:
    """The system's answer to a command."""

    success: bool
    code: str
    message: str


@dataclass
class Perception:
    """What the person perceives now; times in seconds.

    Attributes:
        robot: true pose (x, y, yaw) [m, m, rad] of the robot, which the person sees; None until it is known.
        last_seen: when a camera last reported the spot.
        last_seen_by_robot: when a robot's camera last did.
        has_seed: whether the display shows a seed point.
        state: name of the state that the display shows.
        hold_requested: when the display last said to hold still because a robot is coming.
        answer: to the command with the number `answered`.
    """

    now: float = 0.0
    robot: Optional[Tuple[float, float, float]] = None
    last_seen: float = -math.inf
    last_seen_by_robot: float = -math.inf
    has_seed: bool = False
    state: str = DEFAULT
    hold_requested: float = -math.inf
    answer: CommandReply = CommandReply(True, "ok", "")
    answered: int = 0

    def record_spot(
        self, spot: Optional[Tuple[float, float]], stamp: float, seen: Tuple[float, float], mobile: bool
    ) -> None:
        """Records that a camera saw a spot, if it is the person's own.

        Args:
            spot: (x, y) [m] where the person's own spot is now; None while the laser is off.
            stamp: [s] of the camera's image.
            seen: (x, y) [m] where the camera saw a spot.
            mobile: whether it is a robot's camera.
        """
        # a spot seen seconds ago is not feedback, nor is one from the future
        if spot is None or not -0.2 < self.now - stamp < 1.0 or math.dist(seen, spot) > OWN_SPOT:
            return
        # people hear the sound when it comes, however old the image is
        self.last_seen = self.now
        if mobile:
            self.last_seen_by_robot = self.now


@dataclass(frozen=True)
class Action:
    """What the person does now.

    Attributes:
        laser: (x, y) [m] where the spot is; None while the laser is off.
        pose: (x, y, yaw) [m, m, rad].
        command: to send now, with its number; empty otherwise.
        outcome: "saved" or "gave_up" once everything is over; empty before.
    """

    laser: Optional[Tuple[float, float]]
    pose: Tuple[float, float, float]
    doing: str
    command: str = ""
    number: int = 0
    source: str = "participant"
    outcome: str = ""


class ParticipantGaveUp(Exception):
    """The person gave up; the message says why."""


class DrawingSlip(Exception):
    """The drawing went wrong, and the person has noticed."""


class Person:
    """A person's body, hand and speech, controlled by a `ParticipantScript`.

    Args:
        scenario: what is to be drawn.
        random_seed: of everything that differs between people.
        start_near: (2,) [m] the person comes from somewhere near this point.
        method: with which the person draws. A person's style is drawn once; how a run goes (aim, tremor, mistakes) is
            drawn again for each scenario and method, as nobody repeats a movement or a mistake.
    """

    def __init__(
        self,
        world: World,
        scenario: Scenario,
        model: ParticipantModel,
        random_seed: int,
        start_near: np.ndarray,
        method: str = "nrs",
    ) -> None:
        self._run = [random_seed, zlib.crc32(f"{scenario.key} {method}".encode())]
        self.rng = np.random.default_rng(self._run)
        self.model = model
        self.scenario = scenario
        self.grid: GridMap = physical_map(world)
        self.walker = Walker(self.grid, model, start_near)
        self.walker.here = self.walker.find_place_near(np.asarray(start_near, dtype=float), 1.2, 2.0, self.rng)
        self.drawing_speed = float(self.rng.uniform(model.drawing_speed[0], max(model.drawing_speed)))
        self._tremor = Tremor(model.tremor, (model.tremor_band[0], model.tremor_band[1]), self.rng)
        self.percept = Perception()
        self.spot: Optional[np.ndarray] = None  # where the laser is meant to point
        # whose movement it is: the same real person in all scenarios, with all methods
        chosen = np.random.default_rng([random_seed, 2]).integers(len(load_styles()))
        self.style = load_styles()[int(chosen)]
        self.doing = "comes in"
        self.dt = 0.0
        self.tries = 0
        self.last_answer = self.percept.answer
        self._command, self._number, self._source = "", 0, "participant"
        self._draw_mistakes()

    def _draw_mistakes(self) -> None:
        """Decides this person's mistakes, with separate generators, so that all else is the same without mistakes."""
        self._slips_of_the_tongue = np.random.default_rng([*self._run, 3])
        rng = np.random.default_rng([*self._run, 1])
        slips, wrong_side = rng.random(2) < (self.model.slip, self.model.wrong_side)
        # where along the border the hand slips [share], and to which side
        self._slip: Optional[Tuple[float, float]] = (rng.uniform(0.2, 0.9), rng.choice([-1.0, 1.0])) if slips else None
        self.seed = self._mirrored_seed() if wrong_side else self.scenario.seed.copy()

    def _mirrored_seed(self) -> np.ndarray:
        """Mirrors the seed across the border: to the nearest point (2,) [m] that is on free floor, or not at all."""
        chain = geometry.resample_chain(self.scenario.border, 0.05, self.scenario.closed)
        across = chain - self.scenario.seed
        for index in np.argsort(np.linalg.norm(across, axis=1), kind="stable"):
            place = self.scenario.seed + 2.0 * across[index]
            around = place + 0.15 * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
            if self.is_floor(around).all() and np.linalg.norm(chain - place, axis=1).min() > 0.25:
                return place
        return self.scenario.seed.copy()

    # ------------------------------------------------------------ the world's side
    def step(self, percept: Perception, script: Step) -> None:
        """Takes in a percept, resumes the script, and walks on for the time since the last percept."""
        self.dt = min(max(percept.now - self.percept.now, 0.0), 0.1) if self.percept.now else 0.0
        self.percept = percept
        self.walker.robot = None if percept.robot is None else np.array(percept.robot[:2])
        self._command = ""
        next(script)
        self.walker.step(self.dt, self.spot)

    def action(self, outcome: str) -> Action:
        """Returns what can be seen of the person now."""
        pose, beam = (*map(float, self.walker.here), self.walker.yaw), None
        if self.spot is not None:
            trembling = self.spot + self._tremor.at(self.percept.now)
            # at the foot of a wall, people keep the spot on the floor
            x, y = trembling if self.is_floor(trembling)[0] else self.spot
            beam = float(x), float(y)
        return Action(beam, pose, self.doing, self._command, self._number, self._source, outcome)

    def is_floor(self, points: np.ndarray) -> np.ndarray:
        """Returns (N,) bool: which points (N, 2) [m] are on the floor, where a spot can be seen."""
        return sample(self.grid, self.grid.data, points, UNKNOWN) == FREE

    # ------------------------------------------------------------ perception
    def unseen_for(self, by_robot: bool = False) -> float:
        """Returns the time [s] since any camera, or `by_robot` a robot's, last reported the spot."""
        return self.percept.now - (self.percept.last_seen_by_robot if by_robot else self.percept.last_seen)

    # ------------------------------------------------------------ skills
    def wait(self, seconds: float) -> Step:
        """Waits for `seconds`."""
        until = self.percept.now + seconds
        while self.percept.now < until:
            yield

    def react(self) -> Step:
        """Waits for a reaction time, which varies."""
        yield from self.wait(self.model.reaction_time * float(self.rng.uniform(0.7, 1.6)))

    def arrive(self) -> Step:
        """Waits until the person has walked to the goal."""
        while self.walker.walking:
            yield

    def walk_within_reach(self, spot: np.ndarray, line: np.ndarray) -> None:
        """Starts walking to where the spot is within reach, unless it already is."""
        if not self.walker.walking and np.linalg.norm(self.walker.here - spot) > self.model.reach:
            self.walker.go_to_point_at(spot, line)

    def step_aside(self, spot: np.ndarray, line: np.ndarray) -> None:
        """Starts walking to another side of the spot, in case the person's body is in the way."""
        self.walker.go_to_point_at(spot, line, self.walker.here)

    def give_command(self, command: str, source: str = "participant") -> Step:
        """Sends a command and waits for the answer, which is left in `last_answer`."""
        before, self.doing = self.doing, f"says {command.replace('_', ' ')}"
        yield from self.wait(self.model.speaking_time)
        self._number += 1
        self._command, self._source = command, source
        asked = self.percept.now
        yield
        while self.percept.answered != self._number and self.percept.now - asked <= 20.0:
            yield
        self.last_answer = CommandReply(False, "no_response", "nobody answered")
        if self.percept.answered == self._number:
            self.last_answer = self.percept.answer
        self.doing = before

    def repeat_command(self, command: str, source: str = "participant") -> Step:
        """Gives a command up to six times, until it succeeds.

        Raises:
            ParticipantGaveUp: if it never succeeds.
            DrawingSlip: if a wrong command was given first and changed the state.
        """
        yield from self._maybe_give_wrong_command(command, source)
        for _ in range(6):
            yield from self.give_command(command, source)
            if self.last_answer.success:
                return
            yield from self.wait(1.0)
        raise ParticipantGaveUp(f"{command} was not taken: {self.last_answer.message} [{self.last_answer.code}]")

    def _maybe_give_wrong_command(self, command: str, source: str) -> Step:
        """Sometimes gives another command, as if misspoken or misheard; the display shows the person its effect.

        Raises:
            DrawingSlip: if the state has changed, so that the person starts over.
        """
        others = [word for word in COMMANDS if word != command]
        wrong = self._slips_of_the_tongue.random() < self.model.wrong_word
        other = others[self._slips_of_the_tongue.integers(len(others))]
        if not wrong or command == "cancel":
            return
        before = self.percept.state
        yield from self.give_command(other, source)
        yield from self.look()
        yield from self.react()
        if self.percept.state != before:
            raise DrawingSlip()

    def look(self) -> Step:
        """Looks at the display before going on."""
        yield from self.wait(self.model.look_time * float(self.rng.uniform(0.5, 1.5)))

    def move_spot(self, target: np.ndarray, speed: float) -> Step:
        """Moves the spot straight to a target (2,) [m] at a speed [m/s]."""
        target = np.asarray(target, dtype=float)
        if self.spot is None:
            self.spot = target.copy()
        while np.linalg.norm(target - self.spot) > 1e-6:
            self.bring_spot(target, speed * self.dt)
            yield

    def bring_spot(self, target: np.ndarray, stride: float) -> None:
        """Moves the spot towards a target (2,) [m], by at most a stride [m]."""
        way = target - self.spot
        distance = float(np.linalg.norm(way))
        self.spot = self.spot + way / distance * min(stride, distance)

    def new_stroke(self, border: Optional[np.ndarray] = None) -> Stroke:
        """Makes this attempt's stroke of the border, or of `border`, its points (N, 2) [m] in another order."""
        border = self.scenario.border if border is None else border
        return Stroke(border, self.scenario.closed, self.model, self.rng, self.is_floor, self.style)

    def maybe_make_slip(self, stroke: Stroke, arc: float, speed: float) -> Step:
        """Makes the hand slip, at most once per run, at some point of the stroke.

        Raises:
            DrawingSlip: when the person has noticed the slip.
        """
        if self._slip is None or arc < self._slip[0] * stroke.length:
            return
        side, self._slip = self._slip[1], None
        along = stroke.at(min(arc + 0.05, stroke.length)) - stroke.at(max(arc - 0.05, 0.0))
        across = np.array([-along[1], along[0]]) / max(float(np.linalg.norm(along)), 1e-9)
        aside = stroke.at(arc) + self.model.slip_size * side * across
        yield from self.move_spot(aside if self.is_floor(aside)[0] else stroke.at(arc), speed)
        yield from self.react()
        self.spot = None
        raise DrawingSlip()

    def hold_until_seen(self, seconds: float, patience: float, by_robot: bool = False) -> Step:
        """Holds the spot until it has been seen for `seconds` in total, or patience runs out."""
        seen, began = 0.0, self.percept.now
        while seen < seconds and self.percept.now - began < patience + seconds:
            if self.unseen_for(by_robot) < FEEDBACK_GAP:
                seen += self.dt
            yield

    def wait_for_seed(self, seconds: float) -> Step:
        """Waits until the display shows the seed, a moment after a camera has seen it, or `seconds` are over."""
        began = self.percept.now
        while not self.percept.has_seed and self.percept.now - began < seconds:
            yield


class ParticipantScript:
    """The course of a run, from entering to walking away; subclasses add how to prepare, draw and show the seed."""

    source = "participant"

    def __init__(self, person: Person) -> None:
        self.person = person
        self.outcome = self.reason = ""
        self._script = self._run()

    def step(self, percept: Perception) -> Action:
        """Makes the person perceive and act once."""
        self.person.step(percept, self._script)
        return self.person.action(self.outcome)

    # ------------------------------------------------------------ for subclasses
    def prepare(self) -> Step:
        """Prepares to draw: walks to the border, or guides the robot there."""
        raise NotImplementedError

    def draw(self) -> Step:
        """Draws the border; the state is Border."""
        raise NotImplementedError

    def show_seed(self) -> Step:
        """Asks to define the seed, and points at it."""
        raise NotImplementedError

    # ------------------------------------------------------------ the common course
    def _run(self) -> Step:
        person = self.person
        while not person.percept.now:
            yield
        began, course = person.percept.now, self._course()
        try:
            for _ in course:
                if person.percept.now - began > person.model.time_limit:
                    raise ParticipantGaveUp(f"it took longer than {person.model.time_limit:g} s")
                yield
            outcome = "saved"
        except ParticipantGaveUp as reason:
            course.close()
            outcome, self.reason = "gave_up", str(reason)
            person.spot = None
            yield from person.give_command("cancel", self.source)
        person.spot = None
        person.doing = "walks away"
        away = person.walker.find_place_near(person.walker.here, 0.8, 1.5, person.rng)
        person.walker.go(away)
        for _ in range(500):
            if person.walker.walking:
                yield
        person.walker.stop()
        person.doing = "is done"
        self.outcome = outcome
        while True:
            yield

    def _course(self) -> Step:
        person = self.person
        if person.percept.state != DEFAULT:
            # another person, or an earlier process of this one, left an interaction unfinished
            person.doing = "starts over"
            yield from person.repeat_command("cancel", self.source)
        refusal = person.last_answer
        for tries in range(1, person.model.tries + 1):
            person.tries = tries
            try:
                if (yield from self._attempt()):
                    return
                refusal = person.last_answer
            except DrawingSlip:
                refusal = CommandReply(False, "slipped", "it went wrong")
            if person.percept.state != DEFAULT:
                person.doing, person.spot = "starts over", None
                yield from person.repeat_command("cancel", self.source)
        raise ParticipantGaveUp(f"not saved: {refusal.message} [{refusal.code}]")

    def _attempt(self) -> Generator[None, None, bool]:
        """Makes one attempt to draw, show the seed and save; returns whether a border was saved.

        Raises:
            DrawingSlip: the person has noticed that something went wrong.
        """
        person = self.person
        yield from self.prepare()
        yield from self.draw()
        yield from person.look()
        for _ in range(person.model.tries):
            yield from self.show_seed()
            person.spot = None
            yield from person.look()
            yield from person.react()
            yield from self._save()
            if person.last_answer.success or "seed" not in person.last_answer.code:
                break
        return person.last_answer.success

    def _save(self) -> Step:
        for _ in range(4):
            yield from self.person.give_command("save", self.source)
            if self.person.last_answer.code == CONFIRM_SAVE:
                # the display shows what would be restricted: the person looks at it, and confirms
                yield from self.person.react()
            elif self.person.last_answer.code == "busy":
                yield from self.person.wait(1.5)
            else:
                return
