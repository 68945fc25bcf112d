"""Collects what is known of spot, drawing, maps and robots, and decides; the node only wires it."""
from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from vb_core.errors import ParameterError
from vb_core.grid_map import GridMap
from vb_core.notices import Notice, Severity
from vb_core.parameters import Parameters, param
from vb_robot import spots
from vb_robot.dispatching.dispatch import Decision, Fleet, Moment, RobotStatus
from vb_robot.dispatching.drawing import NOTHING, Drawing, BlindSpots
from vb_robot.spots import LOST_AFTER, Sighting, Sightings
from vb_robot.clearance_map import ClearanceMap, Window, around, window_of
from vb_robot.dispatching.view import FloorView
from vb_robot.dispatching.viewpoint import Outlook


@dataclass(frozen=True)
class WatchParams(Parameters):
    """Which robots there are."""

    robots: list = param([], doc="names of the robots, which are their namespaces; empty: one without a namespace")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not all(isinstance(name, str) and name for name in self.robots) or len(set(self.robots)) < len(self.robots):
            raise ParameterError("robots", f"expected names of robots, each once, got {self.robots!r}")


@dataclass(frozen=True)
class Progress:
    """What has been drawn so far.

    Attributes:
        chain: (M, 2) [m] the border's chain, empty before there is one; `closed` if it is a polygon.
        points: (N, 2) [m] the spots themselves.
        cameras: names of those that contributed.
    """

    interaction_id: str
    chain: np.ndarray = field(default_factory=lambda: NOTHING)
    closed: bool = False
    points: np.ndarray = field(default_factory=lambda: NOTHING)
    cameras: Tuple[str, ...] = ()


class RobotMap:
    """The map that applies to one robot of a radius [m], and what its camera sees of the floor."""

    def __init__(self, radius: float) -> None:
        self._radius = radius
        self.view: Optional[FloorView] = None
        self._own = False
        self._map: Optional[GridMap] = None
        self._physical: Optional[GridMap] = None
        self._terrain: Optional[Tuple[Window, ClearanceMap]] = None

    def set_map(self, grid: GridMap, own: bool = False) -> None:
        """Takes a map with borders; the robot's own one is not replaced by the common one."""
        if own or not self._own:
            self._own, self._map, self._terrain = own, grid, None

    def set_physical(self, grid: GridMap) -> None:
        """Takes the map without borders."""
        self._physical, self._terrain = grid, None

    def terrain(self, window: Window) -> Optional[ClearanceMap]:
        """The map in a window, prepared for questions; None before there is one."""
        if self._map is None:
            return None
        if self._terrain is None or self._terrain[0] != window:
            physical = around(self._physical, window) if self._physical is not None else None
            self._terrain = (window, ClearanceMap(around(self._map, window), self._radius, physical, edge=False))
        return self._terrain[1]

    def outlook(
        self, drawing: Drawing, status: RobotStatus, unseen: Optional[BlindSpots], others: Sequence
    ) -> Optional[Outlook]:
        """What the robot can see of a drawing from where it is and could go; None before that is known."""
        if self.view is None or status.pose is None:
            return None
        terrain = self.terrain(window_of(drawing.spot, drawing.chain, [status.pose[:2]]))
        return None if terrain is None else Outlook(terrain, self.view, drawing.aimed(terrain, unseen), others)


