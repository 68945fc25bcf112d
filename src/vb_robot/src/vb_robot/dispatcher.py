"""Deciding which robot goes where, from all that is known of spot, drawing, maps and robots; the node only wires it."""
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
from vb_robot.dispatch import Decision, DispatchParams, GoalStatus, Situation
from vb_robot.fleet import Fleet, Member
from vb_robot.prospect import ProspectParams, UnseenFloor, with_focus
from vb_robot.spots import LOST_AFTER, Sighting, Sightings
from vb_robot.terrain import Terrain, TerrainParams, around, window_of
from vb_robot.view import FloorView
from vb_robot.viewpoint import Drawing, Pose, Viewpoint, ViewpointParams, keeps_off, rank_viewpoints, shows_spot

WAY_CHECK = 0.5  # [s] between two looks at the way to the present goal: the search costs up to 20 ms


@dataclass(frozen=True)
class WatchParams(Parameters):
    """Which robots there are, and how the spot is watched between two decisions."""

    robots: list = param([], doc="names of the robots, which are their namespaces; empty: one without a namespace")
    mobile_cameras: tuple = param(("robot",), doc="names of cameras on robots, beside those of `robots`")

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
    chain: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    closed: bool = False
    points: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    cameras: Tuple[str, ...] = ()


@dataclass(frozen=True)
class RobotStatus:
    """How a robot is now.

    Attributes:
        pose: (x, y, yaw) [m, m, rad], map frame; None if it is not localised.
        server: whether its navigation is there.
        goal: what became of the last goal that was sent to it.
        busy: whether it drives to a goal that somebody else gave.
        goal_place: (x, y) [m] where it drives to, whoever gave the goal.
    """

    pose: Optional[Pose]
    server: bool = True
    goal: GoalStatus = GoalStatus.NONE
    busy: bool = False
    goal_place: Optional[Tuple[float, float]] = None

    def places(self) -> List[Tuple[float, float]]:
        """[m] where it stands and where it drives to: no place for another robot."""
        return [place for place in (self.pose[:2] if self.pose else None, self.goal_place) if place is not None]


class Grounds:
    """The map that holds for one robot, and what its camera sees of the floor."""

    def __init__(self, params: TerrainParams) -> None:
        self.params = params
        self.view: Optional[FloorView] = None
        self._own = False
        self._map: Optional[GridMap] = None
        self._physical: Optional[GridMap] = None
        self._terrain: Optional[Tuple[Tuple[float, ...], Terrain]] = None  # of which window
        self._judged: Optional[Viewpoint] = None  # whose way was looked at last, when, and what came out
        self._judged_at = 0.0
        self._safe = True

    def set_map(self, grid: GridMap, own: bool) -> None:
        """Takes a map with borders; one of the robot's own is not replaced by the common one."""
        if own or not self._own:
            self._own, self._map, self._terrain = own, grid, None

    def set_physical(self, grid: GridMap) -> None:
        """Takes the map without borders."""
        self._physical, self._terrain = grid, None

    def terrain(self, drawing: Drawing, pose: Optional[Pose]) -> Optional[Terrain]:
        """The map about the line and the robot, prepared for questions; None before there is one."""
        if self._map is None:
            return None
        window = window_of(drawing.spot, drawing.chain, [pose[:2]] if pose is not None else [])
        if self._terrain is None or self._terrain[0] != window:
            physical = around(self._physical, window) if self._physical is not None else None
            self._terrain = (window, Terrain(around(self._map, window), self.params, physical, edge=False))
        return self._terrain[1]

    def way_is_safe(
        self, now: float, terrain: Terrain, pose: Pose, goal: Viewpoint, drawing: Drawing, params: ViewpointParams
    ) -> bool:
        """Whether the way to a goal keeps off the line; looked at once in WAY_CHECK, since the search costs time."""
        if goal.risky and not drawing.seeding:
            return True
        if goal is not self._judged or not 0.0 <= now - self._judged_at < WAY_CHECK:
            self._judged, self._judged_at = goal, now
            self._safe = keeps_off(terrain, pose, goal.pose, drawing, params)
        return self._safe


