"""Poses from which a robot's own camera sees the spot (paper, Sect. 4.2: a robot is sent to the area)."""
from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import List, Optional, Tuple

import cv2
import numpy as np

from vb_core import geometry
from vb_core.parameters import Parameters, param
from vb_robot.keep_out import KeepOut, expected_area
from vb_robot.terrain import Terrain, Ways, clearance_grid, sample
from vb_robot.view import FloorView, to_base

Pose = Tuple[float, float, float]


@dataclass(frozen=True)
class ViewpointParams(Parameters):
    """Which places are looked at, and what makes one better than another. Costs are metres of way."""

    min_distance: float = param(0.8, "m", above=0.0, high=5.0, doc="from base_link to the spot")
    max_distance: float = param(1.5, "m", above=0.0, high=5.0)
    best_distance: float = param(1.1, "m", above=0.0, high=5.0)
    distances: int = param(4, low=1, high=20)
    bearings: int = param(36, low=4, high=360)
    image_margin: float = param(0.15, low=0.0, high=0.45, doc="how far from the image's edges the spot must lie")
    chain_margin: float = param(0.10, "m", low=0.0, high=1.0, doc="beyond the radius, from the line being drawn")
    ahead: float = param(0.8, "m", low=0.0, high=3.0, doc="how far the line is thought on")
    turn_cost: float = param(0.4, "m/rad", low=0.0, doc="of the turns before and after the way")
    distance_cost: float = param(0.5, "m/m", low=0.0)
    enclosed_cost: float = param(3.0, "m", low=0.0, doc="for standing inside what the line encloses")
    unseen_ahead_cost: float = param(0.5, "m", low=0.0, doc="for not seeing where the line goes on")
    min_line: float = param(0.3, "m", low=0.0, doc="ways keep off a line that extends over this or more")
    ways_checked: int = param(40, low=1, doc="of how many of the best poses the ways are looked at")


_SPOT_MARGIN = 0.06  # fraction of the image that must lie beyond a spot which is not what is looked at

NO_STRETCH = np.zeros((0, 2))

MAX_SAFE = 6  # one more than are tried in a row before a pause


@dataclass(frozen=True)
class Viewpoint:
    """A pose (map frame) [m, m, rad], the way's length [m], the cost [m], and the spot it was chosen for [m].

    Attributes:
        sees_spot: False for a place that only leaves the side to be restricted.
        turns_only: it is where the robot stood when it was chosen.
        risky: the way leads through what is being drawn, and was chosen all the same.
    """

    x: float
    y: float
    yaw: float
    way: float
    cost: float
    spot: Tuple[float, float]
    sees_spot: bool = True
    risky: bool = False
    turns_only: bool = False

    @property
    def pose(self) -> Pose:
        return self.x, self.y, self.yaw

    def pose_from(self, here: Optional[Pose]) -> Pose:
        """Where a robot that is `here` by now is to be sent.

        Choosing takes a moment. A robot that drove on meanwhile is not to come back only to turn at the same place.
        """
        if not self.turns_only or here is None:
            return self.pose
        return here[0], here[1], math.atan2(self.spot[1] - here[1], self.spot[0] - here[0])


@dataclass(frozen=True)
class Drawing:
    """What is being drawn, map frame.

    Attributes:
        spot: (2,) [m] where the spot is.
        chain: (M, 2) [m] what has been drawn.
        direction: (2,) unit vector along which the spot moves, or None.
        closed: whether the chain is a polygon.
        seeding: the spot marks the side to be restricted: stay off that side.
        ordered: whether the chain's points are in the order of the line.
        watched: a stationary camera sees the spot, so that there is no need for a robot to take risks.
        focus: (2,) [m] what the robot is to look at, for instance where the spot will leave the stationary cameras'
            sight. None: the spot.
        stretch: (K, 2) [m] what it is to see if it can: where the line probably goes on while no stationary camera sees
            it. It leads past the focus; the part up to there it must see.
    """

    spot: np.ndarray
    chain: np.ndarray
    direction: Optional[np.ndarray] = None
    closed: bool = False
    seeding: bool = False
    ordered: bool = True
    watched: bool = False
    focus: Optional[np.ndarray] = None
    stretch: np.ndarray = field(default_factory=lambda: NO_STRETCH)

    @property
    def must_see(self) -> np.ndarray:
        """(K, 2) [m] without which a pose is none; a spot that no stationary camera sees is among them."""
        wanted = [self.look_at, *self.stretch[:1]]
        return np.array(wanted if self.watched else [*wanted, np.asarray(self.spot, dtype=float)])

    @property
    def look_at(self) -> np.ndarray:
        """(2,) [m] what the robot is to look at."""
        return np.asarray(self.spot if self.focus is None else self.focus, dtype=float)

    def line_ahead(self, length: float) -> np.ndarray:
        """(K, 2) [m] where the line goes on, as far as what is looked at; the spot alone if it does not move."""
        spot = np.asarray(self.spot, dtype=float)
        if self.focus is not None and self.direction is not None:
            length = max(length, float(np.dot(self.look_at - spot, self.direction)))
        if self.direction is None or length <= 0:
            return spot[None]
        return spot + np.linspace(0.0, length, 6)[:, None] * self.direction


