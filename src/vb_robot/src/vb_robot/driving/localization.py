"""How far a robot's pose can be trusted: the uncertainty of its localisation, and jumps that no motion explains."""

from __future__ import annotations

import math
from collections import deque
from typing import Deque, NamedTuple, Optional

import numpy as np

from vb_core.geometry import Pose, base_to_map, map_to_base

# The localisation's error. AMCL reports the spread of its particles. Its pose is their mean, with a far smaller error.
# At 96 of 100 updates, that error was below the distance that robots keep with these values (`git show
# 27ba7133:docs/results/robots/navigation.md`). Navigation's own clearance covers the rest.
STD_FACTOR = 0.75  # the part of the particles' standard deviation that counts
MIN_UNCERTAINTY = 0.05  # [m] the least that counts, and what counts without a covariance
# above these, which are three times what the margin covers, the robot counts as lost
MAX_STD = 0.4  # [m]
MAX_YAW_STD = 0.35  # [rad]
MAX_UNCERTAINTY = 0.10  # [m] with more, navigation would refuse viewpoints, which may be this near to borders
UNCERTAINTY_STEP = 0.025  # [m] by which the uncertainty changes, because navigation then gets a new map
UNCERTAINTY_UPDATES = 5  # the largest uncertainty of so many localisation updates counts: half a metre of driving
MAX_POSE_JUMP = 0.25  # [m] ten times AMCL's usual correction; a turn of 1 rad counts as 0.5 m


class PoseUncertainty:
    """The localisation uncertainty in the worst direction, from the localisation's own covariance.

    Attributes:
        meters: [m] in steps, so that it seldom changes. It rises at once and falls slowly.
        lost: whether the newest covariance means that the robot may be anywhere.
    """

    def __init__(self) -> None:
        self.meters = MIN_UNCERTAINTY
        self.lost = False
        self._last: Deque[float] = deque(maxlen=UNCERTAINTY_UPDATES)

    def add(self, covariance: np.ndarray) -> bool:
        """Adds the covariance (3, 3) [m, m, rad] of one update's x, y and yaw. Returns whether `meters` has changed."""
        finite = bool(np.isfinite(covariance).all())
        largest_variance = float(np.linalg.eigvalsh(covariance[:2, :2])[-1]) if finite else math.inf
        yaw_variance = float(covariance[2, 2])
        self.lost = largest_variance > MAX_STD**2 or not 0.0 <= yaw_variance <= MAX_YAW_STD**2
        self._last.append(STD_FACTOR * math.sqrt(max(largest_variance, 0.0)))
        previous = self.meters
        uncertainty = min(max(*self._last, MIN_UNCERTAINTY), MAX_UNCERTAINTY)
        self.meters = UNCERTAINTY_STEP * math.floor(uncertainty / UNCERTAINTY_STEP + 1e-6)
        return self.meters != previous


class Fix(NamedTuple):
    """A robot's pose (x, y, yaw) [m, m, rad] at time `stamp` [s], on the map and, if known, in odometry's frame."""

    stamp: float
    pose: Pose
    odometry: Optional[Pose] = None


def pose_jump(earlier: Fix, later: Fix) -> float:
    """Measures by how much [m] the pose changed beyond the odometry's change. A turn of 1 rad counts as 0.5 m.

    Without odometry, what counts is the change beyond what any robot may move in that time, at 1 m/s and 3 rad/s.
    """
    expected = earlier.pose
    elapsed = later.stamp - earlier.stamp
    if earlier.odometry is not None and later.odometry is not None:
        motion = map_to_base(later.odometry[:2], earlier.odometry)
        position = base_to_map(motion, earlier.pose)[0]
        expected = (*position, earlier.pose[2] + later.odometry[2] - earlier.odometry[2])
        elapsed = 0.0
    distance = max(0.0, math.dist(expected[:2], later.pose[:2]) - elapsed)
    rotation = abs(math.remainder(later.pose[2] - expected[2], 2.0 * math.pi))
    return distance + 0.5 * max(0.0, rotation - 3.0 * elapsed)