class Dispatcher:
    """What is known about an interaction, and where robots go. May be fed and asked by different threads.

    A goal is given only after a stationary camera saw the spot in this interaction: with none of them the person
    leads the robot. From then on every camera's spots tell where the spot is.
    """

    def __init__(
        self,
        watch: WatchParams = WatchParams(),
        dispatch: DispatchParams = DispatchParams(),
        viewpoint: ViewpointParams = ViewpointParams(),
        terrain: TerrainParams = TerrainParams(),
        prospect: ProspectParams = ProspectParams(),
        radii: Mapping[str, float] = {},
    ) -> None:
        self._watch = watch
        self._viewpoint = viewpoint
        self._prospect = prospect
        self._min_sightings = dispatch.min_sightings
        self._fleet = Fleet(dispatch, watch.robots or [""])
        self._grounds = {
            name: Grounds(terrain.replace(robot_radius=radii.get(name, terrain.robot_radius)))
            for name in self._fleet.policies}
        self._lock = threading.RLock()
        self._sightings = Sightings(mobile_cameras=(*watch.mobile_cameras, *watch.robots))
        self._progress: Optional[Progress] = None
        self._unseen: Optional[UnseenFloor] = None
        self.notice: Optional[Notice] = None  # what people are to be told now

    @property
    def robots(self) -> List[str]:
        """Names of the robots; "" is the only one, without a namespace."""
        return list(self._grounds)

    # ------------------------------------------------------------- what comes in
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
        unseen = UnseenFloor(coverage, self._prospect.least_gap)
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
        """What each robot is to do now [s]; takes up to some tenths of a second when a new place is due."""
        with self._lock:
            known = self._sightings
            known.forget_after(now)
            wanted, key = self.wanted(), known.key
            drawing = self._drawing(now) if wanted else None
            silent = known.silent(now)
            if known.newest() is None and drawing is not None and not drawing.seeding:
                silent = 2.0 * LOST_AFTER
            unseen = self._unseen
        members = []
        for name, status in robots.items():
            others = [place for other, its in robots.items() if other != name for place in its.places()]
            members.append(self._member(name, status, now, drawing, silent, unseen, wanted, key, others))
        decisions = self._fleet.step(members)
        self.notice = self._notice(now, drawing, unseen, members)
        return decisions

    def _drawing(self, now: float) -> Optional[Drawing]:
        known, progress = self._sightings, self._progress
        if progress is not None and progress.interaction_id != known.key[0]:
            progress = None
        target = known.target(self._min_sightings)
        if target is None and known.newest() is None and progress is not None and len(progress.points):
            # started again in the middle of a drawing: the line ends where the spot was seen last
            target = progress.points[-1]
        if target is None:
            return None
        chain, closed, ordered = np.zeros((0, 2)), False, True
        if progress is not None:
            chain, closed = progress.chain, progress.closed
            if len(chain) < 2:
                chain, closed, ordered = progress.points, False, False
        seeding = known.state == spots.SEED
        return Drawing(target, chain, known.direction(), closed, seeding, ordered, known.watched(now))

    def _member(
        self,
        name: str,
        status: RobotStatus,
        now: float,
        drawing: Optional[Drawing],
        silent: float,
        unseen: Optional[UnseenFloor],
        wanted: bool,
        key: Tuple[str, int],
        others: Sequence[Tuple[float, float]],
    ) -> Member:
        """What the fleet needs to know of a robot."""
        grounds = self._grounds[name]
        with self._lock:
            pose = status.pose if wanted and grounds.view is not None else None
            terrain = grounds.terrain(drawing, pose) if wanted and drawing is not None else None
        view = grounds.view
        spot: Optional[Tuple[float, float]] = None
        if drawing is not None and terrain is not None:
            drawing = with_focus(terrain, unseen, drawing, self._prospect)
            spot = (float(drawing.look_at[0]), float(drawing.look_at[1]))
        goal = self._fleet.policies[name].goal

        def fit(place: Pose) -> bool:
            assert terrain is not None and drawing is not None and view is not None
            if goal is not None and place == goal.pose and not terrain.stands_free(np.array([place[:2]]))[0]:
                return False
            return shows_spot(terrain, view, place, drawing, self._viewpoint)

        def rank() -> List[Viewpoint]:
            assert terrain is not None and view is not None and drawing is not None and pose is not None
            return rank_viewpoints(terrain, view, pose, drawing, self._viewpoint, others)

        def safe(viewpoint: Viewpoint) -> bool:
            assert terrain is not None and drawing is not None and pose is not None
            return grounds.way_is_safe(now, terrain, pose, viewpoint, drawing, self._viewpoint)

        situation = Situation(now, wanted, key, spot, pose, status.server, status.goal, silent)
        return Member(name, situation, status.busy, fit, rank, safe)

    # ------------------------------------------------------------- words
    def _notice(
        self,
        now: float,
        drawing: Optional[Drawing],
        unseen: Optional[UnseenFloor],
        members: Sequence[Member],
    ) -> Optional[Notice]:
        """What people should know: that no camera sees the spot, or will not see it soon, and what comes of it."""
        with self._lock:
            newest, key = self._sightings.newest(), self._sightings.key
        if drawing is None or key[1] != spots.BORDER:
            return None
        serving = self._fleet.serving
        comes = serving is not None and self._fleet.policies[serving].goal is not None
        able = any(member.situation.server and member.situation.robot is not None for member in members)
        values = {"who": f"robot {serving}" if serving else "the robot"}
        if newest is None or now - newest.stamp > LOST_AFTER:
            if comes and able:
                return Notice("spot_unseen_robot_comes", Severity.INFO, robot=serving or "", values=values)
            return Notice("spot_unseen_no_robot", Severity.WARNING)
        near = unseen.nearest(drawing.spot, self._prospect.beside) if unseen is not None else None
        if drawing.watched and near is not None and comes:
            return Notice("spot_ahead_unseen", Severity.INFO, robot=serving or "", values=values)
        return None
