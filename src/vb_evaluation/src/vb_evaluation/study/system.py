"""The system under test in one process: interaction, point set, map, and who drives the robot."""
from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np
import yaml

from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.robot_profile import RobotProfile
from vb_evaluation.study.cameras import Seen
from vb_evaluation.study.config import Timing, top
from vb_evaluation.study.driving import DrivenRobot, PoseHistory
from vb_evaluation.study.methods import Method
from vb_fusion.collector import BORDER, SEED, Collector, Spot
from vb_fusion.extraction import ExtractionParams
from vb_fusion.live import Candidate, LiveCandidate, extract_chain, extract_seed_of
from vb_map_integration.border import VirtualBorder
from vb_map_integration.integrator import IntegratorParams, MapIntegrator
from vb_robot import coverage
from vb_robot.dispatch import Kind
from vb_robot.dispatcher import Dispatcher, Progress, WatchParams
from vb_robot.driver import RATE
from vb_robot.spots import Sighting
from vb_robot.view import FloorView
from vb_sim.costmap import CostmapParams
from vb_sim.follower import FollowerParams
from vb_sim.lab import Lab
from vb_sim.navigator import Navigator, NavigatorParams, for_robot
from vb_sim.participant import Answer
from vb_sim.planner import PlannerParams
from vb_sim.world import World
from vb_voice_wizard.interaction import Answer as SaidAnswer
from vb_voice_wizard.interaction import Interaction, Record, State

FUSION_HZ, DISPATCH_HZ, NAVIGATION_HZ, SCAN_HZ = 8.0, 4.0, 10.0, 10.0


@lru_cache(maxsize=None)
def _config(package: str, name: str) -> Mapping[str, Any]:
    path = top() / "src" / package / "config" / f"{name}.yaml"
    return yaml.safe_load(Path(path).read_text(encoding="utf-8")) or {}


class Every:
    """Says when something that happens at a rate is due."""

    def __init__(self, rate: float) -> None:
        self.period = 1.0 / rate
        self._next: Optional[float] = None

    def due(self, now: float) -> bool:
        if self._next is None:
            self._next = now
        if now < self._next - 1e-9:
            return False
        while self._next <= now + 1e-9:
            self._next += self.period
        return True


@dataclass
class Pending:
    """A command on its way."""

    at: float
    number: int
    command: str
    source: str


