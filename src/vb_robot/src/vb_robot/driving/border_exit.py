"""Drives a robot to where navigation can plan: out of a border that was saved where it is, or away from an edge.

Navigation plans nothing from inside an occupied area, so the robot is driven along the shortest path over floor
without physical obstacles to allowed floor. Its goal waits meanwhile.
"""

from __future__ import annotations

import math
from typing import Optional, Tuple

import cv2
import numpy as np

from vb_core import geometry
from vb_core.grid_layers import clearance_grid, crop
from vb_core.navigation_parameters import PATH_MARGIN
from vb_core.poses import Pose, look_ahead
from vb_robot.clearance_map import ClearanceMap
from vb_robot.driving.spot_follower import MAX_SPEED, VelocityRequest, steer
from vb_robot.driving.workspace import LETHAL_THRESHOLD, Workspace

LOOKAHEAD = 0.2  # [m] to the point of the path that it steers for
MAX_PATH_DEVIATION = 0.15  # [m] farther off (the localisation jumped) a new path is planned
MARGIN = 0.08  # [m] beyond the radius counts as free: cells and localisation are a few centimetres off
MAP_MARGIN = 0.05  # [m] from mapped obstacles on the path
MIN_AREA = 0.3  # [m^2] less room for the robot's centre is a gap between border and wall, not a goal
# [s, m] if in that time the rest of the path has not become shorter, it gives up
PROGRESS_TIMEOUT, MIN_PROGRESS = (15.0, 0.05)
PINCHED_AFTER = 1.5  # [s] navigation has a goal and moves nothing: beside something it may find no path from here
RETRY_DELAY = 20.0  # [s] after it gave up: the person in the way may have gone
WINDOW = 10.0  # [m] around the robot: no path out is that long


class ExitPlanner:
    """Finds allowed floor and the shortest path to it, around a place (2,) [m] for a robot of a radius [m]."""

    def __init__(self, workspace: Workspace, radius: float, place) -> None:
        window = (place[0] - WINDOW, place[1] - WINDOW, place[0] + WINDOW, place[1] + WINDOW)
        map_with_borders, physical = crop(workspace.keep_out, window), crop(workspace.physical, window)
        # a robot that stops a few centimetres short, or one cell away, counts as free
        room = MARGIN + 0.03 + map_with_borders.resolution
        # the robot cuts corners by some centimetres; it keeps to the path only where there is no room for that
        self._clearance_maps = [
            ClearanceMap(physical, radius, travel_margin=MAP_MARGIN + spare, occupied=LETHAL_THRESHOLD)
            for spare in (0.08, 0.02)
        ]
        beyond = self._clearance_maps[0].clearance
        clearance = clearance_grid(
            (map_with_borders.data >= LETHAL_THRESHOLD) | (map_with_borders.data < 0), map_with_borders.resolution
        )
        fits = ((clearance >= radius + room) & (beyond >= radius + room)).astype(np.uint8)
        _, labels, stats, _ = cv2.connectedComponentsWithStats(fits, connectivity=8)
        large = stats[:, cv2.CC_STAT_AREA] * map_with_borders.resolution**2 >= MIN_AREA
        large[0] = False
        self._allowed = map_with_borders.cell_to_world(np.argwhere(large[labels]))

    def plan_path(self, place) -> Optional[np.ndarray]:
        """Plans the shortest path (N, 2) [m] from a place (2,) [m] to allowed floor; None if none can be reached."""
        if not len(self._allowed):
            return None
        for clearance_map in self._clearance_maps:
            paths = clearance_map.shortest_paths(place)
            # the path grid is coarser than the map's: within one of its cells the nearest place counts
            lengths = paths.lengths_to(self._allowed) + 0.01 * np.linalg.norm(self._allowed - np.asarray(place), axis=1)
            best = int(np.argmin(lengths))
            if np.isfinite(lengths[best]):
                return paths.path_to(self._allowed[best])
        return None


