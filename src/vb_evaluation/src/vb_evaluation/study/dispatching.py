"""Deciding where to send a robot, from all that is known of spot, drawing and map; the node only wires it."""
from __future__ import annotations

import threading
from dataclasses import dataclass, field, replace
from typing import List, Optional, Tuple

import numpy as np

from vb_core.grid_map import GridMap
from vb_core.parameters import Parameters, param
from vb_robot import sightings
from vb_robot.dispatch import Decision, DispatchParams, DispatchPolicy, GoalStatus, Situation
from vb_robot.sightings import Sighting, Sightings
from vb_robot.terrain import Terrain, TerrainParams
from vb_robot.view import FloorView, ViewParams
from vb_robot.viewpoint import Drawing, Pose, Viewpoint, ViewpointParams, keeps_off, rank_viewpoints, shows_spot


@dataclass(frozen=True)
class WatchParams(Parameters):
    """How the spot is watched between two decisions."""

    way_check: float = param(0.5, "s", low=0.0, doc="between two looks at the way to the present goal")
    lost_speed: float = param(0.3, "m/s", low=0.0, high=2.0, doc="a spot that nobody sees has moved on like this")
    lost_distance: float = param(0.5, "m", low=0.0, high=2.0, doc="but not farther than this")
    mobile_cameras: tuple = param(("robot",), doc="names of cameras on robots")


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


class Dispatcher:
    """What one robot's dispatcher knows, and its decisions. May be fed and asked by different threads.

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
    ) -> None:
        self._watch = watch
        self._dispatch = dispatch
        self._viewpoint = viewpoint
        self._terrain_params = terrain
        self._view = FloorView(view)
        self._policy = DispatchPolicy(dispatch)
        self._lock = threading.Lock()
        self._sightings = Sightings(mobile_cameras=watch.mobile_cameras)
        self._progress: Optional[Progress] = None
        self._map: Optional[GridMap] = None
        self._physical: Optional[GridMap] = None
        self._terrain: Optional[Terrain] = None
        self._judged: Optional[Viewpoint] = None  # whose way was looked at last, when, and what came out
        self._judged_at = 0.0
        self._way_safe = True

    # ------------------------------------------------------------- what comes in
    def set_map(self, grid: GridMap) -> None:
        """Takes the map with borders: where the robot may stand."""
        with self._lock:
            self._map, self._terrain = grid, None

    def set_physical_map(self, grid: GridMap) -> None:
        """Takes the map without borders: what hides the spot."""
        with self._lock:
            self._physical, self._terrain = grid, None

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

    # ------------------------------------------------------------- decisions
    def wanted(self) -> bool:
        """Whether a robot is wanted now."""
        with self._lock:
            return self._wanted()

    def decide(self, now: float, robot: Optional[Pose], server: bool, goal: GoalStatus) -> Decision:
        """The decision for now [s].

        Args:
            robot: (x, y, yaw) [m, m, rad], map frame; None if it is not localised.
            server: whether navigation is there.
            goal: what became of the last goal.
        """
        drawing, gone_on, wanted, key = self._gather(now)
        terrain = self._prepared_terrain() if wanted else None
        if drawing is not None and terrain is not None and drawing.direction is not None and gone_on > 0.0:
            drawing = replace(drawing, spot=_thought_on(terrain, drawing.spot, drawing.direction, gone_on))
        spot = (float(drawing.spot[0]), float(drawing.spot[1])) if drawing is not None and terrain is not None else None
        present = self._policy.goal

        def fit(pose: Pose) -> bool:
            assert terrain is not None and drawing is not None
            if present is not None and pose == present.pose and not terrain.stands_free(np.array([pose[:2]]))[0]:
                return False
            return shows_spot(terrain, self._view, pose, drawing, self._viewpoint)

        def rank() -> List[Viewpoint]:
            assert terrain is not None and drawing is not None and robot is not None
            return rank_viewpoints(terrain, self._view, robot, drawing, self._viewpoint)

        def safe(viewpoint: Viewpoint) -> bool:
            assert terrain is not None and drawing is not None and robot is not None
            if viewpoint.risky and not drawing.seeding:
                return True
            # the search is too dear for every decision
            if viewpoint is not self._judged or not 0.0 <= now - self._judged_at < self._watch.way_check:
                self._judged, self._judged_at = viewpoint, now
                self._way_safe = keeps_off(terrain, robot, viewpoint.pose, drawing, self._viewpoint)
            return self._way_safe

        situation = Situation(now, wanted, key, spot, robot if wanted else None, server, goal)
        return self._policy.step(situation, fit, rank, safe)

    def _wanted(self) -> bool:
        return self._sightings.state in (sightings.BORDER, sightings.SEED) and self._sightings.stationary_seen

    def _gather(self, now: float) -> Tuple[Optional[Drawing], float, bool, Tuple[str, int]]:
        """(what is being drawn, how far its spot has gone on unseen [m], whether a robot is wanted, the key)."""
        with self._lock:
            known, progress = self._sightings, self._progress
            known.forget_after(now)
            key = known.key
            if progress is not None and progress.interaction_id != key[0]:
                progress = None
            if progress is not None:
                known.contributed(progress.cameras)
            wanted = self._wanted()
            target = known.target(self._dispatch.min_sightings) if wanted else None
            direction = known.direction() if target is not None else None
            watched = known.watched(now)
            gone_on = known.gone_on(now, self._watch.lost_speed, self._watch.lost_distance)
        if target is None:
            return None, 0.0, wanted, key
        chain, closed, ordered = np.zeros((0, 2)), False, True
        if progress is not None:
            chain, closed = progress.chain, progress.closed
            if len(chain) < 2:
                chain, closed, ordered = progress.points, False, False
        drawing = Drawing(target, chain, direction, closed, key[1] == sightings.SEED, ordered, watched)
        return drawing, gone_on, wanted, key

    def _prepared_terrain(self) -> Optional[Terrain]:
        with self._lock:
            terrain, grid, physical = self._terrain, self._map, self._physical
        if terrain is not None or grid is None:
            return terrain
        terrain = Terrain(grid, self._terrain_params, physical)
        with self._lock:
            # a map that came meanwhile makes the next call prepare again
            if self._map is grid and self._physical is physical:
                self._terrain = terrain
        return terrain


def _thought_on(terrain: Terrain, spot: np.ndarray, direction: np.ndarray, distance: float) -> np.ndarray:
    """(2,) [m] a spot (2,) moved on along a unit vector (2,), but not into a wall."""
    room = float(np.linalg.norm(terrain.ray_end(spot, direction) - spot)) - 0.05
    return spot + min(distance, max(0.0, room)) * direction
