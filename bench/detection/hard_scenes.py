"""Rendered scenes for the spot detector: plays a scene (scene_list.py) to cameras, and counts what they see.

A scene says at each time where everything is; `play` renders it, searches the pictures as the node does, and compares
with the truth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Optional, Sequence, Set, Tuple

import numpy as np
import yaml

from bench.detection.disturbances import DisturbedSnapshot, SceneConditions
from bench.detection.finder import Finder
from bench.detection.motions import Place, place_and_velocity
from bench.detection.rooms import Rooms
from bench.frame import TOP
from vb_laser_detect.detection.projection import ImageGeometry
from vb_laser_detect.detection.projection import FloorProjection, ProjectionParams
from vb_sim.models import make_generator
from vb_sim.room.floor_plan import physical_map
from vb_sim.room.world import World

RATE = 25.0
LEARN_S, QUIET_S, DRAW_S = 1.0, 8.0, 10.0  # [s] the empty room, the disturbance alone, then with the laser
NEAR_M = 0.10  # a spot further from the laser is a false one
SEEN = 0.5  # a camera sees the spot if so much of its light arrives


@dataclass(frozen=True)
class Scene:
    """One case.

    Attributes:
        worlds: the rooms; `world_at` says which of them is there at a time [s], for things that are moved.
        laser_at: (x, y) [m] of the spot at a time [s].
        around_at: what else changes at a time [s].
        robot_at: (x, y, yaw) of the robot at a time [s]; its camera looks if `mobile`, else the ceiling's.
    """

    name: str
    laser_at: Callable[[float], Place]
    worlds: Tuple[World, ...]
    world_at: Callable[[float], int] = lambda t: 0
    around_at: Callable[[float], SceneConditions] = lambda t: SceneConditions()
    color: str = "red"
    mobile: bool = False
    camera: str = "green"
    robot_at: Callable[[float], Tuple[float, float, float]] = lambda t: (7.6, 0.4, 2.6)
    person: bool = True

    @property
    def title(self) -> str:
        """The name that also says which camera looks."""
        return ("robot: " if self.mobile else "ceiling: ") + self.name


@dataclass
class Outcome:
    """What came of a scene."""

    frames: int = 0
    visible: int = 0
    found: int = 0
    false: List[Tuple[float, float, float]] = field(default_factory=list)  # time [s], u, v [px]
    errors: List[float] = field(default_factory=list)  # [m] on the floor

    def summary(self) -> Dict[str, Any]:
        """Figures with units in their names."""
        errors = 1e3 * np.array(self.errors or [np.nan])
        return {
            "frames": self.frames,
            "visible": self.visible,
            "recall": self.found / self.visible if self.visible else math.nan,
            "false_spots": len(self.false),
            "error_median_mm": float(np.median(errors)),
            "error_p95_mm": float(np.percentile(errors, 95)),
            "false_at": self.false[:12],
        }


class Camera:
    """A rendered camera and its detector, of this or another version (`source`)."""

    def __init__(self, scene: Scene, rooms: Rooms, source: Optional[Path] = None) -> None:
        self._mobile, role = scene.mobile, "mobile" if scene.mobile else "stationary"
        config = yaml.safe_load((TOP / f"src/vb_laser_detect/config/{role}.yaml").read_text())
        floor = physical_map(scene.worlds[0])
        self._projector = FloorProjection(ProjectionParams.from_mapping(config["projection"]), floor)
        self._views = [rooms.view(world, "" if scene.mobile else scene.camera) for world in scene.worlds]
        self.encoding = self._views[0].encoding
        first = next(course(scene))[2]
        for view in self._views:
            # a scene's noise is its own, whichever scenes were played before in the same room
            view.draw_from(make_generator(rooms.seed, f"scene {scene.name}"))
            if not scene.mobile:
                view.frame(first)
        self._finder = Finder(role, source)
        self._lasers: Dict[float, Optional[Place]] = {}
        self._missed: Set[float] = set()  # times [s] at which nothing was seen, until a later frame recalls it

    def picture(self, index: int, snapshot: DisturbedSnapshot) -> Tuple[np.ndarray, ImageGeometry, Any]:
        """Renders one frame: the image, its geometry, and the view that drew it."""
        view = self._views[index]
        image, pose = view.frame(snapshot), view.camera_pose(snapshot)
        depth = (lambda: (view.depth(snapshot), view.depth_model)) if self._mobile else None
        return image, ImageGeometry(view.model, lambda: pose, self._projector, depth), view

    def look(
        self, snapshot: DisturbedSnapshot, image: np.ndarray, frame: ImageGeometry, view: Any, outcome: Outcome
    ) -> None:
        """Searches one picture, and counts."""
        t, hit = snapshot.stamp, False
        self._lasers[t] = snapshot.laser
        outcome.frames += 1
        for spot in self._finder.find(image, t, frame, self.encoding):
            right = self._count(spot, self._lasers[spot.stamp], outcome)
            hit |= right and spot.stamp == t
            if right and spot.stamp in self._missed:
                self._missed.remove(spot.stamp)
                outcome.found += 1
        if snapshot.laser is None or view.spot_share(snapshot) < SEEN:
            return
        outcome.visible += 1
        outcome.found += hit
        if not hit:
            self._missed.add(t)

    @staticmethod
    def _count(spot: Any, laser: Optional[Place], outcome: Outcome) -> bool:
        """Whether a spot is the laser's; if so its error is noted, else it is a false one."""
        error = np.inf if laser is None else float(np.hypot(*(spot.place.position[:2] - laser)))
        if error >= NEAR_M:
            outcome.false.append((round(spot.stamp, 2), round(spot.u, 1), round(spot.v, 1)))
            return False
        outcome.errors.append(error)
        return True


def course(
    scene: Scene, share: float = 1.0, learn_s: float = LEARN_S
) -> Iterator[Tuple[float, int, DisturbedSnapshot]]:
    """Times [s], worlds and snapshots of so much of a scene: the empty room, the disturbance alone, then the laser too."""
    before = learn_s + share * QUIET_S
    for k in range(int(RATE * (before + share * DRAW_S))):
        t = k / RATE
        laser, velocity, person = None, (0.0, 0.0), None
        if t >= before:
            laser, velocity = place_and_velocity(scene.laser_at, t - before)
        if scene.person:
            # beside what is drawn, so that neither the body nor its shadow is always in the way
            target = laser or scene.laser_at(0.0)
            person = (4.6, 2.9, math.atan2(target[1] - 2.9, target[0] - 4.6))
        around = scene.around_at(t) if t >= learn_s else SceneConditions()
        snapshot = DisturbedSnapshot(t, {"robot": scene.robot_at(t)}, laser, scene.color, velocity, person, around)
        yield t, scene.world_at(t) if t >= learn_s else 0, snapshot


def play(scene: Scene, cameras: Sequence[Camera], share: float = 1.0) -> List[Outcome]:
    """Plays so much of one scene's time; several cameras of the scene see the same pictures."""
    outcomes = [Outcome() for _ in cameras]
    for _, index, snapshot in course(scene, share):
        picture = cameras[0].picture(index, snapshot)
        for camera, outcome in zip(cameras, outcomes):
            camera.look(snapshot, *picture, outcome)
    return outcomes