class Dispatcher:
    """Knows an interaction and decides where robots go. Different threads may feed and ask it.

    A goal is given only after a stationary camera saw the spot in this interaction: with none of them the person
    guides the robot. From then on every camera's spots tell where the spot is.

    Args:
        radii: [m] of the robots, by name.

    Attributes:
        notice: what to tell people now.
    """

    def __init__(self, watch: WatchParams = WatchParams(), radii: Mapping[str, float] = {}) -> None:
        self._fleet = Fleet(watch.robots or [""])
        self._grounds = {name: RobotMap(radii.get(name, 0.18)) for name in self._fleet.records}
        self._lock = threading.RLock()
        self._sightings = Sightings(mobile_cameras=watch.robots or ("robot",))
        self._progress: Optional[Progress] = None
        self._unseen: Optional[BlindSpots] = None
        self.notice: Optional[Notice] = None

    @property
    def robots(self) -> List[str]:
        """Names of the robots; "" is the only one, without a namespace."""
        return list(self._grounds)

    # ------------------------------------------------------------- inputs
    def set_map(self, grid: GridMap, robot: Optional[str] = None) -> None:
        """Takes the map with borders, for one robot or (None) for all that have no map of their own."""
        with self._lock:
            for name in self._grounds if robot is None else [robot]:
                self._grounds[name].set_map(grid, robot is not None)

    def set_physical_map(self, grid: GridMap) -> None:
        """Takes the map without borders: what hides the spot."""
        with self._lock:
            for grounds in self._grounds.values():
                grounds.set_physical(grid)

    def set_view(self, robot: str, view: FloorView) -> None:
        """Takes what a robot's camera sees of the floor; without it that robot is not sent."""
        self._grounds[robot].view = view

    def set_coverage(self, coverage: GridMap) -> None:
        """Takes how many stationary cameras see each cell; see camera_coverage_node."""
        unseen = BlindSpots(coverage)
        with self._lock:
            self._unseen = unseen

    def set_state(self, state: int, interaction_id: str, entered: float) -> bool:
        """Takes the interaction's state; says whether it changed."""
        with self._lock:
            return self._sightings.set_state(state, interaction_id, entered)

    def add(self, sighting: Sighting) -> None:
        """Takes a spot of any camera."""
        with self._lock:
            self._sightings.add(sighting)

    def set_progress(self, progress: Progress) -> None:
        """Takes what has been drawn so far."""
        with self._lock:
            self._progress = progress
            # also before any robot is wanted: that cameras contributed may be why one is
            if progress.interaction_id == self._sightings.key[0]:
                self._sightings.contributed(progress.cameras)

    # ------------------------------------------------------------- decisions
    @property
    def key(self) -> Tuple[str, int]:
        """Changes with interaction and state: a decision holds as long as this does."""
        with self._lock:
            return self._sightings.key

    def wanted(self) -> bool:
        """Whether a robot is wanted now."""
        with self._lock:
            return self._sightings.dispatches()

    def decide(self, now: float, robots: Mapping[str, RobotStatus]) -> Dict[str, Decision]:
        """Decides what each robot should do at a time [s]; takes some 10 ms when a new place is due."""
        with self._lock:
            known = self._sightings
            known.forget_after(now)
            drawing = self._drawing(now) if self.wanted() else None
            silent = known.silent(now)
            if known.newest() is None and drawing is not None and not drawing.seeding:
                silent = 2.0 * LOST_AFTER
            moment, unseen = Moment(now, self.wanted(), known.key, silent), self._unseen
            last_seen = known.newest().stamp if known.newest() is not None else -np.inf
        seeing = {}
        for name, status in robots.items():
            others = [place for other, its in robots.items() if other != name for place in its.places()]
            with self._lock:
                outlook = self._grounds[name].outlook(drawing, status, unseen, others) if drawing is not None else None
            seeing[name] = (status, outlook)
        decisions = self._fleet.step(moment, seeing)
        self.notice = None
        if drawing is not None and moment.key[1] == spots.BORDER:
            able = any(status.server and outlook is not None for status, outlook in seeing.values())
            self.notice = self._notice(now - last_seen > LOST_AFTER, drawing, unseen, able)
        return decisions

    def _drawing(self, now: float) -> Optional[Drawing]:
        known, progress = self._sightings, self._progress
        if progress is not None and progress.interaction_id != known.key[0]:
            progress = None
        target = known.target()
        if target is None and known.newest() is None and progress is not None and len(progress.points):
            # started again in the middle of a drawing: the line ends where the spot was seen last
            target = progress.points[-1]
        if target is None:
            return None
        chain, closed, ordered = NOTHING, False, True
        if progress is not None:
            chain, closed = progress.chain, progress.closed
            if len(chain) < 2:
                chain, closed, ordered = progress.points, False, False
        seeding = known.state == spots.SEED
        return Drawing(target, chain, known.velocity(), closed, seeding, ordered, known.watched(now),
                       searched=self._fleet.searched)

    def _notice(self, lost: bool, drawing: Drawing, unseen: Optional[BlindSpots], able: bool) -> Optional[Notice]:
        """What people should know: that no camera sees the spot, or will soon lose it, and what follows."""
        serving = self._fleet.serving
        comes = serving is not None and self._fleet.records[serving].goal is not None
        values = {"who": f"robot {serving}" if serving else "the robot"}
        if lost and comes and able:
            return Notice("spot_unseen_robot_comes", Severity.INFO, robot=serving or "", values=values)
        if lost:
            return Notice("spot_unseen_no_robot", Severity.WARNING)
        if drawing.watched and comes and unseen is not None and unseen.nearest(drawing.spot) is not None:
            return Notice("spot_ahead_unseen", Severity.INFO, robot=serving or "", values=values)
        return None
