"""Plans poses from which a robot's own camera sees the spot (paper, Sect. 4.2: a robot is sent to the area).

One test decides whether the camera sees its target from a pose, be it the robot's pose, its goal or a candidate.
Candidates need a larger margin; the planner chooses the one of least cost in metres of path.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Iterable, Optional, Tuple

import numpy as np

from vb_core import geometry
from vb_core.grid_layers import clearance_grid, sample
from vb_core.geometry import Pose
from vb_robot.clearance_map import STOP_MARGIN, ClearanceMap
from vb_robot.dispatching.drawing_state import DrawingState
from vb_robot.dispatching.floor_view import FloorView

# [m] to the point that the camera looks at: nearer, it leaves the image; farther, the spot is too small
MIN_DISTANCE, MAX_DISTANCE = (0.8, 1.5)
BEST_DISTANCE = 1.1  # [m]
DISTANCES, BEARINGS = 4, 36  # numbers of candidates
IMAGE_MARGIN = 0.15  # least fraction of the image between its edge and the point that a new pose looks at ...
SEEN_MARGIN = 0.06  # ... and everything that any pose must see
LINE_MARGIN = 0.10  # [m] distance beyond the radius from the line being drawn and its extrapolation
# Costs of a pose, in metres of path: turns (their time at 0.5 m/s), deviation from the best distance, the unseen part
# of the extrapolated line, and the expected area: once if the path crosses it, and again if the pose is on it.
TURN_COST, DISTANCE_COST, UNSEEN_COST, LOCKED_COST = 0.4, 0.5, 0.5, 5.0


@dataclass(frozen=True)
class Viewpoint:
    """A pose, and its cost [m]. `sees_spot` is False for a pose that only leaves the side to be restricted."""

    pose: Pose
    cost: float
    sees_spot: bool = True


class ViewpointPlanner:
    """Computes what one robot can see of a drawing from its own pose and from others.

    Args:
        others: (K, 2) [m] positions of other robots.
    """

    def __init__(
        self, clearance_map: ClearanceMap, view: FloorView, drawing: DrawingState, others: Iterable = ()
    ) -> None:
        self.clearance_map, self.view, self.drawing = clearance_map, view, drawing
        self._others = np.asarray(list(others), dtype=float).reshape(-1, 2)
        self._ahead = drawing.line_ahead(clearance_map)
        self.look_at = drawing.look_at(self._ahead)
        area = drawing.expected_area(clearance_map)
        # the future border would lock a robot in, so it neither stands in the border's area nor drives through it
        distances = None if area is None else clearance_grid(area, clearance_map.grid.resolution)
        self._outside = None if distances is None else distances >= clearance_map.radius + STOP_MARGIN
        self._in_contact = None if distances is None else distances < clearance_map.radius
        drawn = geometry.resample_chain(drawing.chain, 0.1, drawing.closed) if len(drawing.chain) > 1 else drawing.chain
        self._line = np.vstack([self._ahead, drawn])

    def shows_target(self, pose: Pose) -> bool:
        """Returns whether a robot at this pose would see its target well enough."""
        return bool(self._show_target(np.array([pose[:2]]), np.array([pose[2]]))[0])

    def has_room_at(self, pose: Pose) -> bool:
        """Returns whether the robot still fits at a goal."""
        return bool(self.clearance_map.has_room_at(np.array([pose[:2]]))[0])

    def best_viewpoint(self, robot: Pose, avoid: Iterable[Tuple[float, float, float]] = ()) -> Optional[Viewpoint]:
        """Finds the reachable pose of least cost that shows the target; None if there is none.

        The pose keeps radius and margin from obstacles and borders, is off the drawn line and its extrapolation, and
        never on the side that the seed marks. If possible, pose and path avoid the area that the border will probably
        restrict. The robot's own position is a candidate too, for which the robot only turns. If no pose shows the
        target and the robot is on the seed's side, returns the nearest pose off that side.

        Args:
            avoid: circles (x, y, radius) [m] around positions that failed.
        """
        positions, yaws, distances = _make_candidates(self.look_at, robot)
        keep = self.view.sees(np.column_stack([distances, np.zeros_like(distances)]), IMAGE_MARGIN)
        keep &= self.clearance_map.has_room_at(positions)
        robot_spacing = 2.0 * self.clearance_map.radius + STOP_MARGIN
        for x, y, radius in [*((*other, robot_spacing) for other in self._others), *avoid]:
            keep &= np.hypot(positions[:, 0] - x, positions[:, 1] - y) >= radius
        keep[keep] = self._show_target(positions[keep], yaws[keep])
        positions, yaws, distances = positions[keep], yaws[keep], distances[keep]
        if not len(positions):
            return self._retreat(robot)
        offsets = positions - robot[:2]
        drive_distances = np.hypot(*offsets.T)
        path_lengths = self.clearance_map.path_lengths(robot[:2], positions, self._others)
        crossing = self._crosses_area(robot, positions, path_lengths)
        path_lengths[drive_distances < 1e-6] = 0.0
        # the robot turns towards the position and then to the yaw, or only to the yaw if it is there already
        headings = np.where(drive_distances < 0.1, robot[2], np.arctan2(offsets[:, 1], offsets[:, 0]))
        turns = np.abs([np.arctan2(np.sin(turn), np.cos(turn)) for turn in (headings - robot[2], yaws - headings)])
        cost = path_lengths + TURN_COST * turns.sum(axis=0) + DISTANCE_COST * np.abs(distances - BEST_DISTANCE)
        cost += UNSEEN_COST * (1.0 - self._sees(self._ahead, positions, yaws).mean(axis=1))
        # while the seed is shown, the border may be saved at any moment, so a robot that is not needed waits
        waits = self.drawing.seeding and self.drawing.seen_by_stationary
        cost += np.where(crossing, np.inf if waits else LOCKED_COST, 0.0) + LOCKED_COST * ~self._is_outside(positions)
        best = int(np.argmin(cost))
        if not np.isfinite(cost[best]):
            return self._retreat(robot)
        return Viewpoint((*positions[best].tolist(), geometry.wrap_angle(float(yaws[best]))), float(cost[best]))

    def _crosses_area(self, robot: Pose, positions: np.ndarray, path_lengths: np.ndarray) -> np.ndarray:
        """Returns (N,) bool: whether the shortest paths, of these lengths [m], cross the expected area.

        Navigation does not know the border being drawn yet. A robot inside the area has to leave it in any case.
        """
        touching_cells, grid = self._in_contact, self.clearance_map.grid
        if touching_cells is None or sample(grid, touching_cells, np.array([robot[:2]]), outside=0.0)[0]:
            return np.zeros(len(positions), dtype=bool)
        return self.clearance_map.path_lengths(robot[:2], positions, self._others, touching_cells) > path_lengths + 1e-6

    # ------------------------------------------------------------- one test for all poses
    def _show_target(self, positions: np.ndarray, yaws: np.ndarray) -> np.ndarray:
        """Returns (N,) bool: which poses see their target, and are off the line and the seed's side."""
        drawing = self.drawing
        required = [self.look_at] if drawing.seen_by_stationary else [self.look_at, drawing.spot]
        keep = self._sees(np.array(required), positions, yaws, SEEN_MARGIN).all(axis=1)
        line_distances = np.linalg.norm(positions[:, None, :] - self._line[None, :, :], axis=2).min(axis=1)
        keep &= line_distances >= self.clearance_map.radius + LINE_MARGIN
        if drawing.seeding:
            keep &= self._is_outside(positions)
        keep[keep] = self.clearance_map.line_of_sight(positions[keep], self.look_at)
        return keep

    def _is_outside(self, positions: np.ndarray) -> np.ndarray:
        """Returns (N,) bool: which positions (N, 2) [m] the border will probably not restrict."""
        if self._outside is None:
            return np.ones(len(positions), dtype=bool)
        return sample(self.clearance_map.grid, self._outside, positions, outside=1.0) > 0

    def _sees(self, points: np.ndarray, positions: np.ndarray, yaws: np.ndarray, margin: float = 0.0) -> np.ndarray:
        """Returns (N, K) bool: which points (K, 2) [m] are in the image from each pose."""
        ahead = np.column_stack([np.cos(yaws), np.sin(yaws)])
        left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
        offsets = points[None, :, :] - positions[:, None, :]
        in_base = np.stack([(offsets * axis[:, None, :]).sum(axis=2) for axis in (ahead, left)], axis=2)
        return self.view.sees(in_base.reshape(-1, 2), margin).reshape(len(positions), len(points))

    def _retreat(self, robot: Pose) -> Optional[Viewpoint]:
        """Returns the nearest pose off the side that the seed marks, if the robot is on it."""
        clearance_map, spot = self.clearance_map, self.drawing.spot
        if not self.drawing.seeding or self._is_outside(np.array([robot[:2]]))[0]:
            return None
        cells = np.argwhere(self._outside & (clearance_map.clearance >= clearance_map.radius + STOP_MARGIN))
        positions = clearance_map.grid.cell_to_world(cells)
        path_lengths = clearance_map.path_lengths(robot[:2], positions, self._others)
        if not np.isfinite(path_lengths).any():
            return None
        nearest = int(np.argmin(path_lengths))
        yaw = math.atan2(*(spot - positions[nearest])[::-1])
        return Viewpoint((*positions[nearest].tolist(), yaw), float(path_lengths[nearest]), sees_spot=False)


def _make_candidates(look_at: np.ndarray, robot: Pose) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns poses that face a point: positions (N, 2) [m], yaws (N,) [rad], distances (N,) [m] from the point."""
    to_target = look_at - robot[:2]
    own = float(np.hypot(*to_target)), math.atan2(to_target[1], to_target[0])
    # bearings start at the robot's own, so that a robot that only has to come nearer need not drive round the point
    yaw = np.arange(BEARINGS) * (2.0 * math.pi / BEARINGS) + own[1]
    distance, yaw = (values.ravel() for values in np.meshgrid(np.linspace(MIN_DISTANCE, MAX_DISTANCE, DISTANCES), yaw))
    if 0.8 * MIN_DISTANCE <= own[0] <= 1.3 * MAX_DISTANCE:
        # turning takes less time than driving to a slightly better position
        distance, yaw = np.append(distance, own[0]), np.append(yaw, own[1])
    return look_at - distance[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)]), yaw, distance
