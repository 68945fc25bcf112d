"""Poses from which a robot's own camera sees the spot (paper, Sect. 4.2: a robot is sent to the area).

The idea: one test says whether a pose shows what the camera has to see, for the robot's pose, its goal and every
candidate alike; candidates need some more margin. Those that pass are sorted by their cost in metres of
path, and their paths are checked in that order until one avoids what is being drawn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import compress, islice
from typing import Iterable, List, Optional, Tuple

import numpy as np

from vb_core import geometry
from vb_core.grid_layers import clearance_grid, sample
from vb_core.poses import Pose
from vb_robot.clearance_map import STOP_MARGIN, ClearanceMap, ShortestPaths
from vb_robot.dispatching.drawing import STEP, DrawingState, KeepOutArea
from vb_robot.floor_view import FloorView

# [m] to what the camera looks at: nearer it leaves the image, farther it is small
MIN_DISTANCE, MAX_DISTANCE = (0.8, 1.5)
BEST_DISTANCE = 1.1  # [m]
DISTANCES, BEARINGS = 4, 36  # how many are checked
IMAGE_MARGIN = 0.15  # fraction of the image that must be beyond what a new pose looks at ...
SEEN_MARGIN = 0.06  # ... and beyond all that any pose must see
LINE_MARGIN = 0.10  # [m] beyond the radius, from the line being drawn and from where it goes on
LINE_AHEAD = 0.8  # [m] how far the line is extrapolated
# What makes a place worse, in metres of path: turns (their time at 0.5 m/s), not being at the best distance, not seeing
# where the line goes on.
TURN_COST, DISTANCE_COST, UNSEEN_COST = 0.4, 0.5, 0.5
PATHS_CHECKED = 10  # the cheapest first; each costs about 3 ms


@dataclass(frozen=True)
class Viewpoint:
    """A pose, what it costs [m], and the place (x, y) [m] that it was chosen to show.

    Attributes:
        sees_spot: False for a place that only leaves the side to be restricted.
        risky: the path leads through what is being drawn, and was chosen all the same.
    """

    pose: Pose
    cost: float
    spot: Tuple[float, float]
    sees_spot: bool = True
    risky: bool = False


class ViewpointPlanner:
    """Computes what one robot can see of a drawing, from where it is and from where it could go.

    Args:
        others: (K, 2) [m] where other robots are or drive to.
    """

    def __init__(
        self, clearance_map: ClearanceMap, view: FloorView, drawing: DrawingState, others: Iterable = ()
    ) -> None:
        self.clearance_map, self.view, self.drawing = clearance_map, view, drawing
        self._others = np.asarray(list(others), dtype=float).reshape(-1, 2)
        side = clearance_map.side_of(drawing.spot, drawing.chain, drawing.closed) if drawing.seeding else None
        # while the seed is shown its side is left: the border to come would lock the robot in
        self._off_side = (
            None
            if side is None
            else (clearance_grid(side, clearance_map.grid.resolution) >= clearance_map.radius + STOP_MARGIN)
        )
        lines = [drawing.line_ahead(LINE_AHEAD)]
        if len(drawing.chain):
            lines.append(
                geometry.resample_chain(drawing.chain, 0.1, drawing.closed) if len(drawing.chain) > 1 else drawing.chain
            )
        self._line = np.vstack(lines)

    def shows_target(self, pose: Pose) -> bool:
        """Returns whether a robot at a pose would see its target well enough."""
        return bool(self._shows(np.array([pose[:2]]), np.array([pose[2]]))[0])

    def visible_length(self, pose: Pose) -> float:
        """Measures how much [m] of the line ahead, from where the spot was seen last, is in view from a pose."""
        stretch = self.drawing.stretch
        seen = self._seen(stretch, np.array([pose[:2]]), np.array([pose[2]]))[0] if len(stretch) else np.zeros(0, bool)
        return STEP * float(np.flatnonzero(seen)[-1]) if seen.any() else 0.0

    def has_room_at(self, pose: Pose) -> bool:
        """Returns whether there still is room for the robot at a goal."""
        return bool(self.clearance_map.has_room_at(np.array([pose[:2]]))[0])

    def avoids_drawing(self, robot: Pose, goal: Pose) -> bool:
        """Returns whether the robot's path to a goal avoids what is being drawn; also true if there is no path at all."""
        area = self.drawing.expected_area(self.clearance_map)
        if area is None:
            return True
        route = self.clearance_map.shortest_paths(robot[:2]).path_to(goal[:2])
        return route is None or KeepOutArea(self.clearance_map, area).allows(route)

    def best_viewpoint(self, robot: Pose, avoid: Iterable[Tuple[float, float, float]] = ()) -> Optional[Viewpoint]:
        """Finds the cheapest reachable pose that shows the target; None if there is none.

        It is clear of obstacles and borders by radius and margin, off the line drawn and the line ahead, and has a path
        that avoids what is being drawn. The robot's own place counts if it only has to turn. If there is no such
        pose and the robot itself is on the side that the seed marks, the nearest place off it. If there is none at
        all, and no camera sees the spot, also one whose path leads through what is being drawn.

        Args:
            avoid: (x, y, radius) [m]: places that failed.
        """
        paths = self.clearance_map.shortest_paths(robot[:2], self._others)
        found = self._in_order(robot, paths, avoid)
        area = self.drawing.expected_area(self.clearance_map) if found else None
        if area is None:
            return found[0] if found else self._retreat(paths, robot)
        keep_out = KeepOutArea(self.clearance_map, area)
        outside = compress(found, keep_out.allows_ends(np.array([place.pose[:2] for place in found])))
        for place in islice(outside, PATHS_CHECKED):
            if keep_out.allows(paths.path_to(place.pose[:2])):
                return place
        retreat = self._retreat(paths, robot)
        return retreat if retreat is not None or self.drawing.seen_by_stationary else replace(found[0], risky=True)

    # ------------------------------------------------------------- one test for all poses
    def _shows(self, places: np.ndarray, yaws: np.ndarray) -> np.ndarray:
        """Returns (N,) bool: which poses show what must be seen, off the line and off the seed's side."""
        keep = self._seen(self.drawing.required_points, places, yaws, SEEN_MARGIN).all(axis=1)
        gaps = np.linalg.norm(places[:, None, :] - self._line[None, :, :], axis=2).min(axis=1)
        keep &= gaps >= self.clearance_map.radius + LINE_MARGIN
        if self._off_side is not None:
            keep &= sample(self.clearance_map.grid, self._off_side, places) > 0
        keep[keep] = self.clearance_map.line_of_sight(places[keep], self.drawing.look_at)
        return keep

    def _seen(self, points: np.ndarray, places: np.ndarray, yaws: np.ndarray, margin: float = 0.0) -> np.ndarray:
        """Returns (N, K) bool: which points (K, 2) [m] are in the image from each pose."""
        ahead = np.column_stack([np.cos(yaws), np.sin(yaws)])
        left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
        offsets = points[None, :, :] - places[:, None, :]
        in_base = np.stack([(offsets * axis[:, None, :]).sum(axis=2) for axis in (ahead, left)], axis=2)
        return self.view.sees(in_base.reshape(-1, 2), margin).reshape(len(places), len(points))

    # ------------------------------------------------------------- candidates
    def _in_order(self, robot: Pose, paths: ShortestPaths, avoid: Iterable) -> List[Viewpoint]:
        """Returns the reachable poses that show the target, the cheapest first."""
        look_at = self.drawing.look_at
        places, yaws, distances = _poses_round(look_at, robot)
        keep = self.view.sees(np.column_stack([distances, np.zeros_like(distances)]), IMAGE_MARGIN)
        keep &= self.clearance_map.has_room_at(places)
        apart = 2.0 * self.clearance_map.radius + STOP_MARGIN
        for x, y, radius in [*((*other, apart) for other in self._others), *avoid]:
            keep &= np.hypot(places[:, 0] - x, places[:, 1] - y) >= radius
        keep[keep] = self._shows(places[keep], yaws[keep])
        lengths = paths.lengths_to(places)
        lengths[np.linalg.norm(places - robot[:2], axis=1) < 1e-6] = 0.0
        keep &= np.isfinite(lengths)
        places, yaws, distances, lengths = (values[keep] for values in (places, yaws, distances, lengths))
        if not len(places):
            return []
        # the robot turns towards the place and there to the yaw, or only to the yaw if it is there already
        off = places - robot[:2]
        heading = np.where(np.hypot(*off.T) < 0.1, robot[2], np.arctan2(off[:, 1], off[:, 0]))
        turns = np.abs([np.arctan2(np.sin(turn), np.cos(turn)) for turn in (heading - robot[2], yaws - heading)])
        cost = lengths + TURN_COST * turns.sum(axis=0) + DISTANCE_COST * np.abs(distances - BEST_DISTANCE)
        ahead = np.vstack([self.drawing.line_ahead(LINE_AHEAD), self.drawing.stretch])
        if len(ahead) > 1:
            cost += UNSEEN_COST * (1.0 - self._seen(ahead, places, yaws).mean(axis=1))
        return [
            Viewpoint(
                (*places[i].tolist(), geometry.wrap_angle(float(yaws[i]))), float(cost[i]), tuple(look_at.tolist())
            )
            for i in np.argsort(cost, kind="stable")
        ]

    def _retreat(self, paths: ShortestPaths, robot: Pose) -> Optional[Viewpoint]:
        """Returns the nearest place off the side to be restricted, if the robot is on it."""
        clearance_map, spot = self.clearance_map, self.drawing.spot
        if self._off_side is None or sample(clearance_map.grid, self._off_side, np.array([robot[:2]]))[0] > 0:
            return None
        cells = np.argwhere(self._off_side & (clearance_map.clearance >= clearance_map.radius + STOP_MARGIN))
        places = clearance_map.grid.cell_to_world(cells)
        lengths = paths.lengths_to(places)
        if not np.isfinite(lengths).any():
            return None
        best = int(np.argmin(lengths))
        yaw = math.atan2(*(spot - places[best])[::-1])
        return Viewpoint((*places[best].tolist(), yaw), float(lengths[best]), tuple(spot.tolist()), sees_spot=False)


def _poses_round(look_at: np.ndarray, robot: Pose) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places (N, 2) [m], yaws (N,) [rad], distances (N,) [m] of poses that face a point; the robot's place too."""
    own = look_at - robot[:2]
    home = float(np.hypot(*own)), math.atan2(own[1], own[0])
    # from the robot's own bearing on, so that a robot that only has to come nearer need not go round
    yaw = np.arange(BEARINGS) * (2.0 * math.pi / BEARINGS) + home[1]
    distance, yaw = (values.ravel() for values in np.meshgrid(np.linspace(MIN_DISTANCE, MAX_DISTANCE, DISTANCES), yaw))
    if 0.8 * MIN_DISTANCE <= home[0] <= 1.3 * MAX_DISTANCE:
        # turning is quicker than driving to a slightly better place
        distance, yaw = np.append(distance, home[0]), np.append(yaw, home[1])
    return look_at - distance[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)]), yaw, distance
