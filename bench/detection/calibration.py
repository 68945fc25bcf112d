#!/usr/bin/env python3
"""How right the floor is after a person calibrated a ceiling camera: simulated calibrations of one camera of the lab.

    python3 bench/detection/calibration.py                       200 calibrations each way from points, 5 from images; ~4 minutes
    python3 bench/detection/calibration.py --repetitions 40 --images 0

A calibration draws where the person chose places and how wrong each was measured, runs calibrate_camera's fit with its
rejection of outliers, and compares the floor points of the whole image with the truth. From points, places have the
noise of detections; from images, pictures of the lab are rendered and searched for the spot.
What a person measures is assumed, see `Care`. The map is assumed to be right: its errors would be the robot's as well.
"""

from __future__ import annotations

import math
import sys
from typing import Any, Dict, List, NamedTuple, Tuple

import cv2
import numpy as np

from bench.detection.calibrating_people import Care, Lab, measured_spots
from bench.frame import Table, arguments
from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError
from vb_laser_detect.calibration.pose import PoseEstimationParams, estimate_pose
from vb_sim.cameras.camera_calibration import calibrated_pose

LIMIT_MM = 10.0  # what the floor error should be under


class Way(NamedTuple):
    """A way to calibrate; `point_sigma` [m] is what the command is told with --point_sigma, as for a click or a tape."""

    count: int
    care: Care = Care()
    point_sigma: float = 0.015


TAPE = Care(place_m=0.003)
WAYS: Dict[str, Way] = {
    **{f"{count} spots, clicked": Way(count) for count in (4, 6, 8)},
    "8 spots, clicked, one of 8 slips": Way(8, Care(slip=0.125)),
    "8 spots, clicked, lens 0.1 % wrong": Way(8, Care(lens=0.001)),
    **{f"{count} spots, tape measure": Way(count, TAPE, 0.005) for count in (4, 8)},
}
FROM_IMAGES = "8 spots, clicked"


def calibrate(lab: Lab, way: Way, repetitions: int, seed: int, images: bool = False) -> Dict[str, Any]:
    """Calibrates so many times; returns figures with units in their names."""
    poses, fits, detections, refused = [], [], [], []
    params = PoseEstimationParams(point_sigma=way.point_sigma)
    for k in range(repetitions):
        rng, lens = np.random.default_rng([seed, k]), _calibrated_lens(lab.lens, way.care.lens, seed, k)
        try:
            observed, true = measured_spots(lab, rng, way.count, way.care, images)
            found = estimate_pose(lens, observed, params)
        except CodedError as error:
            refused.append(error.code)
            continue
        poses.append((lens, found.T_map_camera))
        detections += list(np.linalg.norm(observed.pixels - true, axis=1))
        fits.append((found.rms_px, 1e3 * found.rms_m, *(1e3 * np.array(found.floor_sigma))))
    names = ("reprojection_px", "reprojection_mm", "said_middle_mm", "said_worst_mm")
    said = dict(zip(names, np.median(fits, axis=0).tolist())) if fits else {}
    detected = {"detected_px": float(np.sqrt(np.mean(np.square(detections))))} if images and fits else {}
    return {**figures(lab, poses), **said, **detected, "refused": " ".join(sorted(set(refused)))}


def _calibrated_lens(lens: CameraModel, share: float, seed: int, k: int) -> CameraModel:
    """The lens as its own calibration found it."""
    rng, matrix = np.random.default_rng([seed, k, 1]), lens.matrix.copy()
    matrix[[0, 1], [0, 1]] *= 1.0 + share * rng.normal()
    matrix[:2, 2] += 1e3 * share * rng.normal(size=2)
    return CameraModel(lens.width, lens.height, matrix, lens.distortion)


def figures(lab: Lab, poses: List[Tuple[CameraModel, np.ndarray]]) -> Dict[str, Any]:
    """Computes how wrong the floor and the poses are."""
    if not poses:
        return {"calibrations": 0}
    floor = 1e3 * np.array([lab.errors(*one) for one in poses])
    turns = [cv2.Rodrigues(np.ascontiguousarray(lab.pose[:3, :3].T @ pose[:3, :3]))[0] for _, pose in poses]
    shifts = [pose[:3, 3] - lab.pose[:3, 3] for _, pose in poses]
    position, turn = (float(np.sqrt(np.mean(np.sum(np.square(some), axis=1)))) for some in (shifts, turns))
    return {
        "calibrations": len(poses),
        "floor_median_mm": float(np.median(floor)),
        "floor_p95_mm": float(np.percentile(floor, 95)),
        "cameras_under_10mm": float(np.mean(np.median(floor, axis=1) <= LIMIT_MM)),
        "position_rms_mm": 1e3 * position,
        "angle_rms_deg": math.degrees(turn),
    }


def main() -> int:
    parser = arguments(__doc__, seed=1)
    parser.add_argument("--repetitions", type=int, default=200, help="calibrations in each way, from points")
    parser.add_argument("--images", type=int, default=5, help="calibrations from rendered images")
    parser.add_argument("--camera", default="green", help="of the simulated lab; default: %(default)s")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    lab, table = Lab(given.camera), Table()
    for name, way in WAYS.items():
        table.add(way=name, **calibrate(lab, way, given.repetitions, given.seed))
    drawn = [(lab.lens, calibrated_pose(lab.camera, lab.models.optics, seed)) for seed in range(given.repetitions)]
    table.add(way="simulated lab (models.yaml)", **figures(lab, drawn))
    if given.images:
        found = calibrate(lab, WAYS[FROM_IMAGES], given.images, given.seed, True)
        table.add(way=f"{FROM_IMAGES}, from images", **found)
    return 0


if __name__ == "__main__":
    sys.exit(main())
