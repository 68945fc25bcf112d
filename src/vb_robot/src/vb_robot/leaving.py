"""The way out of a border that was put where the robot stands, and driving it.

Navigation plans nothing from inside an occupied area, so the robot is driven along the shortest way over floor
without physical obstacles to floor that is allowed.
"""
from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import Optional, Tuple

import cv2
import numpy as np

from vb_core import geometry
from vb_core.grid_map import GridMap
from vb_core.parameters import Parameters, param
from vb_robot.drive import FreeWay, Motion, SafeDrive
from vb_robot.safety import SafetyParams
from vb_robot.terrain import Terrain, TerrainParams, clearance_grid
from vb_robot.viewpoint import Pose
from vb_robot.workspace import HARD


@dataclass(frozen=True)
class LeaveParams(Parameters):
    """How the robot drives out."""

    max_speed: float = param(0.2, "m/s", above=0.0, high=0.2)
    max_turn: float = param(0.8, "rad/s", above=0.0, high=1.5)
    acceleration: float = param(0.4, "m/s^2", above=0.0, high=2.0)
    turn_acceleration: float = param(2.0, "rad/s^2", above=0.0, high=10.0)
    turn_gain: float = param(1.8, "1/s", above=0.0)
    drive_cone_deg: float = param(25.0, "deg", above=0.0, high=90.0, doc="off the way by this it only turns")
    lookahead: float = param(0.2, "m", above=0.0, high=1.0)
    off_way: float = param(0.15, "m", above=0.0, high=1.0, doc="farther off, the way is planned anew")
    margin: float = param(0.08, "m", low=0.0, high=0.5, doc="free is who keeps this beyond the radius")
    min_area: float = param(0.3, "m^2", low=0.0, doc="less room for the robot's middle is no allowed floor")
    patience: float = param(15.0, "s", above=0.0, doc="without progress, then it gives up")
    min_progress: float = param(0.05, "m", above=0.0, doc="less is no progress; a turn of 1 rad counts as 0.2 m")
    timeout: float = param(90.0, "s", above=0.0, doc="for the whole way")
    retry: float = param(20.0, "s", above=0.0, doc="after it gave up it tries again")


class WayOut:
    """Where allowed floor is, and the shortest way to it.

    Args:
        posterior, physical: maps of the same geometry.
        robot_radius: [m]
        map_margin: [m] beyond the radius, which the robot keeps from physical obstacles.
    """

    def __init__(
        self, posterior: GridMap, physical: GridMap, robot_radius: float, params: LeaveParams, map_margin: float = 0.05
    ) -> None:
        # whoever arrives within a few centimetres, or in the cell beside, is to be free
        room = params.margin + 0.03 + posterior.resolution
        # the robot cuts corners by some centimetres; only where there is no room for that it is to keep to the way
        self._terrains = [
            Terrain(physical, TerrainParams(robot_radius=robot_radius, margin=room, travel_margin=map_margin + spare,
                                            occupied_threshold=HARD))
            for spare in (0.08, 0.02)
        ]
        beyond = self._terrains[0].clearance
        clearance = clearance_grid((posterior.data >= HARD) | (posterior.data < 0), posterior.resolution)
        fits = ((clearance >= robot_radius + room) & (beyond >= robot_radius + room)).astype(np.uint8)
        _, labels, stats, _ = cv2.connectedComponentsWithStats(fits, connectivity=8)
        large = stats[:, cv2.CC_STAT_AREA] * posterior.resolution ** 2 >= params.min_area
        large[0] = False
        self._allowed = posterior.cell_to_world(np.argwhere(large[labels]))

    def route(self, place) -> Optional[np.ndarray]:
        """(N, 2) [m] the shortest way from a place (2,) [m] to allowed floor; None if none can be reached."""
        if not len(self._allowed):
            return None
        for terrain in self._terrains:
            ways = terrain.ways(place)
            # the grid of ways is coarser than the map's: within one of its cells the nearest place counts
            lengths = ways.lengths_to(self._allowed) + 0.01 * np.linalg.norm(self._allowed - np.asarray(place), axis=1)
            best = int(np.argmin(lengths))
            if np.isfinite(lengths[best]):
                return ways.route(self._allowed[best])
        return None


