"""One run: one participant, one scenario, one method, in simulated time as fast as the processor goes."""
from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import Deque, Dict, List, Optional, Tuple

import numpy as np
from shapely.geometry import Point, Polygon

from vb_core.grid_map import GridMap
from vb_evaluation.study.cameras import RobotCamera, Room, Seen, StationaryCamera
from vb_evaluation.study.config import Study
from vb_evaluation.study.driving import PoseHistory
from vb_evaluation.study.methods import METHODS, Method
from vb_evaluation.study.people import Traits
from vb_evaluation.study.system import System
from vb_map_integration.border import VirtualBorder
from vb_sim import floor_plan
from vb_sim.costmap import Costmap, CostmapParams
from vb_sim.hand import meant_border
from vb_sim.frame_clock import FrameSchedule
from vb_sim.lab import Lab, Participant
from vb_sim.lab_history import History, Snapshot
from vb_sim.legs import distance_to_chain
from vb_sim.models_cameras import CameraModels
from vb_sim.participant import Action, ParticipantScript, Percept, Person
from vb_sim.planner import Planner
from vb_sim.world import Scenario, World
from vb_voice_wizard.interaction import Record

OFF_THE_LINE = 0.4  # [m] nobody stands on what he is to draw
FALSE_M = 0.3  # [m] from the true spot beyond which a reported one is something else
START = 100.0  # [s] no stamp is near zero, which would mean that there is none


@dataclass(frozen=True)
class Task:
    """Which run it is; with the study it is all that a run depends on."""

    participant: int
    scenario: str
    method: str


@dataclass(frozen=True)
class Result:
    """What a run left behind.

    Attributes:
        task, traits: what was run, and who it was.
        world, scenario: as they were, with this person's place to stand.
        prior, posterior: maps as the recorder stores them.
        truth: (H, W) bool, the cells to be restricted.
        records: of all interactions of the run, those that were cancelled too.
        border: what was saved; None if nothing was.
        script: the person, with what happened to him.
        spots: every spot that a camera reported; false_spots: how many of them were farther than FALSE_M from the true one.
        cameras: (rendered, skipped) frames by camera.
        way: (N, 2) [m] where the robot was.
        collisions, goals: of the robot.
        began, ended: [s] of the run.
    """

    task: Task
    traits: Traits
    world: World
    scenario: Scenario
    prior: GridMap
    posterior: GridMap
    truth: np.ndarray
    records: Tuple[Record, ...]
    border: Optional[VirtualBorder]
    script: ParticipantScript
    spots: Tuple[Seen, ...]
    false_spots: int
    cameras: Dict[str, Tuple[int, int]]
    way: np.ndarray
    collisions: int
    goals: int
    began: float
    ended: float

    @property
    def saved(self) -> bool:
        """Whether a border came out."""
        return self.border is not None

    @property
    def seed_is_right(self) -> bool:
        """Whether the saved seed point lies in what was to be restricted."""
        return self.border is not None and bool(Polygon(self.scenario.region).contains(Point(self.border.seed)))


