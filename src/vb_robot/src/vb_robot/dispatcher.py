"""Deciding which robot goes where, from all that is known of spot, drawing, maps and robots; the node only wires it."""
from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from vb_core.errors import ParameterError
from vb_core.grid_map import GridMap
from vb_core.parameters import Parameters, param
from vb_robot import sightings
from vb_robot.dispatch import Decision, DispatchParams, GoalStatus, Situation
from vb_robot.fleet import Fleet, Member
from vb_robot.notices import Notices
from vb_robot.prospect import ProspectParams, UnseenFloor, with_focus
from vb_robot.sightings import Sighting, Sightings
from vb_robot.terrain import Terrain, TerrainParams
from vb_robot.view import FloorView, ViewParams
from vb_robot.viewpoint import Drawing, Pose, Viewpoint, ViewpointParams, keeps_off, rank_viewpoints, shows_spot

WANTED = (sightings.BORDER, sightings.SEED)


@dataclass(frozen=True)
class WatchParams(Parameters):
    """Which robots there are, and how the spot is watched between two decisions."""

    robots: list = param([], doc="names of the robots, which are their namespaces; empty: one without a namespace")
    way_check: float = param(0.5, "s", low=0.0, doc="between two looks at the way to the present goal")
    min_confidence: float = param(0.4, low=0.0, high=1.0, doc="a spot less certain than this sends no robot")
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
    """The map that holds for one robot, and the ways on it."""

    def __init__(self, params: TerrainParams) -> None:
        self._params = params
        self._own = False
        self._map: Optional[GridMap] = None
        self._physical: Optional[GridMap] = None
        self._terrain: Optional[Terrain] = None
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

    def terrain(self) -> Optional[Terrain]:
        """The map prepared for questions, which takes a moment after each new map; None before there is one."""
        if self._terrain is None and self._map is not None:
            self._terrain = Terrain(self._map, self._params, self._physical)
        return self._terrain

    def way_is_safe(
        self, now: float, period: float, pose: Pose, goal: Viewpoint, drawing: Drawing, params: ViewpointParams
    ) -> bool:
        """Whether the way to a goal keeps off the line; looked at once in a period [s], since the search is dear."""
        if goal.risky and not drawing.seeding:
            return True
        if goal is not self._judged or not 0.0 <= now - self._judged_at < period:
            terrain = self.terrain()
            assert terrain is not None
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
        view: ViewParams = ViewParams(),
        terrain: TerrainParams = TerrainParams(),
        prospect: ProspectParams = ProspectParams(),
    ) -> None:
        self._watch = watch
        self._viewpoint = viewpoint
        self._prospect = prospect
        self._min_sightings = dispatch.min_sightings
        self._view = FloorView(view)
        self._fleet = Fleet(dispatch, watch.robots or [""])
        self._grounds = {name: Grounds(terrain) for name in self._fleet.policies}
        self._notices = Notices()
        self._lock = threading.RLock()
        self._sightings = Sightings(mobile_cameras=(*watch.mobile_cameras, *watch.robots))
        self._progress: Optional[Progress] = None
        self._unseen: Optional[UnseenFloor] = None
        self.notice: Optional[str] = None  # what people are to be told since the last decision

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
        """Takes a spot of any camera, if it is certain enough."""
        if sighting.confidence < self._watch.min_confidence:
            return
        with self._lock:
            self._sightings.add(sighting)

    def set_progress(self, progress: Progress) -> None:
        """Takes what has been drawn so far."""
        with self._lock:
            self._progress = progress

    # ------------------------------------------------------------- decisions
    @property
    def key(self) -> Tuple[str, int]:
        """Changes with interaction and state: a decision holds as long as this does."""
        with self._lock:
            return self._sightings.key

    def wanted(self) -> bool:
        """Whether a robot is wanted now."""
        with self._lock:
            return self._sightings.state in WANTED and self._sightings.stationary_seen

    def decide(self, now: float, robots: Mapping[str, RobotStatus]) -> Dict[str, Decision]:
        """What each robot is to do now [s]; takes up to some tenths of a second when a new place is due."""
        with self._lock:
            known = self._sightings
            known.forget_after(now)
            wanted, key = self.wanted(), known.key
            drawing = self._drawing(now) if wanted else None
            silent = known.silent(now)
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
        if progress is not None:
            known.contributed(progress.cameras)
        target = known.target(self._min_sightings)
        if target is None:
            return None
        chain, closed, ordered = np.zeros((0, 2)), False, True
        if progress is not None:
            chain, closed = progress.chain, progress.closed
            if len(chain) < 2:
                chain, closed, ordered = progress.points, False, False
        seeding = known.state == sightings.SEED
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
            terrain = grounds.terrain() if wanted else None
        pose = status.pose if wanted else None
        spot: Optional[Tuple[float, float]] = None
        if drawing is not None and terrain is not None:
            drawing = with_focus(terrain, unseen, drawing, self._prospect)
            spot = (float(drawing.look_at[0]), float(drawing.look_at[1]))
        goal = self._fleet.policies[name].goal

        def fit(place: Pose) -> bool:
            assert terrain is not None and drawing is not None
            if goal is not None and place == goal.pose and not terrain.stands_free(np.array([place[:2]]))[0]:
                return False
            return shows_spot(terrain, self._view, place, drawing, self._viewpoint)

        def rank() -> List[Viewpoint]:
            assert terrain is not None and drawing is not None and pose is not None
            return rank_viewpoints(terrain, self._view, pose, drawing, self._viewpoint, others)

        def safe(viewpoint: Viewpoint) -> bool:
            assert drawing is not None and pose is not None
            return grounds.way_is_safe(now, self._watch.way_check, pose, viewpoint, drawing, self._viewpoint)

        situation = Situation(now, wanted, key, spot, pose, status.server, status.goal, silent)
        return Member(name, situation, status.busy, fit, rank, safe)

    # ------------------------------------------------------------- words
    def _notice(
        self,
        now: float,
        drawing: Optional[Drawing],
        unseen: Optional[UnseenFloor],
        members: Sequence[Member],
    ) -> Optional[str]:
        with self._lock:
            newest, key = self._sightings.newest(), self._sightings.key
        if drawing is None or newest is None or key[1] != sightings.BORDER:
            return self._notices.step(now, key, 0.0, False, False, False, False, "")
        serving = self._fleet.serving
        comes = serving is not None and self._fleet.policies[serving].goal is not None
        able = any(member.situation.server and member.situation.robot is not None for member in members)
        # cameras lose a spot that leaves their image: the place where it was seen last is one that they see well
        place = drawing.spot if drawing.direction is None else drawing.spot + self._prospect.ahead * drawing.direction
        uncovered = unseen is not None and bool(unseen.at(place[None])[0])
        near = unseen.nearest(drawing.spot, self._prospect.beside) if unseen is not None else None
        ahead = drawing.watched and near is not None
        who = f"robot {serving}" if serving else "the robot"
        return self._notices.step(now, key, now - newest.stamp, uncovered, ahead, comes, able, who)
