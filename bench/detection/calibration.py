#!/usr/bin/env python3
"""How right the floor is after a person calibrated a ceiling camera: simulated calibrations of one camera of the lab.

    python3 bench/detection/calibration.py                       200 calibrations each way

A calibration draws where the person chose places and how wrong each was measured, runs calibrate_camera's fit with its
rejection of outliers, and compares the floor points of the whole image with the truth. What a person measures is assumed,
see `Way`. The map is assumed to be right: its errors would be the robot's as well.
"""

from __future__ import annotations

import math
import sys
from typing import Any, Dict, List, NamedTuple, Sequence

import cv2
import numpy as np

from bench.detection.rooms import lab
from bench.frame import Table, arguments
from vb_core.errors import CodedError
from vb_laser_detect.calibration.pose import Correspondences, PoseEstimationParams, estimate_pose
from vb_laser_detect.detection.projection import floor_points, pixels_of
from vb_sim.cameras.camera_calibration import calibrated_pose
from vb_sim.models import load_models

LIMIT_MM = 10.0  # what the floor error should be under
# where a person puts spots, as parts of the image's width and height, the first ones first; and how loosely
SPOTS = np.array([(0.1, 0.1), (0.9, 0.9), (0.9, 0.1), (0.1, 0.9), (0.5, 0.1), (0.5, 0.9), (0.1, 0.5), (0.9, 0.5)])
LOOSELY = 0.05
NOISE_PX = 0.1  # of a held spot's median; camera_kinds.py measures single spots
HAND_M = 0.005  # [m] of the spot on the marked place, with the pointer held by hand


class Way(NamedTuple):
    """A way to calibrate: standard deviations of what a person measures, each assumed.

    Attributes:
        count: of spots.
        place_m: [m] of a place's map coordinates: a click in RViz, or a tape measure.
        slip: probability that a place is taken for another one, 0.3 m beside.
        point_sigma: [m] what the command is told with --point_sigma.
    """

    count: int
    place_m: float = 0.010
    slip: float = 0.0
    point_sigma: float = 0.015


WAYS: Dict[str, Way] = {
    **{f"{count} spots, clicked": Way(count) for count in (4, 6, 8)},
    "8 spots, clicked, one of 8 slips": Way(8, slip=0.125),
    **{f"{count} spots, tape measure": Way(count, 0.003, point_sigma=0.005) for count in (4, 8)},
}


class Lab:
    """One camera of the simulated lab, and where its pixels truly are."""

    def __init__(self, camera: str) -> None:
        world = lab()
        self.camera = world.camera(camera)
        self.lens, self.pose = self.camera.model(), self.camera.pose()
        u, v = np.meshgrid(np.linspace(0, self.lens.width - 1, 24), np.linspace(0, self.lens.height - 1, 14))
        pixels = np.column_stack([u.ravel(), v.ravel()])
        points = self.floor(pixels)
        inside = ((points >= 0.0) & (points <= world.room.size)).all(axis=1)
        self._pixels, self._points = pixels[inside], points[inside]

    def floor(self, pixels: np.ndarray) -> np.ndarray:
        """Returns the floor points (N, 2) [m] where pixels truly are."""
        return floor_points(self.lens, self.pose, pixels)[:, :2]

    def measure(self, rng: np.random.Generator, way: Way) -> Correspondences:
        """Draws what a person measures who holds the spot on places of the map."""
        parts = SPOTS[: way.count] + rng.uniform(-LOOSELY, LOOSELY, (way.count, 2))
        marked = self.floor(parts * (self.lens.width, self.lens.height))
        lit = marked + rng.normal(0.0, HAND_M, marked.shape)
        pixels = pixels_of(self.lens, self.pose, np.column_stack([lit, np.zeros(len(lit))]))
        believed = marked + rng.normal(0.0, way.place_m, marked.shape)
        angle, slips = rng.uniform(0.0, 2.0 * math.pi, way.count), rng.uniform(size=way.count) < way.slip
        believed += 0.3 * slips[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        return Correspondences(pixels + rng.normal(0.0, NOISE_PX, lit.shape), believed)

    def figures(self, poses: Sequence[np.ndarray]) -> Dict[str, Any]:
        """Computes how wrong the floor is, for spots all over the image, and how wrong the poses (4, 4) are."""
        if not poses:
            return {"calibrations": 0}
        there = [floor_points(self.lens, pose, self._pixels)[:, :2] - self._points for pose in poses]
        floor = 1e3 * np.linalg.norm(there, axis=2)
        turns = [cv2.Rodrigues(np.ascontiguousarray(self.pose[:3, :3].T @ pose[:3, :3]))[0] for pose in poses]
        shifts = [pose[:3, 3] - self.pose[:3, 3] for pose in poses]
        position, turn = (float(np.sqrt(np.mean(np.sum(np.square(some), axis=1)))) for some in (shifts, turns))
        return {
            "calibrations": len(poses),
            "floor_median_mm": float(np.median(floor)),
            "floor_p95_mm": float(np.percentile(floor, 95)),
            "cameras_under_10mm": float(np.mean(np.median(floor, axis=1) <= LIMIT_MM)),
            "position_rms_mm": 1e3 * position,
            "angle_rms_deg": math.degrees(turn),
        }


def calibrate(room: Lab, way: Way, repetitions: int, seed: int) -> Dict[str, Any]:
    """Calibrates so many times; returns figures with units in their names."""
    fits: List[Any] = []
    refused = set()
    for k in range(repetitions):
        measured = room.measure(np.random.default_rng([seed, k]), way)
        try:
            fits.append(estimate_pose(room.lens, measured, PoseEstimationParams(point_sigma=way.point_sigma)))
        except CodedError as error:
            refused.add(error.code)
    said = {}
    if fits:
        said = {
            "reprojection_px": float(np.median([one.rms_px for one in fits])),
            "reprojection_mm": float(np.median([1e3 * one.rms_m for one in fits])),
        }
    return {**room.figures([one.T_map_camera for one in fits]), **said, "refused": " ".join(sorted(refused))}


def main() -> int:
    parser = arguments(__doc__, seed=1)
    parser.add_argument("--repetitions", type=int, default=200, help="calibrations in each way")
    parser.add_argument("--camera", default="green", help="of the simulated lab; default: %(default)s")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    room, table = Lab(given.camera), Table(given.csv)
    for name, way in WAYS.items():
        table.add(way=name, **calibrate(room, way, given.repetitions, given.seed))
    optics = load_models().optics
    drawn = [calibrated_pose(room.camera, optics, seed) for seed in range(given.repetitions)]
    table.add(way="simulated lab (models.yaml)", **room.figures(drawn))
    return 0


if __name__ == "__main__":
    sys.exit(main())
