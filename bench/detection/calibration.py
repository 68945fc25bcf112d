#!/usr/bin/env python3
"""How right the floor is after a person calibrated a ceiling camera: simulated calibrations of one camera of the lab.

    python3 bench/detection/calibration.py                       200 calibrations each way from points, 5 from images; ~4 minutes
    python3 bench/detection/calibration.py --repetitions 40 --images 0

A calibration draws where the person chose places and how wrong each was measured, runs calibrate_camera's fit with its
rejection of outliers, and compares the floor points of the whole image with the truth. From points, places have the
noise of detections; from images, pictures of the lab are rendered and searched for the spot or the board.
What a person measures is assumed, see `Care`. The map is assumed to be right: its errors would be the robot's as well.
Writes out/bench/calibration.json.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Tuple

import cv2
import numpy as np

TOP = Path(__file__).resolve().parents[2]
for package in ("vb_core", "vb_laser_detect", "vb_sim"):
    sys.path.insert(0, str(TOP / "src" / package / "src"))
sys.path.insert(0, str(TOP / "src" / "vb_laser_detect" / "test"))

from board_scene import render_board  # noqa: E402

from vb_core.camera_model import CameraModel  # noqa: E402
from vb_core.errors import CodedError  # noqa: E402
from vb_laser_detect.calibration.board import BoardParams, corners_on_map, find_board, merge_views  # noqa: E402
from vb_laser_detect.calibration.calibration_session import HeldSpot  # noqa: E402
from vb_laser_detect.calibration.pose import Correspondences, PoseEstimationParams, estimate_pose  # noqa: E402
from vb_laser_detect.detection.image_format import to_gray  # noqa: E402
from vb_laser_detect.detection.projection import floor_points, pixels_of  # noqa: E402
from vb_laser_detect.detector import DetectorParams, SpotDetector  # noqa: E402
from vb_sim.cameras.camera_calibration import calibrated_pose  # noqa: E402
from vb_sim.cameras.ceiling_view import CeilingView  # noqa: E402
from vb_sim.lab_history import Snapshot  # noqa: E402
from vb_sim.room.camera_models import load_camera_models  # noqa: E402
from vb_sim.room.floor_texture import render_floor  # noqa: E402
from vb_sim.room.mesh import world_mesh  # noqa: E402
from vb_sim.room.world import load_world  # noqa: E402

# where a person puts spots and boards, as parts of the image's width and height, the first ones first; and how loosely
SPOTS = np.array([(0.1, 0.1), (0.9, 0.9), (0.9, 0.1), (0.1, 0.9), (0.5, 0.1), (0.5, 0.9), (0.1, 0.5), (0.9, 0.5)])
BOARDS = np.array([(0.15, 0.2), (0.85, 0.8), (0.85, 0.2), (0.15, 0.8)])
LOOSELY = 0.05
LIMIT_MM = 10.0  # what the floor error should be under


@dataclass(frozen=True)
class Care:
    """How exactly a person measures: standard deviations, each assumed.

    Attributes:
        place_m: of a place's map coordinates: a click in RViz, or a tape measure.
        hand_m: of the spot on the marked place, with the pointer held by hand.
        board_m, board_deg: of the board's P1, and of its direction.
        slip: probability that a place is taken for another one, 0.3 m beside.
        lens: share by which the calibrated focal length is wrong; the principal point is as wrong in pixels times 1000.
    """

    place_m: float = 0.010
    hand_m: float = 0.005
    board_m: float = 0.003
    board_deg: float = 0.3
    slip: float = 0.0
    lens: float = 0.0


# of a held spot's median and of a board's corner; what `--images` measures
SPOT_PX, CORNER_PX = 0.1, 0.1
CLICKED, TAPE = Care(), Care(place_m=0.003)


class Lab:
    """One camera of the simulated lab, and calibrations of it."""

    def __init__(self, camera: str) -> None:
        self.world = load_world(str(TOP / "src/vb_sim/worlds/lab.yaml"))
        self.models = load_camera_models(str(TOP / "src/vb_sim/config/models.yaml"))
        self.camera = self.world.camera(camera)
        self.lens, self.pose = self.camera.model(), self.camera.pose()
        self.board = BoardParams.for_paper("A3")
        u, v = np.meshgrid(np.linspace(0, self.lens.width - 1, 24), np.linspace(0, self.lens.height - 1, 14))
        pixels = np.column_stack([u.ravel(), v.ravel()])
        points = self.floor(pixels)
        inside = ((points >= 0.0) & (points <= self.world.room.size)).all(axis=1)
        self._pixels, self._points = pixels[inside], points[inside]
        self._view: Optional[CeilingView] = None

    def floor(self, pixels: np.ndarray) -> np.ndarray:
        """Returns the floor points (N, 2) [m] where pixels truly are."""
        return floor_points(self.lens, self.pose, pixels)[:, :2]

    def seen_at(self, points: np.ndarray) -> np.ndarray:
        """Returns where floor points truly are in the image, (N, 2) [px]; inverse of `floor`."""
        return pixels_of(self.lens, self.pose, np.column_stack([points, np.zeros(len(points))]))

    def floor_errors(self, lens: CameraModel, pose: np.ndarray) -> np.ndarray:
        """Returns by how much [m], (N,), spots all over the image would lie at a wrong place."""
        return np.linalg.norm(floor_points(lens, pose, self._pixels)[:, :2] - self._points, axis=1)

    @property
    def view(self) -> CeilingView:
        """What the camera sees."""
        if self._view is None:
            floor, mesh = render_floor(self.world, 1), world_mesh(self.world)
            self._view = CeilingView(self.camera, self.world.robot_radii(), floor, mesh, self.models, 1)
        return self._view

    def free(self, points: np.ndarray) -> bool:
        """Returns whether the camera sees floor at all of these points."""
        return all(self.view.spot_share(Snapshot(0.0, laser=(float(x), float(y)))) > 0.9 for x, y in points)


# ------------------------------------------------------------------ what a person does
Measured = Tuple[Correspondences, np.ndarray]  # and where the same points truly are in the image, (N, 2) [px]


def measured_spots(lab: Lab, rng: np.random.Generator, count: int, care: Care, images: bool) -> Measured:
    """Spots that a person held on places of the map."""
    places = [_choose(lab, rng, part, images, lambda pixel: lab.floor(pixel[None])) for part in SPOTS[:count]]
    marked = np.concatenate(places)
    lit = marked + rng.normal(0.0, care.hand_m, marked.shape)
    true = lab.seen_at(lit)
    pixels = _held(lab, lit) if images else true + rng.normal(0.0, SPOT_PX, lit.shape)
    believed = marked + rng.normal(0.0, care.place_m, marked.shape)
    angle = rng.uniform(0.0, 2.0 * math.pi, count)
    slips = rng.uniform(size=count) < care.slip
    believed += 0.3 * slips[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    seen = ~np.isnan(pixels).any(axis=1)
    return Correspondences.single(pixels[seen], believed[seen]), true[seen]


def measured_boards(lab: Lab, rng: np.random.Generator, count: int, care: Care, images: bool) -> Measured:
    """Lays a board on places of the map, as a person does."""
    board, placed, true = lab.board, [], []
    all_corners = board.opencv().getChessboardCorners()[:, :2].astype(float)

    def ends(p1: np.ndarray, yaw: float) -> Tuple[np.ndarray, np.ndarray]:
        return p1, p1 + board.size[0] * np.array([math.cos(yaw), math.sin(yaw)])

    for part in BOARDS[:count]:
        yaw = rng.uniform(0.0, 2.0 * math.pi)
        outline = np.array([(0.0, 0.0), (board.size[0], 0.0), board.size, (0.0, board.size[1])])

        def corners_of(pixel: np.ndarray) -> np.ndarray:
            return corners_on_map(board, outline, *ends(lab.floor(pixel[None])[0], yaw))

        p1, p2 = _choose(lab, rng, part, images, corners_of)[:2]
        if images:
            picture = to_gray(lab.view.frame(Snapshot(0.0)), lab.view.encoding)
            noise = float(lab.models.noise.sigma(128.0))
            shown = [render_board(board, p1, p2, rng, lab.lens, lab.pose, noise, image=picture) for _ in range(3)]
            view = merge_views([find_board(board, image) for image in shown])
            corners, pixels = view.corners, view.pixels
        else:
            corners, pixels = all_corners, None
        true.append(lab.seen_at(corners_on_map(board, corners, p1, p2)))
        if pixels is None:
            pixels = true[-1] + rng.normal(0.0, CORNER_PX, true[-1].shape)
        wrong = ends(p1 + rng.normal(0.0, care.board_m, 2), yaw + math.radians(rng.normal(0.0, care.board_deg)))
        placed.append((pixels, corners_on_map(board, corners, *wrong)))
    return Correspondences.placed(placed), np.concatenate(true)


def _choose(
    lab: Lab, rng: np.random.Generator, part: np.ndarray, free: bool, points: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """`points` of a pixel near a part of the image, all within it; with `free`, where there is floor, not furniture."""
    size, loosely = np.array([lab.lens.width, lab.lens.height]), LOOSELY
    for _ in range(300):
        found = points((part + rng.uniform(-loosely, loosely, 2)) * size)
        if lab.lens.contains(lab.seen_at(found)).all() and (not free or lab.free(found)):
            return found
        loosely = min(0.3, 1.02 * loosely)
    raise CodedError("no_place", f"no free floor near {part} of the image")


def _held(lab: Lab, places: np.ndarray) -> np.ndarray:
    """(N, 2) [px] where the detector sees the laser that is held on each place; NaN where it does not."""
    detector, stamp, found = SpotDetector(DetectorParams.stationary(max_dwell_time=3600.0)), 0.0, []
    detector.encoding = lab.view.encoding
    for place in [None, *places]:
        held = HeldSpot()
        for k in range(30):
            lit = None if place is None or k < 5 else (float(place[0]), float(place[1]))
            spots = detector.detect(lab.view.frame(Snapshot(stamp, laser=lit)), stamp)
            held.add(stamp, [(spot.u, spot.v) for spot in spots] if lit else [])
            stamp += 0.04
        if place is not None:
            try:
                found.append(held.place())
            except CodedError:
                found.append((math.nan, math.nan))
    return np.array(found)


# ------------------------------------------------------------------ ways, and what comes of them
@dataclass(frozen=True)
class Way:
    """A way to calibrate; `sigma` is what the command is told."""

    measure: Callable[[Lab, np.random.Generator, int, Care, bool], Measured]
    count: int
    care: Care
    params: PoseEstimationParams


def _spots(count: int, care: Care) -> Way:
    # what the command is told with --point_sigma: the click's default, or that of a tape measure
    return Way(measured_spots, count, care, PoseEstimationParams(point_sigma=0.015 if care.place_m >= 0.01 else 0.005))


def _boards(count: int, care: Care = CLICKED) -> Way:
    return Way(measured_boards, count, care, PoseEstimationParams())


WAYS: Dict[str, Way] = {
    "4 spots, clicked": _spots(4, CLICKED),
    "6 spots, clicked": _spots(6, CLICKED),
    "8 spots, clicked": _spots(8, CLICKED),
    "8 spots, clicked, one of 8 slips": _spots(8, Care(slip=0.125)),
    "8 spots, clicked, lens 0.1 % wrong": _spots(8, Care(lens=0.001)),
    "4 spots, tape measure": _spots(4, TAPE),
    "8 spots, tape measure": _spots(8, TAPE),
    "board, 1 place": _boards(1),
    "board, 2 places": _boards(2),
    "board, 3 places": _boards(3),
    "board, 4 places": _boards(4),
    "board, 4 places, lens 0.1 % wrong": _boards(4, Care(lens=0.001)),
    # two clicks 0.35 m apart, each wrong by 10 mm, turn the board by 2.3 degrees
    "board, 4 places, clicked": _boards(4, Care(board_m=0.010, board_deg=2.3)),
}
FROM_IMAGES = ("8 spots, clicked", "board, 4 places")


@dataclass
class Results:
    """Calibrations in one way."""

    errors: List[np.ndarray] = field(default_factory=list)  # [m] over the floor
    off: List[Tuple[float, float]] = field(default_factory=list)  # [m], [rad] of the pose
    fits: List[Tuple[float, ...]] = field(default_factory=list)  # [px], [m] rms; [m] as said: middle, worst
    detections: List[float] = field(default_factory=list)  # [px] detected against true
    refused: Dict[str, int] = field(default_factory=dict)

    def add_pose(self, lab: Lab, lens: CameraModel, pose: np.ndarray) -> None:
        turn = cv2.Rodrigues(np.ascontiguousarray(lab.pose[:3, :3].T @ pose[:3, :3]))[0]
        self.errors.append(lab.floor_errors(lens, pose))
        self.off.append((float(np.linalg.norm(pose[:3, 3] - lab.pose[:3, 3])), float(np.linalg.norm(turn))))

    def summary(self) -> Dict[str, Any]:
        """Figures with units in their names."""
        result: Dict[str, Any] = {"calibrations": len(self.errors), "refused": self.refused}
        if not self.errors:
            return result
        floor, medians = 1e3 * np.array(self.errors), 1e3 * np.median(self.errors, axis=1)
        position, turn = np.sqrt(np.mean(np.square(self.off), axis=0))
        result.update(
            floor_median_mm=float(np.median(floor)),
            floor_p95_mm=float(np.percentile(floor, 95)),
            cameras_median_p95_mm=float(np.percentile(medians, 95)),
            cameras_under_10mm_share=float(np.mean(medians <= LIMIT_MM)),
            position_rms_mm=float(1e3 * position),
            angle_rms_deg=float(np.degrees(turn)),
        )
        if self.fits:
            px, m, middle, worst = np.median(self.fits, axis=0)
            result.update(
                reprojection_px=px, reprojection_mm=1e3 * m, said_middle_mm=1e3 * middle, said_worst_mm=1e3 * worst
            )
        if self.detections:
            result.update(detection_rms_px=float(np.sqrt(np.mean(np.square(self.detections)))))
        return {key: round(value, 3) if isinstance(value, float) else value for key, value in result.items()}


def _calibrated_lens(lens: CameraModel, share: float, rng: np.random.Generator) -> CameraModel:
    """The lens as its own calibration found it."""
    matrix = lens.matrix.copy()
    matrix[[0, 1], [0, 1]] *= 1.0 + share * rng.normal()
    matrix[:2, 2] += 1e3 * share * rng.normal(size=2)
    return CameraModel(lens.width, lens.height, matrix, lens.distortion)


def calibrate(lab: Lab, way: Way, repetitions: int, seed: int, images: bool = False) -> Results:
    """Calibrates so many times."""
    results = Results()
    for k in range(repetitions):
        rng = np.random.default_rng([seed, k])
        lens = _calibrated_lens(lab.lens, way.care.lens, np.random.default_rng([seed, k, 1]))
        try:
            observed, true = way.measure(lab, rng, way.count, way.care, images)
            found = estimate_pose(lens, observed, way.params)
        except CodedError as error:
            results.refused[error.code] = results.refused.get(error.code, 0) + 1
            continue
        results.add_pose(lab, lens, found.T_map_camera)
        results.detections += list(np.linalg.norm(observed.pixels - true, axis=1))
        results.fits.append((found.rms_px, found.rms_m, *found.floor_sigma))
    return results


def simulated_lab(lab: Lab, repetitions: int) -> Results:
    """Measures the poses that vb_sim gives its cameras."""
    results = Results()
    for seed in range(repetitions):
        results.add_pose(lab, lab.lens, calibrated_pose(lab.camera, lab.models.optics, seed))
    return results


def _row(name: str, figures: Dict[str, Any]) -> str:
    if not figures["calibrations"]:
        return f"{name:36s} refused: {figures['refused']}"
    get = lambda key: figures.get(key, math.nan)  # noqa: E731
    return (
        f"{name:36s}{figures['floor_median_mm']:9.1f}{figures['floor_p95_mm']:7.1f}"
        f"{figures['cameras_under_10mm_share']:9.0%}{figures['cameras_median_p95_mm']:8.1f}"
        f"{get('reprojection_px'):9.2f}{get('reprojection_mm'):7.1f}"
        f"{get('said_middle_mm'):8.1f}{get('said_worst_mm'):7.1f}"
        f"{figures['position_rms_mm']:9.1f}{figures['angle_rms_deg']:7.2f}"
        + (f"  refused: {figures['refused']}" if figures["refused"] else "")
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=200, help="calibrations in each way, from points")
    parser.add_argument("--images", type=int, default=5, help="calibrations in each of two ways, from rendered images")
    parser.add_argument("--camera", default="green", help="of the simulated lab; default: %(default)s")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=TOP / "out" / "bench" / "calibration.json")
    arguments = parser.parse_args()
    if arguments.repetitions < 2 or arguments.images < 0:
        parser.error("--repetitions must be at least 2, --images at least 0")
    cv2.setNumThreads(1)
    try:
        lab = Lab(arguments.camera)
    except CodedError as error:
        parser.error(str(error))
    result: Dict[str, Any] = {}
    heads = {"floor error [mm]": 16, "each camera's": 17, "reprojection": 16, "said [mm]": 15, "pose off by": 16}
    print(" " * 36 + "".join(f"{text:>{width}s}" for text, width in heads.items()))
    names = "median", "95 %", "<10 mm", "95 %", "px", "mm", "middle", "worst", "mm", "deg"
    print("way".ljust(36) + "".join(f"{name:>{width}s}" for name, width in zip(names, (9, 7, 9, 8, 9, 7, 8, 7, 9, 7))))

    def report(name: str, results: Results) -> None:
        result[name] = results.summary()
        print(_row(name, result[name]), flush=True)

    for name, way in WAYS.items():
        report(name, calibrate(lab, way, arguments.repetitions, arguments.seed))
    report("simulated lab (models.yaml)", simulated_lab(lab, arguments.repetitions))
    for name in FROM_IMAGES if arguments.images else ():
        report(f"{name}, from images", calibrate(lab, WAYS[name], arguments.images, arguments.seed, True))
        found = result[f"{name}, from images"]
        print(f"    detected to {found.get('detection_rms_px', math.nan):.2f} px rms")
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps(result, indent=2) + "\n")
    print(f"written to {arguments.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
