"""Decides where robots go, from the spot, the drawing, the maps and the robots' states."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Dict, Iterable, Mapping, Optional, Sequence, Tuple

from vb_core.grid_map import GridMap, Window, crop
from vb_core.interaction_tables import SEED
from vb_core.notices import Notice, Severity
from vb_robot.clearance_map import ClearanceMap, bounding_window
from vb_robot.dispatching.dispatch_policy import DispatchPolicy, DispatchStatus
from vb_robot.dispatching.viewpoint import DrawingState, RobotCameraView, Viewpoint, ViewpointPlanner
from vb_robot.spot_sightings import LOST_TIMEOUT, SpotSightings

# [s] until a notice says that no robot comes: the first spots are confirmed late, and choosing a robot takes 1 s
UNSERVED_TIME = 2.0


class RobotMap:
    """The maps that apply to one robot, and its camera's view of the floor."""

    def __init__(self, radius: float) -> None:
        self._radius = radius
        self._view: Optional[RobotCameraView] = None
        self._maps: Tuple[Optional[GridMap], Optional[GridMap]] = (None, None)
        self._clearance_map: Optional[Tuple[Window, ClearanceMap]] = None

    def update(self, view: Optional[RobotCameraView], borders: Optional[GridMap], physical: Optional[GridMap]) -> None:
        """Stores the camera's view, the map with the borders that are for this robot, and the map without borders."""
        self._view = view
        if borders is not self._maps[0] or physical is not self._maps[1]:
            self._maps = (borders, physical)
            self._clearance_map = None

    def make_planner(
        self, drawing: DrawingState, status: DispatchStatus, others: Sequence
    ) -> Optional[ViewpointPlanner]:
        """Makes the robot's viewpoint planner for a drawing. Returns None until map, pose and camera are known."""
        borders, physical = self._maps
        if self._view is None or status.pose is None or borders is None:
            return None
        window = bounding_window(drawing.spot, drawing.chain, status.pose)
        if self._clearance_map is None or self._clearance_map[0] != window:
            view_grid = crop(physical, window) if physical is not None else None
            self._clearance_map = window, ClearanceMap(crop(borders, window), self._radius, view_grid)
        return ViewpointPlanner(self._clearance_map[1], self._view, drawing, others)


class Dispatcher:
    """Decides where robots go, from an interaction's messages. Only one thread may use it at a time.

    A goal is given only after a stationary camera has seen the spot in this interaction. Before that, and where there
    is no such camera, the person guides the robot. Afterwards, all cameras' sightings count.

    Args:
        radii: [m] of the robots, by name; "" for a single robot without a namespace.

    Attributes:
        maps: each robot's maps and its camera's view, by name.
        sightings: the sightings of the spot in this interaction.
        notice: the notice to show to people now, if any.
    """

    def __init__(self, radii: Mapping[str, float]) -> None:
        self.maps = {name: RobotMap(radius) for name, radius in radii.items()}
        self.sightings = SpotSightings(mobile_cameras=[name or "robot" for name in radii])
        self.notice: Optional[Notice] = None
        self._policy = DispatchPolicy(self.maps)
        self._unserved_since = math.inf  # [s] time since which no camera sees the spot and no robot comes
        self._drawn_in = ""  # the interaction of the newest drawing
        self._newest_drawing = DrawingState()

    def set_progress(self, interaction: str, drawn: DrawingState, cameras: Iterable[str]) -> None:
        """Stores what has been drawn so far in an interaction, and which cameras contributed."""
        self._drawn_in = interaction
        self._newest_drawing = drawn
        # these cameras count even before a robot is wanted, because they decide whether one is
        self.sightings.add_contributors(interaction, cameras)

    def decide(self, now: float, robots: Mapping[str, DispatchStatus]) -> Dict[str, Optional[Viewpoint]]:
        """Decides each robot's goal at time `now` [s], as `DispatchPolicy.step` does. A new goal takes some 10 ms."""
        sightings = self.sightings
        robot_wanted = sightings.should_dispatch()
        sightings.forget_after(now)
        drawing = self._drawing(now) if robot_wanted else None
        time_since_seen = sightings.time_since_seen(now)
        if sightings.newest() is None and drawing is not None and not drawing.marks_side:
            time_since_seen = 2.0 * LOST_TIMEOUT  # the program was restarted in the middle of a drawing
        planners: Dict[str, Optional[ViewpointPlanner]] = {}
        for name, status in robots.items():
            others = [entry.pose[:2] for other, entry in robots.items() if other != name and entry.pose is not None]
            planners[name] = self.maps[name].make_planner(drawing, status, others) if drawing is not None else None
        task = sightings.key if robot_wanted else None
        goals = self._policy.step(now, task, time_since_seen, robots, planners)
        self._update_notice(now, lost=drawing is not None and time_since_seen > LOST_TIMEOUT)
        return goals

    def _drawing(self, now: float) -> Optional[DrawingState]:
        """Returns the drawing with its spot at time `now` [s], or None while the spot's position is not known."""
        sightings = self.sightings
        drawing = self._newest_drawing if self._drawn_in == sightings.key[0] else DrawingState()
        if sightings.state == SEED and drawing.seed is not None:
            target = drawing.seed  # a moving camera sees other bright things once the pointer is off
        elif sightings.newest() is not None:
            target = sightings.target()
        else:
            # after a restart, the spot was last at the line's end; a closed line's seed is inside, where robots hide it
            inner_point = drawing.interior_point() if sightings.state == SEED else None
            target = drawing.spot if inner_point is None else inner_point
        if target is None:
            return None
        return replace(
            drawing,
            spot=target,
            velocity=sightings.velocity(),
            marks_side=sightings.state == SEED,
            seen_by_stationary=sightings.seen_by_stationary(now),
        )

    def _update_notice(self, now: float, lost: bool) -> None:
        """Updates the notice, which says whether a robot comes while no camera sees the spot."""
        is_coming = self._policy.goal is not None
        self._unserved_since = min(self._unserved_since, now) if lost and not is_coming else math.inf
        notice = None
        if lost and is_coming:
            notice = Notice.of_robot(self._policy.serving or "", "spot_not_seen_robot_looks", Severity.INFO)
        elif now - self._unserved_since >= UNSERVED_TIME:
            notice = Notice("spot_not_seen_no_robot", Severity.WARNING)
        self.notice = notice  # set in one step, because another thread reads it