class System:
    """Everything between the cameras and the robot's wheels; people talk to it by `command`.

    Attributes:
        answers: answers to commands by their number.
        has_seed: whether the display shows a seed point.
        records: of the interactions that have ended.
        border: what was saved; None before.
    """

    def __init__(self, lab: Lab, method: Method, grid: GridMap, poses: Sequence[PoseHistory], timing: Timing) -> None:
        self._lab, self._timing, self._poses = lab, timing, poses[0]
        self._ids = 0
        self.interaction = Interaction(new_id=self._new_id)
        self._shown: Tuple[State, str] = (State.DEFAULT, "")
        self.answers: Dict[int, Answer] = {}
        self.has_seed = False
        self.records: List[Record] = []
        self.border: Optional[VirtualBorder] = None
        self.spots: List[Seen] = []
        self._pending: List[Pending] = []
        self._saving: Optional[Pending] = None
        fusion = _config("vb_fusion", "border_fusion")
        self._extraction = ExtractionParams.from_mapping(fusion.get("extraction"), "extraction")
        self._collector = Collector()
        self._live = LiveCandidate(self._extraction, float(fusion.get("live_share", 0.12)))
        self.integrator = MapIntegrator(IntegratorParams(), None)
        self.integrator.set_map(grid)
        names = [robot.namespace.strip("/") for robot in lab.world.robots]
        profile = RobotProfile.load(top() / "robots" / "turtlebot2.yaml")
        self.robots = {
            name: DrivenRobot(
                index, lab, history, _navigator(grid, profile), name or "robot", method.follow, grid, profile)
            for index, (name, history) in enumerate(zip(names, poses))
        }
        self._dispatcher = _dispatcher(lab.world, method, grid, names) if method.dispatch else None
        self._fusion_due, self._dispatch_due = Every(FUSION_HZ), Every(DISPATCH_HZ)
        self._drive_due, self._navigation_due, self._scan_due = Every(RATE), Every(NAVIGATION_HZ), Every(SCAN_HZ)

    def _new_id(self) -> str:
        self._ids += 1
        return f"i{self._ids}"

    # ------------------------------------------------------------- what comes in
    def command(self, command: str, source: str, number: int, now: float) -> None:
        """Somebody gives a command; it takes effect a little later."""
        self._pending.append(Pending(now + self._timing.command_s, number, command, source))

    def see(self, seen: Seen) -> None:
        """A camera has reported a spot."""
        self.spots.append(seen)
        self._collector.add(Spot(seen.stamp, *seen.position, seen.camera, seen.confidence, seen.mobile))
        sighting = Sighting(seen.stamp, seen.position, seen.camera, seen.mobile, seen.confidence)
        for robot in self.robots.values():
            robot.add(sighting)
        if self._dispatcher is not None:
            self._dispatcher.add(sighting)

    def step(self, now: float) -> None:
        """Goes on to a time [s]."""
        self._answer(now)
        if self._fusion_due.due(now):
            self._fuse(now, False)
        self._drive(now)

    # ------------------------------------------------------------- interaction
    def _answer(self, now: float) -> None:
        if self._saving is not None and now >= self._saving.at:
            pending, self._saving = self._saving, None
            self._finish(pending, now)
        for pending in [entry for entry in self._pending if now >= entry.at]:
            self._pending.remove(pending)
            answer = self.interaction.command(pending.command, pending.source, now)
            if answer.success and self.interaction.saving and pending.command == "save":
                self._saving = Pending(now + self._timing.save_s, pending.number, pending.command, pending.source)
                continue
            self._tell(pending.number, answer, now)

    def _finish(self, pending: Pending, now: float) -> None:
        try:
            border = self._candidate()
            outcome = self.integrator.add(border, now, {"robot": self._poses.estimate(now)[:2]})
        except CodedError as error:
            answer = self.interaction.refuse(SaidAnswer.refusal(error), now)
        else:
            self.border = border
            for robot in self.robots.values():
                robot.set_map(self.integrator.posterior)
            answer = self.interaction.finish_save(outcome.ids[0], now)
        self._tell(pending.number, answer, now)

    def _candidate(self) -> VirtualBorder:
        collection = self._collector.collection()
        chain = extract_chain(collection, self._extraction)
        seed = extract_seed_of(collection)
        return VirtualBorder(chain.points, seed, 1.0, chain.closed)

    def _tell(self, number: int, answer: Any, now: float) -> None:
        self.answers[number] = Answer(answer.success, answer.code, answer.message)
        record = self.interaction.take_record()
        if record is not None:
            self.records.append(record)
        state, interaction_id = self.interaction.state, self.interaction.interaction_id
        if (state, interaction_id) == self._shown:
            return
        self._shown = (state, interaction_id)
        entered = self.interaction.entered
        if self._collector.set_state(state.name.lower(), interaction_id, entered):
            self._live.reset()
        for robot in self.robots.values():
            robot.set_state(int(state), interaction_id, entered)
        if self._dispatcher is not None:
            self._dispatcher.set_state(int(state), interaction_id, entered)
            if state not in (State.BORDER, State.SEED):
                for robot in self.robots.values():
                    robot.cancel()
        self._fuse(now, True)

    # ------------------------------------------------------------- point set
    def _fuse(self, now: float, force: bool) -> None:
        collecting = self._collector.state in (BORDER, SEED)
        if not collecting:
            if force:
                self.has_seed = False
            return
        if self._collector.state == BORDER and self._dispatcher is None:
            # without a dispatcher only the display shows the chain, and nobody's acts follow from it
            self.has_seed = False
            return
        collection = self._collector.collection()
        # a clock that lets each extraction take what it would take live
        ticks = iter((now, now, now + self._timing.extraction_s, now + self._timing.extraction_s))
        candidate = self._live.update(collection, lambda: next(ticks), force)
        self.has_seed = candidate.seed is not None
        if self._dispatcher is not None:
            self._dispatcher.set_progress(_progress(collection, candidate))

    # ------------------------------------------------------------- robots
    def _drive(self, now: float) -> None:
        if self._dispatcher is not None and self._dispatch_due.due(now):
            self._dispatch(now)
        scan, drive, navigation = self._scan_due.due(now), self._drive_due.due(now), self._navigation_due.due(now)
        for robot in self.robots.values():
            if scan:
                robot.scan(now)
            if navigation:
                robot.navigate(now, self._navigation_due.period)
            if drive:
                robot.drive(now)

    def _dispatch(self, now: float) -> None:
        assert self._dispatcher is not None
        if not self._dispatcher.wanted() and not any(robot.driving for robot in self.robots.values()):
            return
        decisions = self._dispatcher.decide(now, {name: robot.status(now) for name, robot in self.robots.items()})
        for name, decision in decisions.items():
            if decision.kind is Kind.CANCEL:
                self.robots[name].cancel()
            elif decision.kind is Kind.SEND and decision.viewpoint is not None:
                self.robots[name].send(decision.viewpoint.pose)


def _navigator(grid: GridMap, profile: RobotProfile) -> Navigator:
    """What vb_sim's navigation node drives with."""
    settings = _config("vb_sim", "navigation")
    costmap, follower = for_robot(profile, CostmapParams.from_mapping(settings.get("costmap"), "costmap"),
                                  FollowerParams.from_mapping(settings.get("follower"), "follower"))
    planner = PlannerParams.from_mapping(settings.get("planner"), "planner")
    navigator = Navigator(NavigatorParams(), costmap, planner, follower)
    navigator.set_map(grid)
    return navigator


def _dispatcher(world: World, method: Method, grid: GridMap, names: Sequence[str]) -> Dispatcher:
    """What robot_dispatcher knows from the start: robots, map, and the floor that ceiling cameras see."""
    dispatcher = Dispatcher(WatchParams(robots=list(names) if names != [""] else []))
    dispatcher.set_map(grid)
    dispatcher.set_physical_map(grid)
    for name, robot in zip(names, world.robots):
        dispatcher.set_view(name, FloorView(robot.color_model(), robot.camera_mount()))
    params = coverage.CoverageParams()
    heights = coverage.obstacle_heights(grid, params)
    seen = {name: coverage.floor_seen(grid, heights, world.camera(name).model(), world.camera(name).pose(), params)
            for name in method.cameras(world)}
    if seen:
        dispatcher.set_coverage(grid.with_data(coverage.combined(grid, seen, params.occupied_threshold)))
    return dispatcher


def _progress(collection: Any, candidate: Candidate) -> Progress:
    chain = candidate.chain
    return Progress(
        collection.interaction_id, chain.points if chain is not None else np.zeros((0, 2)),
        chain.closed if chain is not None else False, collection.border[:, 1:3], tuple(collection.cameras),
    )