class BorderExit:
    """Drives a robot to where navigation plans again, in one of two cases.

    A border was saved where the robot is. Or navigation has a goal and moves nothing, and something is nearer than its
    paths keep from it: they keep PATH_MARGIN more than its controller, which may end where no path begins. A robot that
    navigation or a person brought near a border is otherwise left alone.

    Args:
        radius: [m]; exit_borders: whether it leaves borders; the other case is always helped.

    Attributes:
        failed: why the last try ended, as a code, while it waits to try again; else empty.
    """

    def __init__(self, radius: float, exit_borders: bool) -> None:
        self._radius, self._exit_borders = radius, exit_borders
        self._workspace: Optional[Workspace] = None
        self._before: Optional[Workspace] = None  # the maps by which it is known where the robot was
        self._enclosed: Optional[bool] = None  # whether the newest map put a border where it is; None: not yet known
        self._leaves = False  # whether it is leaving a border that older maps had
        self._idle_since = self._retry_at = -math.inf
        self.failed = ""
        self._end()

    def _end(self) -> None:
        self._under_way = False
        self._route: Optional[np.ndarray] = None
        self._wanted: Optional[Tuple[Workspace, Tuple[float, float]]] = None  # what `find_route` is to plan
        self.pause()

    def set_maps(self, workspace: Optional[Workspace]) -> None:
        """Stores new maps; None: they are not known."""
        if self._enclosed is not None:
            self._before, self._leaves = self._workspace, self._enclosed
        self._workspace, self._enclosed, self._retry_at, self.failed = workspace, None, -math.inf, ""
        self._end()

    def wanted_route(self) -> Optional[Tuple[Workspace, Tuple[float, float]]]:
        """Returns the maps and the place (2,) [m] from which a path is to be planned, by `find_route`; None: none."""
        return self._wanted

    def find_route(self, wanted: Tuple[Workspace, Tuple[float, float]]) -> Optional[np.ndarray]:
        """Plans the path (N, 2) [m]; takes up to a second, and may be called from another thread."""
        workspace, place = wanted
        return ExitPlanner(workspace, self._radius, place).plan_path(place)

    def set_route(self, wanted: Tuple[Workspace, Tuple[float, float]], route: Optional[np.ndarray], now: float) -> None:
        """Stores the path that `find_route` found, if it is still wanted."""
        if wanted is self._wanted:
            self._wanted, self._route = None, route
            self.pause()
            if route is None:
                self._give_up(now, "no_exit_path")

    def pause(self) -> None:
        """Restarts the time limit: while another source drives, or none may, no progress is expected."""
        self._shortest: Tuple[float, float] = math.inf, math.inf  # [m] of the path left at least, and since when [s]

    def compute_request(
        self, now: float, pose: Pose, calm: bool, goal: bool, moves: bool, stopped_by: str
    ) -> Optional[VelocityRequest]:
        """Computes how the robot should move at a time [s]; None if it needs no help.

        Args:
            calm: nobody draws or guides; goal: navigation has one; moves: navigation requests motion.
            stopped_by: what kept the last request from being granted, as a code.
        """
        workspace = self._workspace
        if workspace is None:
            return None
        to_border = workspace.distance_to_keep_out(pose) - self._radius
        to_blocked = workspace.distance_to_blocked(pose) - self._radius
        if moves or not goal:
            self._idle_since = now
        under_way = self._under_way
        if self._enclosed is None:
            # only a border that came where the robot was; into another one somebody has taken it
            came = self._before is not None and self._before.distance_to_keep_out(pose) >= self._radius
            inside = to_border < 0.0 and workspace.is_lethal(pose[:2])
            self._enclosed = self._exit_borders and inside and (came or self._leaves)
        if self._enclosed:
            needed = self._enclosed = to_border < 0.0 or (under_way and to_blocked < MARGIN)
        elif under_way:
            needed = goal and to_blocked < MARGIN
        else:
            needed = -self._radius < to_blocked < PATH_MARGIN + 0.02 and 0.0 <= now - self._idle_since >= PINCHED_AFTER
        if not needed or not calm or 0.0 <= self._retry_at - now <= RETRY_DELAY:
            self._end()
            return None
        if not under_way:
            self._under_way, self.failed = True, ""
        if self._route is None or float(np.linalg.norm(self._route - pose[:2], axis=1).min()) > MAX_PATH_DEVIATION:
            self._route = None
            self._wanted = self._wanted or (workspace, (pose[0], pose[1]))
            self.pause()
            return VelocityRequest(0.0, 0.0, "plans_exit")
        target, off, rest = look_ahead(self._route, pose[:2], LOOKAHEAD)
        remaining = rest + off
        if remaining < self._shortest[0] - MIN_PROGRESS:
            self._shortest = remaining, now
        elif now - self._shortest[1] > PROGRESS_TIMEOUT:
            return self._give_up(now, stopped_by or "takes_too_long")
        if math.dist(target, pose[:2]) < 0.015:
            return VelocityRequest(0.0, 0.0)
        bearing = geometry.wrap_angle(math.atan2(target[1] - pose[1], target[0] - pose[0]) - pose[2])
        return VelocityRequest(*steer(bearing, min(MAX_SPEED, 0.8 * remaining + 0.03)))

    def _give_up(self, now: float, code: str) -> VelocityRequest:
        self.failed, self._retry_at = code, now + RETRY_DELAY
        self._end()
        return VelocityRequest(0.0, 0.0, code)
