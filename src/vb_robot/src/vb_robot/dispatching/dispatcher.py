"""Decides where robots go, from spot, drawing, maps and robots; the node only connects it to topics."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Dict, Iterable, Mapping, Optional, Sequence, Tuple

from vb_core.grid_map import GridMap, Window, crop
from vb_core.notices import Notice, Severity
from vb_core.vocabulary import SEED
from vb_robot.clearance_map import ClearanceMap, bounding_window
from vb_robot.dispatching.dispatch_policy import DispatchStatus, Fleet
from vb_robot.dispatching.viewpoint import DrawingState, FloorView, Viewpoint, ViewpointPlanner
from vb_robot.spot_sightings import LOST_TIMEOUT, Sightings

# [s] after which people are told: spots are confirmed late at the start of a stroke, and choosing a robot takes 1 s
UNSERVED_TIME = 2.0


class RobotMap:
    """The maps that apply to one robot of a radius [m], and its camera's view of the floor."""

    def __init__(self, radius: float) -> None:
        self._radius = radius
        self._view: Optional[FloorView] = None
        self._maps: Tuple[Optional[GridMap], Optional[GridMap]] = (None, None)
        self._clearance_map: Optional[Tuple[Window, ClearanceMap]] = None

    def update(self, view: Optional[FloorView], borders: Optional[GridMap], physical: Optional[GridMap]) -> None:
        """Stores the camera's view, the map with the borders that are for this robot, and the map without borders."""
        self._view = view
        if borders is not self._maps[0] or physical is not self._maps[1]:
            self._maps, self._clearance_map = (borders, physical), None

    def make_planner(
        self, drawing: DrawingState, status: DispatchStatus, others: Sequence
    ) -> Optional[ViewpointPlanner]:
        """Makes the robot's viewpoint planner for a drawing; None until map, pose and camera are known."""
        borders, physical = self._maps
        if self._view is None or status.pose is None or borders is None:
            return None
        window = bounding_window(drawing.spot, drawing.chain, [status.pose[:2]])
        if self._clearance_map is None or self._clearance_map[0] != window:
            seen_through = crop(physical, window) if physical is not None else None
            self._clearance_map = window, ClearanceMap(crop(borders, window), self._radius, seen_through)
        return ViewpointPlanner(self._clearance_map[1], self._view, drawing, others)


class Dispatcher:
    """Decides where robots go, from an interaction's messages. It must be used by one thread at a time.

    A goal is given only after a stationary camera saw the spot in this interaction: before that, and where there is no
    such camera, the person guides the robot. From then on the sightings of every camera count.

    Args:
        radii: [m] of the robots, by name; "" is the only one, without a namespace.

    Attributes:
        maps: of each robot, by name, with its camera's view.
        sightings: of the spot in this interaction.
        notice: the one to show to people now, if any.
    """

    def __init__(self, radii: Mapping[str, float]) -> None:
        self.maps = {name: RobotMap(radius) for name, radius in radii.items()}
        self.sightings = Sightings(mobile_cameras=[name or "robot" for name in radii])
        self.notice: Optional[Notice] = None
        self._fleet = Fleet(self.maps)
        self._unserved_since = math.inf  # [s] since when no camera sees the spot and no robot comes
        self._drawn: Tuple[str, DrawingState] = ("", DrawingState())  # in which interaction, and what

    def set_progress(self, interaction: str, drawn: DrawingState, cameras: Iterable[str]) -> None:
        """Stores what has been drawn so far in an interaction, and which cameras contributed."""
        self._drawn = interaction, drawn
        # also before any robot is wanted: one may be wanted because cameras contributed
        self.sightings.add_contributors(interaction, cameras)

    def decide(self, now: float, robots: Mapping[str, DispatchStatus]) -> Dict[str, Optional[Viewpoint]]:
        """Decides where each robot should be going at a time [s], see `Fleet`; takes some 10 ms for a new goal."""
        sightings, robot_wanted = self.sightings, self.sightings.should_dispatch()
        sightings.forget_after(now)
        drawing = self._drawing(now) if robot_wanted else None
        time_since_seen = sightings.time_since_seen(now)
        if sightings.newest() is None and drawing is not None and not drawing.seeding:
            time_since_seen = 2.0 * LOST_TIMEOUT  # this program was restarted in the middle of a drawing
        seeing = {}
        for name, status in robots.items():
            others = [its.pose[:2] for other, its in robots.items() if other != name and its.pose is not None]
            planner = self.maps[name].make_planner(drawing, status, others) if drawing is not None else None
            seeing[name] = (status, planner)
        goals = self._fleet.step(now, sightings.key if robot_wanted else None, time_since_seen, seeing)
        self._update_notice(now, lost=drawing is not None and time_since_seen > LOST_TIMEOUT)
        return goals

    def _drawing(self, now: float) -> Optional[DrawingState]:
        sightings, (interaction, drawn) = self.sightings, self._drawn
        if interaction != sightings.key[0]:
            drawn = DrawingState()
        if sightings.state == SEED and drawn.seed is not None:
            target = drawn.seed  # a camera that moves sees other bright things once the pointer is off
        elif sightings.newest() is not None:
            target = sightings.target()
        else:
            # this program was restarted in the middle of a drawing: the line ends where the spot was seen last; the
            # seed of a closed line is most likely within it, where a robot would hide it
            within = drawn.inside() if sightings.state == SEED else None
            target = drawn.spot if within is None else within
        if target is None:
            return None
        return replace(
            drawn,
            spot=target,
            velocity=sightings.velocity(),
            seeding=sightings.state == SEED,
            seen_by_stationary=sightings.seen_by_stationary(now),
        )

    def _update_notice(self, now: float, lost: bool) -> None:
        """Chooses the notice while no camera sees the spot: it says whether a robot comes."""
        comes = self._fleet.goal is not None
        self._unserved_since = min(self._unserved_since, now) if lost and not comes else math.inf
        self.notice = None
        if lost and comes:
            who = self._fleet.serving or ""
            self.notice = Notice.of_robot(who, "spot_not_seen_robot_looks", Severity.INFO)
        elif now - self._unserved_since >= UNSERVED_TIME:
            self.notice = Notice("spot_not_seen_no_robot", Severity.WARNING)