class Simulation:
    """A lab with one participant, and the system in it.

    Args:
        room: keeps what is expensive to make from one run to the next.
        thorough: every camera renders and searches every whole picture; for the proof that this changes nothing.
    """

    def __init__(self, study: Study, task: Task, room: Optional[Room] = None, thorough: bool = False) -> None:
        self.study, self.task = study, task
        self.traits = study.traits(task.participant)
        self.method: Method = METHODS[task.method]()
        self.world = study.world
        seed = study.run_seed(task.participant)
        self.prior = floor_plan.physical_map(self.world)
        self.scenario = personal_scenario(self.world, self.world.scenario(task.scenario), self.traits, self.prior,
                                          study.marks(task.scenario))
        models: CameraModels = replace(study.models.cameras, body=self.traits.body)
        room = room or Room()
        room.enter(self.world, models)
        self.lab = Lab(self.world, study.models.robot, study.models.localisation, study.models.scan, seed)
        self.poses = [PoseHistory() for _ in self.world.robots]
        idle_every = 1 if thorough else study.timing.idle_every
        ceiling = [
            StationaryCamera(camera, room.ceiling_view(camera), models, self.prior, seed, idle_every)
            for camera in map(self.world.camera, self.method.cameras(self.world))
        ]
        mobile = [
            RobotCamera(robot, room.robot_view(robot), models, self.prior, seed, poses.estimate, thorough)
            for robot, poses in zip(self.world.robots, self.poses)
        ]
        latency = models.optics.latency_ms * 1e-3
        # as in the live system one node spreads the ceiling cameras' frames, and each robot's camera is apart
        rigs = [rig for rig in (ceiling, *([camera] for camera in mobile)) if rig]
        self._rigs = [(FrameSchedule([camera.rate for camera in rig], latency), rig) for rig in rigs]
        self.cameras = [*ceiling, *mobile]
        self.system = System(self.lab, self.method, self.prior, self.poses, study.timing)
        near = self.method.start_near(self.world, self.scenario)
        person = Person(self.world, self.scenario, self.traits.model, seed, near)
        self.script = self.method.script(person)
        self._percept = Percept()
        self._action: Optional[Action] = None
        self._history = History()
        self._arriving: Deque[Tuple[float, Seen]] = deque()
        self._way: List[Tuple[float, float]] = []
        self._false_spots = 0

    def run(self) -> Result:
        """Goes on until the border is saved, the person gives up, or time is up."""
        step = 1.0 / self.study.timing.rate
        limit = int(self.study.timing.time_limit_s / step)
        now = START
        for count in range(limit):
            now = START + count * step
            self._step(now, step if count else 0.0)
            if self.system.border is not None or self.script.outcome:
                break
        self.system.interaction.advance(now)
        return self._result(now)

    def _step(self, now: float, dt: float) -> None:
        self.lab.step(dt, now)
        for robot, poses in zip(self.lab.robots, self.poses):
            poses.add(now, robot.odometry, robot.estimate())
        body = self.lab.robots[0]
        self._live(now, body.pose)
        self._history.add(self._snapshot(now))
        self._look(now)
        while self._arriving and self._arriving[0][0] <= now:
            seen = self._arriving.popleft()[1]
            self.system.see(seen)
            self._percept.hear(self._action.laser if self._action else None, seen.stamp, seen.position, seen.mobile)
        self.system.step(now)
        if len(self._way) == 0 or np.hypot(self._way[-1][0] - body.pose[0], self._way[-1][1] - body.pose[1]) > 0.02:
            self._way.append(body.pose[:2])

    def _live(self, now: float, robot: Tuple[float, float, float]) -> None:
        """One step of the person's life."""
        percept, system = self._percept, self.system
        percept.now, percept.robot = now, robot
        percept.has_seed = system.has_seed
        percept.state = system.interaction.state.name.lower()
        number = self._action.number if self._action else 0
        if number in system.answers:
            percept.answer, percept.answered = system.answers[number], number
        self._action = action = self.script.step(replace(percept))
        if action.command:
            system.command(action.command, action.source, action.number, now)
        self.lab.hear_participant(Participant(
            action.laser is not None, action.laser or (0.0, 0.0), "red", True, action.pose, action.doing, now))

    def _snapshot(self, now: float) -> Snapshot:
        robots = {robot.namespace.strip("/"): body.pose for robot, body in zip(self.world.robots, self.lab.robots)}
        assert self._action is not None
        return Snapshot(now, robots, self._action.laser, "red", (0.0, 0.0), self._action.pose)

    def _look(self, now: float) -> None:
        """Takes and searches the pictures that are delivered now."""
        for schedule, rig in self._rigs:
            for index, stamp in schedule.due(now):
                snapshot = self._history.at(stamp)
                for seen in rig[index].look(stamp, snapshot):
                    away = snapshot.laser is None or np.hypot(*np.subtract(seen.position, snapshot.laser)) > FALSE_M
                    self._false_spots += int(away)
                    self._arriving.append((now + self.study.timing.spot_s, seen))

    def _result(self, now: float) -> Result:
        integrator = self.system.integrator
        return Result(
            self.task, self.traits, self.world, self.scenario, self.prior, integrator.posterior,
            floor_plan.ground_truth(self.world, self.scenario), tuple(self._records(now)), self.system.border,
            self.script, tuple(self.system.spots), self._false_spots,
            {camera.name: (camera.rendered, camera.skipped) for camera in self.cameras},
            np.array(self._way), sum(robot.collisions for robot in self.lab.robots),
            sum(robot.goals for robot in self.system.robots.values()), START, now,
        )

    def _records(self, now: float) -> List[Record]:
        records = list(self.system.records)
        interaction = self.system.interaction
        if interaction.interaction_id:
            # time was up in the middle: what was spent counts all the same
            interaction.command("cancel", "study", now)
            record = interaction.take_record()
            records += [record] if record is not None else []
        return records


def personal_scenario(
    world: World, scenario: Scenario, traits: Traits, grid: GridMap, marks: Tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Scenario:
    """The scenario as this person sees it: the border by the marks on the floor, and where the person stands.

    The place is near the common one, on free floor, off the border. The ground truth stays the map's.

    Args:
        marks: (dx, dy) [m], turn [rad] by which the marks lie beside the map.
    """
    meant = meant_border(scenario.border, scenario.closed, marks[:2], marks[2], traits.margin)
    scenario = replace(scenario, border=meant)
    planner = Planner(Costmap(grid, CostmapParams(robot_radius=traits.model.body_radius)))
    line = np.vstack([scenario.border, scenario.border[:1]]) if scenario.closed else scenario.border
    for share in (1.0, 0.75, 0.5, 0.25):
        place = scenario.stand + share * np.array(traits.stand_offset)
        if planner.is_traversable(place) and distance_to_chain(place, line) >= OFF_THE_LINE:
            return replace(scenario, stand=place)
    return scenario


def run(study: Study, task: Task, room: Optional[Room] = None, thorough: bool = False) -> Result:
    """Carries out one run; the same result for the same arguments, whatever was run before."""
    return Simulation(study, task, room, thorough).run()
