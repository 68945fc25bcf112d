"""Measures distances to a map's walls, compares the walls of two maps, and finds the walls round a border in a new map.

The walls within some metres of a border decide where it is. They are searched for near the position where the map's
transform puts them. If they are found there and nowhere else, the border is there too. If their position is ambiguous
(along a straight wall, in an open hall), walls a little farther away are included. They may confirm that the border is
where it is expected. If the position stays ambiguous, a person has to confirm it.

Reach and limits were chosen on half of 28 maps that robots recorded, with parts displaced by half a metre;
docs/results/maps/README.md has the results on the other half and on further maps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core.grid_map import OCCUPIED_THRESHOLD, GridMap, Transform

# [m] a wall is found again if there is one this near: two cells of a usual map, and SLAM's distortion of a few cm
TOLERANCE = 0.12
# [m] connected obstacles that extend farther are walls, smaller ones furniture: a double bed's diagonal is 2.7 m
MIN_STRUCTURE_EXTENT = 3.0
# [m] gaps up to this in a wall do not split it: cells that the laser missed
_MAX_BRIDGED_GAP = 0.1
_UNKNOWN_RIM = 4  # unknown cells that are kept round the known part of a map
_DISTANCE_UNIT = 1e-4  # [m] unit of the stored distances to walls
_MAX_DISTANCE = 20_000  # [_DISTANCE_UNIT] the largest distance that is stored
_POINTS_AT_ONCE = 30_000  # points that OpenCV interpolates in one call
_DRAWN_FLOOR = 400_000  # points of free floor that are drawn for the coarse search

# damping per pair of x, y and yaw: the step stays short in a direction in which the walls decide nothing
_DAMPING = np.diag([0.002, 0.002, 0.004])
_MAX_STEP = np.array([0.3, 0.3, 0.05])  # [m], [m], [rad] the longest step of a refinement

WALL_RADIUS = 3.0  # [m] walls this near a border decide where it is; others may be distorted differently
WIDER_WALL_RADIUS = 4.5  # [m] the same, where those are ambiguous
_MAX_WALLS = 300  # wall cells that are compared: `count` of `subsample`
_MIN_WALLS = 10  # with fewer wall cells round it, a border cannot be located
# [m] from the expected position, in x and in y, at which walls are searched for
_SEARCH_STEPS = np.arange(-10, 11) * 0.1
_SEARCH_SHIFTS = np.stack(np.meshgrid(_SEARCH_STEPS, _SEARCH_STEPS), axis=-1).reshape(-1, 2)
_SEARCH_YAWS = np.radians([-8.0, -5.3, -2.7, 0.0, 2.7, 5.3, 8.0])  # [rad]
_REACHES = (0.6, 0.4, 0.3, 0.2, 0.15, 0.15)  # [m] `reaches` of `refine`
_SCORED_DISTANCE = 0.25  # [m] a wall cell this far from the new map's nearest wall scores 0
_MIN_SEPARATION = 0.35  # [m] positions farther apart than this count as different
_EIGHT_ANGLES = np.arange(8) * (np.pi / 4.0)  # [rad]
_SHIFTS_ASIDE = _MIN_SEPARATION * np.column_stack([np.cos(_EIGHT_ANGLES), np.sin(_EIGHT_ANGLES)])
_NO_SEARCH_SHARE = 0.97  # no search if this share of the walls is found again where expected, and clearly less nearby
_MIN_KNOWN = 0.5  # share of the walls that must be in the known part of the new map
# a position is accepted from these agreements (see `LocalFit.agreement`) and this margin on
_EXPECTED_DISTANCE = 0.15  # [m] a border found farther from where it is expected needs the higher values ..._ELSEWHERE
_MIN_HIGHER_AGREEMENT = 0.8
_MIN_LOWER_AGREEMENT = 0.5
_MIN_MARGIN = 0.05
_MIN_AGREEMENT_ELSEWHERE = 0.9
_MIN_MARGIN_ELSEWHERE = 0.1

# wall cells (N, 2) [m] of the old map, and (K, 2) of the new one, each in its map's frame
WallPair = Tuple[np.ndarray, np.ndarray]


class WallMap:
    """A map as registration uses it: its wall cells, which of them belong to long walls, and its distance field.

    Only the known part of the map is kept, so an empty canvas costs nothing.
    """

    def __init__(self, grid: GridMap) -> None:
        self.grid = _known_part(grid)
        cells = np.ascontiguousarray(self.grid.data)
        occupied = (cells >= OCCUPIED_THRESHOLD).astype(np.uint8)
        self.free = cv2.inRange(cells.view(np.uint8), 0, OCCUPIED_THRESHOLD - 1) & 1
        surface = occupied & cv2.dilate(self.free, np.ones((3, 3), np.uint8))
        rows, columns = np.nonzero(surface)
        self.walls = self.grid.grid_to_world(np.column_stack([columns, rows]).astype(float))
        bridge = 2 * max(1, int(round(_MAX_BRIDGED_GAP / self.grid.resolution))) - 1
        joined = cv2.dilate(occupied, np.ones((bridge, bridge), np.uint8))
        _, labels, stats, _ = cv2.connectedComponentsWithStats(joined, connectivity=8)
        extent = np.hypot(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT]) * self.grid.resolution
        extent[0] = 0.0
        self.is_structure = extent[labels[rows, columns]] >= MIN_STRUCTURE_EXTENT
        # the known part of the map: free floor, and the cells beside it
        self._known = cv2.dilate(self.free, np.ones((5, 5), np.uint8))
        # [_DISTANCE_UNIT] to the nearest wall: integers take half the memory
        self._distances = np.full(self.grid.shape, _MAX_DISTANCE, np.uint16)
        if len(self.walls):
            distances = cv2.distanceTransform(1 - surface, cv2.DIST_L2, 5)
            distances *= self.grid.resolution / _DISTANCE_UNIT
            distances += 0.5
            self._distances = np.minimum(distances, _MAX_DISTANCE, out=distances).astype(np.uint16)

    def look_up(self, points: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Returns distances (N,) [m] to the nearest wall, at most 2, and their gradients (N, 2) in the map frame."""
        if not len(points):
            return np.zeros(0), np.zeros((0, 2))
        positions = self.grid.world_to_grid(points).astype(np.float32)
        slopes = [
            (self._interpolate(positions + step) - self._interpolate(positions - step)) / (2.0 * self.grid.resolution)
            for step in np.eye(2, dtype=np.float32)
        ]
        gradients = np.column_stack(slopes) @ Transform(yaw=self.grid.origin[2]).rotation.T
        return self._interpolate(positions), gradients

    def _interpolate(self, positions: np.ndarray) -> np.ndarray:
        """Returns the distances (N,) [m] to the nearest wall at positions (N, 2) float32 (column, row)."""
        options = {"borderMode": cv2.BORDER_CONSTANT, "borderValue": _MAX_DISTANCE}
        distances = [
            cv2.remap(self._distances, part[:, :1], part[:, 1:], cv2.INTER_LINEAR, **options)[:, 0]
            for part in np.array_split(positions, 1 + len(positions) // _POINTS_AT_ONCE)
        ]
        return np.concatenate(distances).astype(float) * _DISTANCE_UNIT

    def distances(self, points: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Returns distances (N,) [m] from the cells of points (N, 2) to the nearest wall, and which are known."""
        cells = np.floor(self.grid.world_to_grid(points) + 0.5).astype(np.int32)
        is_inside = ((cells >= 0) & (cells < self.grid.shape[::-1])).all(axis=1)
        cells[~is_inside] = 0
        columns, rows = cells.T
        distances = self._distances[rows, columns] * np.float32(_DISTANCE_UNIT)
        is_known = is_inside & (self._known[rows, columns] != 0)
        return distances, is_known

    def is_known(self, points: np.ndarray) -> np.ndarray:
        """Returns (N,) bool: at which of the points (N, 2) [m] the map knows the floor, or the wall beside it."""
        return self.distances(points)[1]

    def walls_near(self, outline: np.ndarray, reach: float) -> np.ndarray:
        """Returns the wall cells (K, 2) [m] within a distance [m] of points (N, 2) [m]."""
        low = outline.min(axis=0) - reach
        high = outline.max(axis=0) + reach
        is_in_box = ((self.walls >= low) & (self.walls <= high)).all(axis=1)
        walls = self.walls[is_in_box]
        is_near = np.zeros(len(walls), bool)
        for point in subsample(outline, 50):
            is_near |= np.square(walls - point).sum(axis=1) <= reach * reach
        return walls[is_near]

    @cached_property
    def floor(self) -> np.ndarray:
        """Up to some thousand points (N, 2) [m] of free floor, spread evenly."""
        return self._some_floor(2000)[0]

    def _some_floor(self, count: int) -> Tuple[np.ndarray, int]:
        """Returns `count` to four times as many points (N, 2) [m] of free floor, spread evenly, and the cells per point."""
        step = max(1, int(math.sqrt(cv2.countNonZero(self.free) / count)))
        rows, columns = np.nonzero(self.free[step // 2 :: step, step // 2 :: step])
        positions = np.column_stack([columns, rows]) * step + step // 2
        return self.grid.grid_to_world(positions), step * step

    def draw_evidence(self, cell: float) -> np.ndarray:
        """Draws (n, n) float32 round the centre: positive at walls, slightly negative on free floor, 0 where unknown."""
        side = 2 * int(math.ceil(self.radius / cell)) + 5
        middle = side // 2

        def count(points: np.ndarray) -> np.ndarray:
            cells = np.floor((points - self.center) / cell + 0.5).astype(int) + middle
            columns, rows = cells.T
            return np.bincount(rows * side + columns, minlength=side * side).reshape(side, side)

        per_cell = max(1.0, cell / self.grid.resolution)  # wall cells that make a cell of the drawing a wall
        structure = np.minimum(1.0, count(self.walls[self.is_structure]) / per_cell)
        furniture = np.minimum(1.0, count(self.walls[~self.is_structure]) / per_cell)
        floor_points, cells_per_point = self._some_floor(_DRAWN_FLOOR)
        floor = np.minimum(1.0, count(floor_points) * cells_per_point / per_cell**2)
        walls = (structure + 0.3 * furniture).astype(np.float32)
        walls = cv2.GaussianBlur(walls, (0, 0), 1.0)
        is_wall = walls >= 0.1
        return (walls - 0.08 * floor * ~is_wall).astype(np.float32)

    @cached_property
    def center(self) -> np.ndarray:
        """The middle (2,) [m] of the known part of a map with walls."""
        points = np.concatenate([self.walls, self.floor])
        return (points.min(axis=0) + points.max(axis=0)) / 2.0

    @cached_property
    def radius(self) -> float:
        """The radius [m] round the centre that contains the known part."""
        points = np.concatenate([self.walls, self._some_floor(_DRAWN_FLOOR)[0]])
        return float(np.linalg.norm(points - self.center, axis=1).max())


def _known_part(grid: GridMap) -> GridMap:
    """Crops a map to its known part, and a few cells round it."""
    is_known = np.ascontiguousarray(grid.data).view(np.uint8) < 128
    rows = np.flatnonzero(is_known.any(axis=1))
    columns = np.flatnonzero(is_known.any(axis=0))
    if not len(rows):
        return grid
    top = max(0, rows[0] - _UNKNOWN_RIM)
    left = max(0, columns[0] - _UNKNOWN_RIM)
    bottom = rows[-1] + 1 + _UNKNOWN_RIM
    right = columns[-1] + 1 + _UNKNOWN_RIM
    cells = grid.data[top:bottom, left:right]
    x, y = grid.grid_to_world([[left - 0.5, top - 0.5]])[0]
    return GridMap(np.ascontiguousarray(cells), grid.resolution, (x, y, grid.origin[2]))


def subsample(points: np.ndarray, count: int) -> np.ndarray:
    """Thins points (N, 2) evenly to at least `count`, but fewer than twice as many."""
    return points[:: max(1, len(points) // count)]


def refine(
    old: WallMap, new: WallMap, start: Transform, walls: WallPair, center: np.ndarray, reaches: Sequence[float]
) -> Transform:
    """Refines a transform to the nearby one at which the walls of both maps coincide.

    In each iteration, d are the distances of one map's walls to the nearest walls of the other, J their derivatives by
    a motion (x, y, yaw) of the old map, and W Tukey's biweight, (1 - (d / reach)^2)^2, which leaves out pairs farther
    apart than `reach`. The transform is moved by the damped Gauss-Newton step -(J^T W J + N D)^-1 J^T W d.

    Args:
        walls: those of the old map and of the new one that are matched with the other map's.
        center: (2,) [m] centre of rotation in the old map, which keeps rotation and shift decoupled.
        reaches: [m] one value per iteration.
    """
    old_walls, new_walls = walls
    center_in_new = start.apply(center)[0]
    yaw = start.yaw
    for reach in reaches:
        rotation = Transform(yaw=yaw).rotation
        arms = (old_walls - center) @ rotation.T  # from the centre to each wall, in the new map's frame
        old_distances, gradients = new.look_up(center_in_new + arms)
        old_jacobian = np.column_stack([gradients, _cross_products(arms, gradients)])
        arms = (new_walls - center_in_new) @ rotation  # in the old map's frame, in which they move the other way
        new_distances, gradients = old.look_up(center + arms)
        new_jacobian = np.column_stack([-(gradients @ rotation.T), _cross_products(gradients, arms)])
        distances = np.concatenate([old_distances, new_distances])
        jacobian = np.concatenate([old_jacobian, new_jacobian])
        weights = np.square(np.maximum(0.0, 1.0 - np.square(distances / reach)))
        weighted = jacobian * weights[:, None]
        normal_matrix = weighted.T @ jacobian + len(distances) * _DAMPING
        step = np.clip(np.linalg.solve(normal_matrix, -weighted.T @ distances), -_MAX_STEP, _MAX_STEP)
        center_in_new = center_in_new + step[:2]
        yaw += float(step[2])
    return Transform.rotation_about(center, center_in_new, yaw)


def _cross_products(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Computes the cross products (N,) of vectors (N, 2)."""
    return first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]


def compare_walls(walls: np.ndarray, other: WallMap) -> Tuple[float, float]:
    """Compares wall cells (N, 2) [m] with another map.

    Returns:
        Of the cells that the other map knows, the share that are walls there; and the share that it knows. 0 if none.
    """
    distances, is_known = other.distances(walls)
    if not is_known.any():
        return 0.0, 0.0
    is_wall = distances[is_known] < TOLERANCE + other.grid.resolution / 2.0
    return float(is_wall.mean()), float(is_known.mean())


@dataclass(frozen=True)
class LocalFit:
    """Where the walls round a border are in a new map, and how well they fit there.

    Attributes:
        transform: from the old map's frame to the new one's, for this border.
        agreement: the shares of the walls round it that are found again, in both directions; the lower one first.
        known_share: share of the old map's walls there that are in the known part of the new map.
        margin: 0 .. 1, by which share the score of the next best position is lower.
        moved_m: [m] distance from the expected position.
    """

    transform: Transform
    agreement: Tuple[float, float]
    known_share: float
    margin: float
    moved_m: float

    @property
    def is_certain(self) -> bool:
        """Whether the border is certainly there: near where it was expected, or elsewhere on more evidence."""
        lower, higher = self.agreement
        if self.moved_m > _EXPECTED_DISTANCE:
            is_found = lower >= _MIN_AGREEMENT_ELSEWHERE and self.margin >= _MIN_MARGIN_ELSEWHERE
        else:
            is_found = higher >= _MIN_HIGHER_AGREEMENT and lower >= _MIN_LOWER_AGREEMENT and self.margin >= _MIN_MARGIN
        return is_found and self.known_share >= _MIN_KNOWN

    @property
    def is_possible(self) -> bool:
        """Whether the walls allow that the border is there."""
        return self.known_share >= _MIN_KNOWN and self.agreement[1] >= _MIN_HIGHER_AGREEMENT


def fit_locally(old: WallMap, new: WallMap, expected: Transform, outline: np.ndarray) -> Optional[LocalFit]:
    """Finds the walls round a border in a new map; None if there are too few.

    Args:
        expected: the transform from the old map's frame to the new one's at which they are expected.
        outline: (N, 2) [m] the border's, in the old map's frame.
    """
    near = _fit(WALL_RADIUS, old, new, expected, outline)
    # if there are too few walls, or they fit other positions about as well, more walls may decide
    if near is not None and not (near.is_possible and near.margin < _MIN_MARGIN):
        return near
    wider = _fit(WIDER_WALL_RADIUS, old, new, expected, outline)
    is_confirmed = wider is not None and wider.is_certain and wider.moved_m <= _EXPECTED_DISTANCE
    return wider if is_confirmed else near


def _fit(radius: float, old: WallMap, new: WallMap, expected: Transform, outline: np.ndarray) -> Optional[LocalFit]:
    """Finds the walls within a radius [m] of a border in a new map, as `fit_locally` does."""
    walls = old.walls_near(outline, radius)
    if len(walls) < _MIN_WALLS:
        return None
    sample = subsample(walls, _MAX_WALLS)
    center = outline.mean(axis=0)
    here, *aside = _scores(sample, new, expected, np.vstack([[0.0, 0.0], _SHIFTS_ASIDE]))
    share, _ = compare_walls(expected.apply(walls), new)
    if share >= _NO_SEARCH_SHARE and max(aside) <= (1.0 - _MIN_MARGIN) * here:
        best = expected
        margin = 1.0 - max(aside) / here
    else:
        best, margin = _search(sample, new, expected, center)
        new_walls = new.walls_near(best.apply(outline), radius)
        best = refine(old, new, best, (sample, new_walls), center, _REACHES)
    forward, known_share = compare_walls(best.apply(walls), new)
    new_walls = new.walls_near(best.apply(outline), radius)
    backward, _ = compare_walls(best.inverse.apply(new_walls), old)
    agreement = min(forward, backward), max(forward, backward)
    moved = float(np.linalg.norm(best.apply(center)[0] - expected.apply(center)[0]))
    return LocalFit(best, agreement, known_share, margin, moved)


def _search(walls: np.ndarray, new: WallMap, expected: Transform, center: np.ndarray) -> Tuple[Transform, float]:
    """Searches a grid of positions round the expected one; returns the best transform, and its `LocalFit.margin`."""
    expected_center = expected.apply(center)[0]
    yaws = expected.yaw + _SEARCH_YAWS
    transforms = [Transform.rotation_about(center, expected_center, yaw) for yaw in yaws]
    scores = np.array([_scores(walls, new, transform, _SEARCH_SHIFTS) for transform in transforms])
    yaw_index, shift_index = np.unravel_index(int(np.argmax(scores)), scores.shape)
    best_shift = _SEARCH_SHIFTS[shift_index]
    is_apart = np.linalg.norm(_SEARCH_SHIFTS - best_shift, axis=1) > _MIN_SEPARATION
    best_apart = float(scores[:, is_apart].max())
    margin = 1.0 - best_apart / max(1e-9, float(scores[yaw_index, shift_index]))
    return Transform.rotation_about(center, expected_center + best_shift, yaws[yaw_index]), margin


def _scores(walls: np.ndarray, new: WallMap, transform: Transform, shifts: np.ndarray) -> np.ndarray:
    """Scores (K,), 0 .. 1, how near walls (N, 2) are to the new map's, at each of the shifts (K, 2) [m]."""
    points = transform.apply(walls) + shifts[:, None]
    distances, is_known = new.distances(points.reshape(-1, 2))
    nearness = np.maximum(0.0, 1.0 - np.square(distances / _SCORED_DISTANCE))
    shape = len(shifts), len(walls)
    sums = (nearness * is_known).reshape(shape).sum(axis=1)
    known_counts = is_known.reshape(shape).sum(axis=1)
    min_count = _MIN_KNOWN * len(walls)
    return sums / np.maximum(known_counts, min_count)