def rank_viewpoints(
    terrain: Terrain, view: FloorView, robot: Pose, drawing: Drawing, params: ViewpointParams, others=()
) -> List[Viewpoint]:
    """The poses that show what is to be looked at and that the robot can reach, the best first.

    Each is clear of obstacles and borders by radius and margin, off the line drawn and the line ahead,
    faces what is looked at from a distance within the limits, has a free line of sight and a way that leads there.
    What it must see lies in the image too. Where the robot stands counts if it only has to turn.
    While the seed is being shown, poses on its side are left out: the border to come would lock the robot in.
    If none is left then and the robot itself stands on that side, the nearest place off it is given.

    Args:
        others: (K, 2) [m] where other robots stand or drive to.
    """
    spot, look_at = np.asarray(drawing.spot, dtype=float), drawing.look_at
    others = np.asarray(others, dtype=float).reshape(-1, 2)
    places, yaw, distance = _poses_round(look_at, robot, params)
    keep = view.sees(np.column_stack([distance, np.zeros_like(distance)]), params.image_margin)
    keep &= terrain.stands_free(places)
    keep &= off_the_line(terrain, places, drawing, params)
    if len(others):
        apart = 2.0 * terrain.params.robot_radius + terrain.params.margin
        keep &= np.linalg.norm(places[:, None] - others[None], axis=2).min(axis=1) >= apart
    if drawing.focus is not None:
        from_each = np.vstack([to_base(drawing.must_see, (*place, angle)) for place, angle in zip(places, yaw)])
        keep &= view.sees(from_each, _SPOT_MARGIN).reshape(len(places), -1).all(axis=1)
    side = terrain.side_of(spot, drawing.chain, drawing.closed) if drawing.seeding else None
    off_side = _clear_of(terrain, side)
    if off_side is not None:
        keep &= sample(terrain.grid, off_side, places) > 0
    places, yaw, distance = places[keep], yaw[keep], distance[keep]
    seen = terrain.line_of_sight(places, look_at)
    places, yaw, distance = places[seen], yaw[seen], distance[seen]

    ways = terrain.ways(robot[:2], others)
    way = ways.lengths_to(places)
    at_home = np.linalg.norm(places - robot[:2], axis=1) < 1e-6
    way[at_home] = 0.0
    reachable = np.isfinite(way)
    places, yaw, distance, way = places[reachable], yaw[reachable], distance[reachable], way[reachable]
    if not len(places):
        return _retreat(terrain, ways, robot, off_side, spot)

    turn = np.array([_turns(robot, place, angle) for place, angle in zip(places, yaw)])
    cost = way + params.turn_cost * turn + params.distance_cost * np.abs(distance - params.best_distance)
    cost = cost + params.enclosed_cost * _enclosed(places, drawing)
    ahead = np.vstack([drawing.line_ahead(params.ahead), drawing.stretch])
    if len(ahead) > 1:
        # one call for all places: each costs as much as its overhead
        from_each = np.vstack([to_base(ahead, (*place, angle)) for place, angle in zip(places, yaw)])
        cost = cost + params.unseen_ahead_cost * (1.0 - view.sees(from_each).reshape(len(places), -1).mean(axis=1))
    order = np.argsort(cost, kind="stable")
    found = [
        Viewpoint(float(places[i, 0]), float(places[i, 1]), geometry.wrap_angle(float(yaw[i])), float(way[i]),
                  float(cost[i]), (float(look_at[0]), float(look_at[1])),
                  turns_only=bool(np.linalg.norm(places[i] - robot[:2]) < 1e-6))
        for i in order
    ]
    area = expected_area(terrain, drawing, params.min_line)
    if area is None:
        return found
    keep_out = KeepOut(terrain, area)
    safe: List[Viewpoint] = []
    near = keep_out.near_ways(robot[:2], places[order], way[order])
    for viewpoint in [found[i] for i in np.flatnonzero(near)[: params.ways_checked]]:
        if keep_out.allows(ways.route((viewpoint.x, viewpoint.y))):
            safe.append(viewpoint)
        if len(safe) == MAX_SAFE:
            break
    if safe:
        return safe
    retreat = _retreat(terrain, ways, robot, off_side, spot)
    if retreat or drawing.watched:
        return retreat
    return [replace(viewpoint, risky=True) for viewpoint in found]


def _poses_round(
    look_at: np.ndarray, robot: Pose, params: ViewpointParams
) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places (N, 2) [m], yaws (N,) [rad], distances (N,) [m] of poses that face a point; the robot's place too."""
    own = look_at - robot[:2]
    home = float(np.hypot(*own)), math.atan2(own[1], own[0])
    distance = np.linspace(params.min_distance, max(params.min_distance, params.max_distance), params.distances)
    # from the robot's own bearing on, so that a robot that only has to come nearer need not go round
    yaw = np.arange(params.bearings) * (2.0 * math.pi / params.bearings) + home[1]
    distance, yaw = (values.ravel() for values in np.meshgrid(distance, yaw))
    if 0.8 * params.min_distance <= home[0] <= 1.3 * params.max_distance:
        # to turn is quicker than to drive to a place that is a little better
        distance, yaw = np.append(distance, home[0]), np.append(yaw, home[1])
    return look_at - distance[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)]), yaw, distance