class Progress(enum.Enum):
    """How the leaving goes."""

    DRIVES = "drives"
    LOST_WAY = "lost way"  # a new route is needed
    GIVEN_UP = "given up"


class Leaving:
    """Drives one robot along ways out. It does not know when the robot is free: the caller ends it."""

    def __init__(self, params: LeaveParams, safety: SafetyParams) -> None:
        self._params = params
        self._drive = SafeDrive(params.acceleration, params.turn_acceleration, safety)
        self._route: Optional[np.ndarray] = None
        self._last: Optional[float] = None
        self._driven = 0.0  # [s]
        self._idle = 0.0  # [s] since the last progress
        self._progress_at: Optional[Pose] = None
        self.reason = ""

    def set_route(self, route: np.ndarray) -> None:
        """Takes a way (N, 2) [m], N >= 1, from about where the robot is."""
        self._route = np.asarray(route, dtype=float)

    def forget_route(self) -> None:
        """The maps have changed: a new way is needed."""
        self._route = None

    def pause(self) -> None:
        """Somebody else drives, or nobody may; this time does not count."""
        self._drive.reset()
        self._last = None
        self._idle = 0.0

    def step(self, now: float, pose: Optional[Pose], free_way: FreeWay) -> Tuple[Progress, Motion]:
        """What is to be done at a time [s]; the robot is driven on only with a pose."""
        dt = 0.0 if self._last is None else max(0.0, now - self._last)
        self._last = now
        # a gap of a whole second is a clock that jumped, or a process that slept
        self._driven += min(dt, 1.0)
        self._idle += min(dt, 1.0)
        if pose is not None and (self._progress_at is None or self._moved(pose) >= self._params.min_progress):
            self._progress_at, self._idle = pose, 0.0
        if self._driven > self._params.timeout or self._idle > self._params.patience:
            return Progress.GIVEN_UP, Motion(0.0, 0.0, self.reason or "it takes too long")
        if pose is None:
            motion = self._drive.brake(dt, "the robot is not localised")
        elif self._route is None:
            return Progress.LOST_WAY, self._drive.brake(dt, "")
        else:
            gaps = np.linalg.norm(self._route - pose[:2], axis=1)
            nearest = int(np.argmin(gaps))
            if gaps[nearest] > self._params.off_way:
                self._route = None
                return Progress.LOST_WAY, self._drive.brake(dt, "")
            motion = self._drive.step(dt, *self._wish(pose, nearest), free_way)
        self.reason = motion.reason
        return Progress.DRIVES, motion

    def _wish(self, pose: Pose, nearest: int) -> Tuple[float, float]:
        params, route = self._params, self._route
        assert route is not None
        rest = route[nearest:]
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(rest, axis=0), axis=1))])
        target = rest[min(int(np.searchsorted(along, params.lookahead)), len(rest) - 1)]
        remaining = float(along[-1]) + math.dist(rest[0], pose[:2])
        if math.dist(target, pose[:2]) < 0.015:
            return 0.0, 0.0
        bearing = geometry.wrap_angle(math.atan2(target[1] - pose[1], target[0] - pose[0]) - pose[2])
        share = max(0.0, 1.0 - abs(bearing) / math.radians(params.drive_cone_deg))
        v = min(params.max_speed, 0.8 * remaining + 0.03) * share
        return v, min(max(params.turn_gain * bearing, -params.max_turn), params.max_turn)

    def _moved(self, pose: Pose) -> float:
        before = self._progress_at
        assert before is not None
        return math.dist(pose[:2], before[:2]) + 0.2 * abs(geometry.wrap_angle(pose[2] - before[2]))
