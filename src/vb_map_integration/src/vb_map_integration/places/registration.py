"""Registration of an old map in a new one: the transform between two maps of the same place, and how certain it is.

Walls decide. Wherever both maps know the floor, a wall in one must be a wall in the other. What only one of the maps
shows is no evidence. Only long connected walls count as evidence, because furniture is moved and walls are not.

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
from typing import List, Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core.grid_map import Transform
from vb_map_integration.places.walls import TOLERANCE, WallMap, refine, subsample

_MIN_COARSE_CELL = 0.2  # [m] size of the coarse search's cells; a large map's are larger
_MAX_COARSE_CELLS = 160  # cells of the coarse search along a map
_ANGLES = 120  # rotations of the coarse search
_HYPOTHESES = 10  # transforms that are refined
_SAME_DISTANCE = 0.4  # [m] hypotheses are the same if they differ by less than this
_SAME_ANGLE = math.radians(6.0)  # [rad] and by less than this

_REFINED_POINTS = 1500  # wall cells of each map that are matched
_REACHES = (0.6, 0.6, 0.4, 0.4, 0.3, 0.3, 0.2, 0.2, 0.15, 0.15, 0.15)  # [m] `reaches` of `refine`

# When a registration is certain enough to use without asking a person; docs/results/maps/README.md has the evidence.
MIN_AGREEMENT = 0.92  # share of long walls found again, in both directions
MIN_OVERLAP = 0.7  # share of the smaller map's free floor that the other map knows
MIN_WALL_LENGTH = 15.0  # [m] long walls that both maps know
MIN_MARGIN = 0.3  # how much less the next best hypothesis explains, as a share
MIN_MARGIN_ALONE = 0.5  # the same if the walls do not agree: then the margin alone speaks for a registration


@dataclass(frozen=True)
class Registration:
    """How well two maps agree at a transform.

    Attributes:
        transform: transform from the old map's frame to the new one's.
        agreement: share of the long walls that both maps should show that is found again; the lower of both directions.
        overlap: share of the smaller map's free floor that the other map knows.
        walls_m: [m] length of long walls found again; the lower of both directions.
        balance_m: [m] length of the long walls found again minus that of the missing ones; the mean of both directions.
        margin: 0 .. 1, the share by which the next best hypothesis's balance is lower; 0 if none was compared.
    """

    transform: Transform
    agreement: float
    overlap: float
    walls_m: float
    balance_m: float
    margin: float = 0.0

    @property
    def is_certain(self) -> bool:
        """Whether borders may be moved by it without asking a person: walls agree, and nowhere else nearly as well."""
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


def _is_same(transform: Transform, other: Transform, center: np.ndarray) -> bool:
    distance = float(np.linalg.norm(transform.apply(center) - other.apply(center)))
    turn = math.remainder(transform.yaw - other.yaw, 2.0 * math.pi)
    return distance < _SAME_DISTANCE and abs(turn) < _SAME_ANGLE


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
        if len(chosen) == _HYPOTHESES:
            break
        if not any(_is_same(transform, other, old.center) for other in chosen):
            chosen.append(transform)
    return chosen


def _sample(wall_map: WallMap) -> np.ndarray:
    """Chooses wall cells (N, 2) [m] for the refinement: those of long walls if there are enough."""
    points = wall_map.walls[wall_map.is_structure]
    return subsample(points if len(points) >= 100 else wall_map.walls, _REFINED_POINTS)