def _turns(robot: Pose, place: np.ndarray, yaw: float) -> float:
    """[rad] that a robot turns in all: towards the place, and there to a yaw."""
    way = place - robot[:2]
    if float(np.hypot(*way)) < 0.1:
        return abs(geometry.wrap_angle(yaw - robot[2]))
    heading = math.atan2(way[1], way[0])
    return abs(geometry.wrap_angle(heading - robot[2])) + abs(geometry.wrap_angle(yaw - heading))


def keeps_off(terrain: Terrain, robot: Pose, goal: Pose, drawing: Drawing, params: ViewpointParams) -> bool:
    """Whether the robot's way to a goal keeps off what is being drawn; also true if there is no way at all."""
    area = expected_area(terrain, drawing, params.min_line)
    if area is None:
        return True
    route = terrain.ways(robot[:2]).route(goal[:2])
    return route is None or KeepOut(terrain, area).allows(route)


def shows_spot(
    terrain: Terrain, view: FloorView, pose: Pose, drawing: Drawing, params: ViewpointParams, image_margin: float = 0.06
) -> bool:
    """Whether a robot at a pose would see well enough what it is to look at: a laxer test than the one for new poses.

    While the seed is being shown, no pose on its side is good enough.
    """
    place = np.array([pose[:2]])
    side = terrain.side_of(drawing.spot, drawing.chain, drawing.closed) if drawing.seeding else None
    off_side = _clear_of(terrain, side)
    if off_side is not None and not sample(terrain.grid, off_side, place)[0] > 0:
        return False
    look_at = drawing.look_at
    wanted = drawing.must_see
    if float(np.linalg.norm(wanted - place[0], axis=1).min()) < 0.6 * params.min_distance:
        return False
    if not view.sees(to_base(wanted, pose), image_margin).all():
        return False
    return bool(off_the_line(terrain, place, drawing, params)[0] and terrain.line_of_sight(place, look_at)[0])


def off_the_line(terrain: Terrain, places: np.ndarray, drawing: Drawing, params: ViewpointParams) -> np.ndarray:
    """(N,) bool: which places (N, 2) [m] keep clear of the line drawn so far and of where it goes on."""
    lines = [drawing.line_ahead(params.ahead)]
    if len(drawing.chain):
        chain = np.asarray(drawing.chain, dtype=float)
        lines.append(geometry.resample_chain(chain, 0.1, drawing.closed) if len(chain) > 1 else chain)
    points = np.vstack(lines)
    gaps = np.linalg.norm(places[:, None, :] - points[None, :, :], axis=2).min(axis=1)
    return gaps >= terrain.params.robot_radius + params.chain_margin


def _enclosed(places: np.ndarray, drawing: Drawing) -> np.ndarray:
    """(N,) 1.0 where a place lies within the convex hull of what has been drawn, else 0.0."""
    points = np.vstack([np.asarray(drawing.chain, dtype=float).reshape(-1, 2), np.asarray(drawing.spot)[None]])
    if len(points) < 3:
        return np.zeros(len(places))
    hull = cv2.convexHull(points.astype(np.float32))
    return np.array([float(cv2.pointPolygonTest(hull, (float(x), float(y)), False) >= 0) for x, y in places])


def _clear_of(terrain: Terrain, side: Optional[np.ndarray]) -> Optional[np.ndarray]:
    """(H, W) bool: where the robot with its margin keeps off a side (H, W); None if there is no side."""
    if side is None:
        return None
    gap = clearance_grid(side, terrain.grid.resolution)
    return gap >= terrain.params.robot_radius + terrain.params.margin


def _retreat(
    terrain: Terrain, ways: Ways, robot: Pose, off_side: Optional[np.ndarray], spot: np.ndarray
) -> List[Viewpoint]:
    """The nearest place off the side to be restricted, if the robot stands on it; else nothing."""
    if off_side is None or sample(terrain.grid, off_side, np.array([robot[:2]]))[0] > 0:
        return []
    cells = np.argwhere(off_side & (terrain.clearance >= terrain.params.robot_radius + terrain.params.margin))
    if not len(cells):
        return []
    places = terrain.grid.cell_to_world(cells)
    way = ways.lengths_to(places)
    best = int(np.argmin(way))
    if not np.isfinite(way[best]):
        return []
    x, y = (float(value) for value in places[best])
    yaw = math.atan2(spot[1] - y, spot[0] - x)
    return [Viewpoint(x, y, yaw, float(way[best]), float(way[best]), (float(spot[0]), float(spot[1])), sees_spot=False)]
