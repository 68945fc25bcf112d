"""What people do who calibrate a ceiling camera of the simulated lab, and how wrong they are; for calibration.py."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, Tuple

import numpy as np

from bench.detection.finder import Finder
from bench.frame import TOP
from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError
from vb_laser_detect.calibration.calibration_session import HeldSpot
from vb_laser_detect.calibration.pose import Correspondences
from vb_laser_detect.detection.projection import floor_points, pixels_of
from vb_sim.cameras.ceiling_view import CeilingView
from vb_sim.lab_history import Snapshot
from vb_sim.room.camera_models import load_camera_models
from vb_sim.room.floor_texture import render_floor
from vb_sim.room.mesh import world_mesh
from vb_sim.room.world import load_world

# where a person puts spots, as parts of the image's width and height, the first ones first; and how loosely
SPOTS = np.array([(0.1, 0.1), (0.9, 0.9), (0.9, 0.1), (0.1, 0.9), (0.5, 0.1), (0.5, 0.9), (0.1, 0.5), (0.9, 0.5)])
LOOSELY = 0.05
NOISE_PX = 0.1  # of a held spot's median; what `--images` measures


@dataclass(frozen=True)
class Care:
    """How exactly a person measures: standard deviations, each assumed.

    Attributes:
        place_m: of a place's map coordinates: a click in RViz, or a tape measure.
        hand_m: of the spot on the marked place, with the pointer held by hand.
        slip: probability that a place is taken for another one, 0.3 m beside.
        lens: share by which the calibrated focal length is wrong; the principal point is as wrong in pixels times 1000.
    """

    place_m: float = 0.010
    hand_m: float = 0.005
    slip: float = 0.0
    lens: float = 0.0


class Lab:
    """One camera of the simulated lab, and where its pixels truly are."""

    def __init__(self, camera: str) -> None:
        world = load_world(str(TOP / "src/vb_sim/worlds/lab.yaml"))
        self.models = load_camera_models(str(TOP / "src/vb_sim/config/models.yaml"))
        self.camera = world.camera(camera)
        self.lens, self.pose = self.camera.model(), self.camera.pose()
        u, v = np.meshgrid(np.linspace(0, self.lens.width - 1, 24), np.linspace(0, self.lens.height - 1, 14))
        pixels = np.column_stack([u.ravel(), v.ravel()])
        points = self.floor(pixels)
        inside = ((points >= 0.0) & (points <= world.room.size)).all(axis=1)
        self._pixels, self._points = pixels[inside], points[inside]
        self.view = CeilingView(
            self.camera, world.robot_radii(), render_floor(world, 1), world_mesh(world), self.models, 1
        )

    def floor(self, pixels: np.ndarray) -> np.ndarray:
        """Returns the floor points (N, 2) [m] where pixels truly are."""
        return floor_points(self.lens, self.pose, pixels)[:, :2]

    def seen_at(self, points: np.ndarray) -> np.ndarray:
        """Returns where floor points truly are in the image, (N, 2) [px]; inverse of `floor`."""
        return pixels_of(self.lens, self.pose, np.column_stack([points, np.zeros(len(points))]))

    def errors(self, lens: CameraModel, pose: np.ndarray) -> np.ndarray:
        """Returns by how much [m], (N,), spots all over the image would lie at a wrong place."""
        return np.linalg.norm(floor_points(lens, pose, self._pixels)[:, :2] - self._points, axis=1)

    def choose(
        self, rng: np.random.Generator, part: np.ndarray, free: bool, points: Callable[[np.ndarray], np.ndarray]
    ) -> np.ndarray:
        """`points` of a pixel near a part of the image, all within it; with `free`, where there is floor, not furniture."""
        size, loosely = np.array([self.lens.width, self.lens.height]), LOOSELY
        for _ in range(300):
            found = points((part + rng.uniform(-loosely, loosely, 2)) * size)
            lit = (Snapshot(0.0, laser=(float(x), float(y))) for x, y in found)
            if self.lens.contains(self.seen_at(found)).all() and (
                not free or all(self.view.spot_share(one) > 0.9 for one in lit)
            ):
                return found
            loosely = min(0.3, 1.02 * loosely)
        raise CodedError("no_place", f"no free floor near {part} of the image")


# ------------------------------------------------------------------ what a person does
Measured = Tuple[Correspondences, np.ndarray]  # and where the same points truly are in the image, (N, 2) [px]


def measured_spots(lab: Lab, rng: np.random.Generator, count: int, care: Care, images: bool) -> Measured:
    """Spots that a person held on places of the map."""
    places = [lab.choose(rng, part, images, lambda pixel: lab.floor(pixel[None])) for part in SPOTS[:count]]
    marked = np.concatenate(places)
    lit = marked + rng.normal(0.0, care.hand_m, marked.shape)
    true = lab.seen_at(lit)
    pixels = _held(lab, lit) if images else true + rng.normal(0.0, NOISE_PX, lit.shape)
    believed = marked + rng.normal(0.0, care.place_m, marked.shape)
    angle = rng.uniform(0.0, 2.0 * math.pi, count)
    slips = rng.uniform(size=count) < care.slip
    believed += 0.3 * slips[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    seen = ~np.isnan(pixels).any(axis=1)
    return Correspondences(pixels[seen], believed[seen]), true[seen]


def _held(lab: Lab, places: np.ndarray) -> np.ndarray:
    """(N, 2) [px] where the detector sees the laser that is held on each place; NaN where it does not."""
    finder, stamp, found = Finder("stationary", max_dwell_time=3600.0), 0.0, []
    for place in [None, *places]:
        held = HeldSpot()
        for k in range(30):
            lit = None if place is None or k < 5 else (float(place[0]), float(place[1]))
            spots = finder.find(lab.view.frame(Snapshot(stamp, laser=lit)), stamp, encoding=lab.view.encoding)
            held.add(stamp, [(one.spot.u, one.spot.v) for one in spots if one.stamp == stamp] if lit else [])
            stamp += 0.04
        if place is not None:
            try:
                found.append(held.place())
            except CodedError:
                found.append((math.nan, math.nan))
    return np.array(found)
