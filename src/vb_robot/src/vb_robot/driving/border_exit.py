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
from vb_robot.clearance_map import ClearanceMap, clearance_grid, crop
from vb_robot.driving.spot_follower import MAX_SPEED, VelocityRequest, steer
from vb_robot.driving.workspace import LETHAL_THRESHOLD, Workspace
from vb_robot.navigation_parameters import PATH_MARGIN
from vb_robot.poses import Pose, look_ahead

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
        self._enclosed: Optional[bool] = None  # whether the newest map put a border where it is; None: not yet known
        self._idle_since = self._retry_at = -math.inf
        self.failed = ""
        self._end()

    def _end(self) -> None:
        self._planner: Optional[ExitPlanner] = None
        self._route: Optional[np.ndarray] = None
        self.pause()

    def set_maps(self, workspace: Workspace) -> None:
        """Stores new maps."""
        self._workspace, self._enclosed, self._retry_at, self.failed = workspace, None, -math.inf, ""
        self._end()

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
        under_way = self._planner is not None
        if self._enclosed is None:
            self._enclosed = self._exit_borders and to_border < 0.0 and workspace.is_lethal(pose[:2])
        if self._enclosed:
            needed = self._enclosed = to_border < 0.0 or (under_way and to_blocked < MARGIN)
        elif under_way:
            needed = goal and to_blocked < MARGIN
        else:
            needed = -self._radius < to_blocked < PATH_MARGIN + 0.02 and 0.0 <= now - self._idle_since >= PINCHED_AFTER
        if not needed or not calm or 0.0 <= self._retry_at - now <= RETRY_DELAY:
            self._end()
            return None
        if self._planner is None:
            self._planner, self.failed = ExitPlanner(workspace, self._radius, pose[:2]), ""
        if self._route is None or float(np.linalg.norm(self._route - pose[:2], axis=1).min()) > MAX_PATH_DEVIATION:
            self._route = self._planner.plan_path(pose[:2])
            self.pause()
        if self._route is None:
            return self._give_up(now, "no_exit_path")
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
