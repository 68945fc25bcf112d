"""Registration of an old map in a new one: the transform between two maps of the same place, and how certain it is.

Walls decide. Wherever both maps know the floor, a wall in one must be a wall in the other; what only one of
them has seen is no evidence. Long connected walls carry the evidence, since furniture is moved and walls are not.

1. A coarse search over all rotations finds where the walls of both maps fit best: one correlation by FFT per angle.
2. The best hypotheses are refined to a fraction of a cell: each wall cell is pulled to the nearest wall of the other
   map (Gauss-Newton on the distance fields of both maps, far pairs left out).
3. Each is scored by the share of long walls that are found again, in both directions, within `TOLERANCE`. The best
   one is certain only if nearly all are found again, enough walls support it, and no other one comes near.

Scale is fixed: both maps are in metres. Resolutions may differ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import List, Optional, Sequence, Tuple

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
_MAX_DISTANCE = 20_000  # [_DISTANCE_UNIT] larger distances are stored as this
_POINTS_AT_ONCE = 30_000  # points that OpenCV interpolates in one call
_DRAWN_FLOOR = 400_000  # points of free floor that are drawn for the coarse search

_MIN_COARSE_CELL = 0.2  # [m] size of the coarse search's cells; a large map's are larger
_MAX_COARSE_CELLS = 160  # cells of the coarse search along a map
_ANGLES = 120  # rotations of the coarse search
_HYPOTHESES = 10  # transforms that are refined
_SAME_DISTANCE = 0.4  # [m] hypotheses are the same if they differ by less than this
_SAME_ANGLE = math.radians(6.0)  # [rad] and by less than this

_REFINED_POINTS = 1500  # wall cells of each map that are matched
_REACHES = (0.6, 0.6, 0.4, 0.4, 0.3, 0.3, 0.2, 0.2, 0.15, 0.15, 0.15)  # [m] `reaches` of `refine`
# damping per pair of x, y and yaw: the step stays short in a direction in which the walls decide nothing
_DAMPING = np.diag([0.002, 0.002, 0.004])
_MAX_STEP = np.array([0.3, 0.3, 0.05])  # [m], [m], [rad] the longest step of a refinement

# When a registration is certain enough to use without asking a person; docs/results/maps/README.md has the evidence.
MIN_AGREEMENT = 0.92  # share of long walls found again, in both directions
MIN_OVERLAP = 0.7  # share of the smaller map's free floor that the other map knows
MIN_WALL_LENGTH = 15.0  # [m] long walls that both maps know
MIN_MARGIN = 0.3  # how much less the next best hypothesis explains, as a share
MIN_MARGIN_ALONE = 0.5  # the same if the walls do not agree: then the margin alone speaks for a registration

# wall cells (N, 2) [m] of the old map, and (K, 2) of the new one, each in its map's frame
WallPair = Tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Registration:
    """How well two maps agree at a transform.

    Attributes:
        transform: transform from the old map's frame to the new one's.
        agreement: share found again of the long walls that both maps should show; the lower of both directions.
        overlap: share of the smaller map's free floor that the other map knows.
        walls_m: [m] length of long walls found again; the lower of both directions.
        balance_m: [m] length of long walls found again less that of missing ones; the mean of both directions.
        margin: 0 .. 1, how much lower the next best hypothesis's balance is, as a share; 0 if none was compared.
    """

    transform: Transform
    agreement: float
    overlap: float
    walls_m: float
    balance_m: float
    margin: float = 0.0

    @property
    def is_certain(self) -> bool:
        """Whether borders may be moved by it without asking a person: walls agree, and no other transform comes near."""
        return self.walls_agree and self.walls_m >= MIN_WALL_LENGTH and self.margin >= MIN_MARGIN

    @property
    def is_clearly_best(self) -> bool:
        """Whether borders are moved by it, but only until a person, or the walls round the borders, decide."""
        return self.margin >= MIN_MARGIN_ALONE and self.overlap >= MIN_OVERLAP and self.walls_m >= MIN_WALL_LENGTH

    @property
    def walls_agree(self) -> bool:
        """Whether the maps agree at this transform, however well they do at others."""
        return self.agreement >= MIN_AGREEMENT and self.overlap >= MIN_OVERLAP

    @property
    def score(self) -> float:
        """0 .. 1: `agreement`, scaled down by the other measure that is farthest below its minimum, if any is."""
        parts = (self.overlap / MIN_OVERLAP, self.walls_m / MIN_WALL_LENGTH, self.margin / MIN_MARGIN)
        return float(max(0.0, self.agreement) * min(1.0, *parts))


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
        return self._interpolate(positions), np.column_stack(slopes) @ Transform(yaw=self.grid.origin[2]).rotation.T

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
    cells = grid.data[top : rows[-1] + 1 + _UNKNOWN_RIM, left : columns[-1] + 1 + _UNKNOWN_RIM]
    x, y = grid.grid_to_world([[left - 0.5, top - 0.5]])[0]
    return GridMap(np.ascontiguousarray(cells), grid.resolution, (x, y, grid.origin[2]))


def register_maps(old: WallMap, new: WallMap, guesses: Sequence[Transform] = (Transform(),)) -> Optional[Registration]:
    """Finds the old map in the new one and returns the best hypothesis, or None if one of the maps has no walls.

    Args:
        guesses: transforms that are always tried.
    """
    if not len(old.walls) or not len(new.walls):
        return None
    samples = _sample(old), _sample(new)
    starts = [*guesses, *_search(old, new)]
    refined = [refine(old, new, start, samples, old.center, _REACHES) for start in starts]
    candidates = [evaluate_transform(old, new, transform) for transform in refined]
    best, *others = sorted(candidates, key=lambda candidate: -candidate.balance_m)
    if best.balance_m <= 0.0:
        return best
    rivals = [other.balance_m for other in others if not _is_same(best.transform, other.transform, old.center)]
    return replace(best, margin=1.0 - max([0.0, *rivals]) / best.balance_m)


def evaluate_transform(old: WallMap, new: WallMap, transform: Transform) -> Registration:
    """Measures how well the maps agree at one transform."""
    shares, lengths, balances, overlaps = [], [], [], []
    for moved, fixed, motion in ((old, new, transform), (new, old, transform.inverse)):
        walls = motion.apply(moved.walls[moved.is_structure])
        expected = walls[fixed.is_known(walls)]
        distances, _ = fixed.look_up(expected)
        hits = int((distances < TOLERANCE + fixed.grid.resolution / 2.0).sum())
        shares.append(hits / max(1, len(expected)))
        lengths.append(hits * moved.grid.resolution)
        balances.append((2 * hits - len(expected)) * moved.grid.resolution)
        floor_is_known = fixed.is_known(motion.apply(moved.floor))
        overlaps.append(float(floor_is_known.mean()) if len(moved.floor) else 0.0)
    return Registration(transform, min(shares), max(overlaps), min(lengths), float(np.mean(balances)))


def _is_same(transform: Transform, other: Transform, place: np.ndarray) -> bool:
    distance = float(np.linalg.norm(transform.apply(place) - other.apply(place)))
    return distance < _SAME_DISTANCE and abs(math.remainder(transform.yaw - other.yaw, 2.0 * math.pi)) < _SAME_ANGLE


def _search(old: WallMap, new: WallMap) -> List[Transform]:
    """Searches for the most promising transforms, the best first."""
    extent = max(old.radius, new.radius)
    cell = max(_MIN_COARSE_CELL, 2.0 * extent / _MAX_COARSE_CELLS)
    old_image, new_image = old.draw_evidence(cell), new.draw_evidence(cell)
    size = cv2.getOptimalDFTSize(len(old_image) + len(new_image))
    new_spectrum = cv2.dft(np.pad(new_image, (0, size - len(new_image))))
    middle = len(old_image) // 2
    peaks: List[Tuple[float, Transform]] = []  # the correlation's maxima
    for angle in np.arange(_ANGLES) * (360.0 / _ANGLES):
        # OpenCV's angles are for images whose rows go down; here rows go up, as y does
        rotation = cv2.getRotationMatrix2D((middle, middle), -angle, 1.0)
        turned = cv2.warpAffine(old_image, rotation, old_image.shape[::-1])
        old_spectrum = cv2.dft(np.pad(turned, (0, size - len(turned))))
        product = cv2.mulSpectrums(new_spectrum, old_spectrum, 0, conjB=True)
        scores = cv2.dft(product, flags=cv2.DFT_INVERSE | cv2.DFT_SCALE | cv2.DFT_REAL_OUTPUT)
        for _ in range(3):
            _, score, _, cell_of_peak = cv2.minMaxLoc(scores)
            # a shift to the left or downwards has wrapped round
            shift = np.array([n if n < size - len(old_image) else n - size for n in cell_of_peak])
            center_in_new = new.center + (shift + middle - len(new_image) // 2) * cell
            peaks.append((score, Transform.rotation_about(old.center, center_in_new, math.radians(angle))))
            cv2.circle(scores, cell_of_peak, max(2, int(0.6 / cell)), 0.0, -1)
    chosen: List[Transform] = []
    for _, transform in sorted(peaks, key=lambda peak: -peak[0]):
        if len(chosen) < _HYPOTHESES and not any(_is_same(transform, other, old.center) for other in chosen):
            chosen.append(transform)
    return chosen


def subsample(points: np.ndarray, count: int) -> np.ndarray:
    """Thins points (N, 2) evenly to at least `count`, but fewer than twice as many."""
    return points[:: max(1, len(points) // count)]


def _sample(wall_map: WallMap) -> np.ndarray:
    """Chooses wall cells (N, 2) [m] for the refinement: those of long walls if there are enough."""
    points = wall_map.walls[wall_map.is_structure]
    return subsample(points if len(points) >= 100 else wall_map.walls, _REFINED_POINTS)


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
        weighted = jacobian * np.square(np.maximum(0.0, 1.0 - np.square(distances / reach)))[:, None]
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
        Of those that the map knows, the share that are walls there, and the share that it knows; 0 if it knows none.
    """
    distances, is_known = other.distances(walls)
    if not is_known.any():
        return 0.0, 0.0
    return float((distances[is_known] < TOLERANCE + other.grid.resolution / 2.0).mean()), float(is_known.mean())
