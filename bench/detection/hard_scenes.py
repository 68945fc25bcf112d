"""Rendered scenes for the spot detector: every hard case that a room has, with and without a laser.

Used by frames.py. A scene says at each time where everything is; `play` renders it, searches the pictures as
the node does, and compares with the truth.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Optional, Sequence, Tuple

import numpy as np
import yaml

TOP = Path(__file__).resolve().parents[2]
for package in ("vb_core", "vb_laser_detect", "vb_sim"):
    sys.path.insert(0, str(TOP / "src" / package / "src"))

from versions import other_detector  # noqa: E402

from vb_core import geometry  # noqa: E402
from vb_laser_detect.detection import projection  # noqa: E402
from vb_laser_detect.detection.image_geometry import ImageGeometry, search  # noqa: E402
from vb_laser_detect.detection.projection import FloorProjection, ProjectionParams  # noqa: E402
from vb_laser_detect.detector import DetectorParams, Spot, SpotDetector  # noqa: E402
from vb_sim.cameras.camera_calibration import calibrated_pose  # noqa: E402
from vb_sim.cameras.ceiling_view import CeilingView  # noqa: E402
from vb_sim.cameras.robot_view import RobotView  # noqa: E402
from vb_sim.lab_history import Snapshot  # noqa: E402
from vb_sim.robot.motion_models import LocalizationModel  # noqa: E402
from vb_sim.room.camera_models import CameraModels, make_generator  # noqa: E402
from vb_sim.room.disturbances import Bystander, Glint, SceneConditions  # noqa: E402
from vb_sim.room.floor_plan import physical_map  # noqa: E402
from vb_sim.room.floor_texture import FloorTexture, render_floor  # noqa: E402
from vb_sim.room.mesh import world_mesh  # noqa: E402
from vb_sim.room.raycast import DistanceField  # noqa: E402
from vb_sim.room.world import FloorPatch, Light, World, load_world  # noqa: E402

DETECTOR = (DetectorParams, SpotDetector), search
RATE = 25.0
LEARN_S, QUIET_S, DRAW_S = 1.0, 8.0, 10.0  # [s] the empty room, the disturbance alone, then with the laser
NEAR_M = 0.10  # a spot further from the laser is a false one
SEEN = 0.5  # a camera sees the spot if so much of its light arrives
DRAWS = 20  # poses drawn for the error that includes calibration or localisation
WHITE, DARK = (238, 236, 230), (40, 40, 44)

CARPET = np.array([[3.12, 0.8], [5.12, 0.8], [5.12, 2.05], [3.12, 2.05]])
Place = Tuple[float, float]


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
    draw_s: float = DRAW_S


@dataclass
class Outcome:
    """What came of a scene."""

    frames: int = 0
    visible: int = 0
    found: int = 0
    false: List[Tuple[float, float, float, float]] = field(default_factory=list)  # time [s], u, v [px], diameter [px]
    missed: Dict[str, int] = field(default_factory=dict)
    errors: List[float] = field(default_factory=list)  # [m] with the true pose
    errors_posed: List[float] = field(default_factory=list)  # [m] with poses as wrong as real ones

    def summary(self) -> Dict[str, Any]:
        """Figures with units in their names."""
        hours = self.frames / RATE / 3600.0
        result: Dict[str, Any] = {
            "frames": self.frames,
            "visible_frames": self.visible,
            "recall": round(self.found / self.visible, 4) if self.visible else None,
            "false_spots": len(self.false),
            "false_spots_per_hour": round(len(self.false) / hours, 1) if hours else None,
            "missed_because": {why: count for why, count in self.missed.items() if count},
            "false_at_time_u_v_diameter": self.false,
        }
        for name, values in (("error", self.errors), ("error_with_pose_error", self.errors_posed)):
            result[f"{name}_median_mm"] = round(1e3 * float(np.median(values)), 2) if values else None
            result[f"{name}_p95_mm"] = round(1e3 * float(np.percentile(values, 95)), 2) if values else None
        return result


class Rooms:
    """Draws each room once: most scenes play in the same one.

    Args:
        models: figures of optics and noise.
        seed: of textures and noise.
    """

    def __init__(self, models: CameraModels, seed: int) -> None:
        self.models, self.seed = models, seed
        self._views: List[Tuple[World, str, Any]] = []
        self._floors: List[Tuple[World, FloorTexture]] = []

    def view(self, world: World, camera: str) -> Any:
        """Returns a ceiling camera's view, or with an empty name that of the robot's camera."""
        for known, name, view in self._views:
            if known is world and name == camera:
                return view
        floor = next((floor for known, floor in self._floors if _same_floor(known, world)), None)
        if floor is None:
            floor = render_floor(world, self.seed)
            self._floors.append((world, floor))
        mesh, radii = world_mesh(world), world.robot_radii()
        if camera:
            view: Any = CeilingView(world.camera(camera), radii, floor, mesh, self.models, self.seed)
        else:
            view = RobotView(world.robots[0], radii, floor, mesh, self.models, self.seed)
        self._views.append((world, camera, view))
        return view


def _same_floor(a: World, b: World) -> bool:
    return all(
        getattr(a, part) == getattr(b, part) for part in ("room", "floor", "walls", "furniture", "patches", "lights")
    )


class SeenFrame(ImageGeometry):
    """An image's geometry, and the truth."""

    refusal_at = ImageGeometry.rejection_at  # what older versions of the detector call

    def __init__(self, snapshot: Snapshot, *geometry_of_it: Any) -> None:
        super().__init__(*geometry_of_it)
        self.snapshot, self.model = snapshot, geometry_of_it[0]


class Camera:
    """A rendered camera and its detector, wired as the node does it.

    Args:
        source: folder of another version's packages, whose detector looks instead.
        judge: another classifier than the one that comes with the package.
    """

    def __init__(self, scene: Scene, rooms: Rooms, source: Optional[Path] = None, judge: Any = None) -> None:
        self._mobile = scene.mobile
        name = "mobile.yaml" if scene.mobile else "stationary.yaml"
        kind, self.search = DETECTOR if source is None else other_detector(source)
        settings = yaml.safe_load(((source or TOP / "src") / "vb_laser_detect/config" / name).read_text())
        config = yaml.safe_load((TOP / "src/vb_laser_detect/config" / name).read_text())
        self.detector = kind[1](kind[0].from_mapping(settings.get("detector") or {}), *([judge] if judge else []))
        self.detector.encoding = "bgr8" if scene.mobile else scene.worlds[0].camera(scene.camera).encoding
        floor = physical_map(scene.worlds[0])
        self._projector = FloorProjection(ProjectionParams.from_mapping(config["projection"]), floor)
        self._model: Any = None
        self._views = [rooms.view(world, "" if scene.mobile else scene.camera) for world in scene.worlds]
        self._poses = _pose_errors(scene, rooms.models, rooms.seed)
        first = next(course(scene))[2]
        for view in self._views:
            # a scene's noise is its own, whichever scenes were played before in the same room
            noise = make_generator(rooms.seed, f"scene {scene.name}")
            if scene.mobile:
                view.draw_from(noise)
            else:
                view.frame(first, noise)
        self._missed: Dict[float, str] = {}  # why nothing was seen at a time [s], until a later frame recalls it

    def picture(self, t: float, index: int, snapshot: Snapshot) -> Tuple[np.ndarray, SeenFrame, Any]:
        """Renders one frame: the image, its geometry, and the view that drew it."""
        view = self._views[index]
        depth = None
        if self._mobile:
            image, pose, model = view.color(snapshot), view.camera_pose(snapshot), view.color_model
            depth = lambda: (view.depth(snapshot), view.depth_model)  # noqa: E731
        else:
            image, pose, model = view.frame(snapshot), view.pose, view.model
        return image, SeenFrame(snapshot, model, lambda: pose, self._projector, depth), view

    def pictures(
        self, scene: Scene, quiet_s: float, draw_s: float
    ) -> Iterator[Tuple[float, np.ndarray, SeenFrame, Any, Snapshot]]:
        """Renders a scene: the disturbance alone, then with the laser."""
        for t, index, snapshot in course(scene, quiet_s, draw_s):
            yield (t, *self.picture(t, index, snapshot), snapshot)

    def look(self, t: float, image: np.ndarray, frame: SeenFrame, view: Any, outcome: Outcome) -> None:
        """Searches one picture, and counts."""
        snapshot, self._model = frame.snapshot, frame.model
        spots = self.search(self.detector, image, t, frame)
        outcome.frames += 1
        for earlier in self.detector.backfilled:
            if self._count(earlier.spot, earlier.stamp, earlier.tag, outcome) and earlier.stamp in self._missed:
                outcome.missed[self._missed.pop(earlier.stamp)] -= 1
                outcome.found += 1
        hits = [self._count(spot, t, frame, outcome) for spot in spots]
        if snapshot.laser is None or view.spot_share(snapshot) < SEEN:
            return
        outcome.visible += 1
        if any(hits):
            outcome.found += 1
            return
        why = self._missed[t] = self._why(view.spot(snapshot, frame.pose) if self._mobile else view.spot(snapshot))
        outcome.missed[why] = outcome.missed.get(why, 0) + 1

    def _count(self, spot: Spot, t: float, frame: SeenFrame, outcome: Outcome) -> bool:
        """Whether a spot is the laser's; if so its errors are noted, else it is a false one."""
        point, laser = frame.point(spot.u, spot.v), frame.snapshot.laser
        error = np.inf if laser is None else float(np.hypot(*(point.position[:2] - laser)))
        if error >= NEAR_M:
            outcome.false.append((round(t, 2), round(spot.u, 1), round(spot.v, 1), round(spot.diameter, 1)))
            return False
        outcome.errors.append(error)
        for wrong in self._poses(frame.pose):
            if self._mobile:
                moved = geometry.apply(wrong @ geometry.invert(frame.pose), point.position)
            else:
                moved = projection.floor_points(self._model, wrong, np.array([[spot.u, spot.v]]))[0]
            outcome.errors_posed.append(float(np.hypot(*(moved[:2] - laser))))
        return True

    def _why(self, spot: Any) -> str:
        near = [c for c in self.detector.candidates if math.hypot(c.u - spot.center[0], c.v - spot.center[1]) < 25]
        return near[0].rejection or "another_spot" if near else "no_candidate"


def _pose_errors(scene: Scene, models: CameraModels, seed: int) -> Callable[[np.ndarray], Iterator[np.ndarray]]:
    """Poses as a calibration (ceiling) or a localisation (robot) would give them, as wrong as models.yaml says."""
    random = np.random.default_rng(seed)
    if not scene.mobile:
        camera = scene.worlds[0].camera(scene.camera)
        wrong = [calibrated_pose(camera, models.optics, 100 + k) for k in range(DRAWS)]
        return lambda pose: iter(wrong)
    model = LocalizationModel()
    offsets = [
        (geometry.rotation_from_rpy(0, 0, random.normal(0, model.yaw_sigma)), random.normal(0, model.position_sigma, 2))
        for _ in range(DRAWS)
    ]

    def localized(pose: np.ndarray) -> Iterator[np.ndarray]:
        for rotation, shift in offsets:
            moved = pose.copy()
            # the robot turns about itself, its camera sits 0.1 m before that
            moved[:3, :3] = rotation @ pose[:3, :3]
            moved[:2, 3] += shift
            yield moved

    return localized


def course(scene: Scene, quiet_s: float = QUIET_S, draw_s: float = 0.0) -> Iterator[Tuple[float, int, Snapshot]]:
    """Times [s], worlds and snapshots of a scene: the empty room, the disturbance alone, then with the laser."""
    before = LEARN_S + quiet_s
    for k in range(int(RATE * (before + (draw_s or scene.draw_s)))):
        t = k / RATE
        laser, velocity, person = None, (0.0, 0.0), None
        if t >= before:
            laser, velocity = place_and_velocity(scene.laser_at, t - before)
        if scene.person:
            # beside what is drawn, so that neither the body nor its shadow is always in the way
            target = laser or scene.laser_at(0.0)
            person = (4.6, 2.9, math.atan2(target[1] - 2.9, target[0] - 4.6))
        around = scene.around_at(t) if t >= LEARN_S else SceneConditions()
        snapshot = Snapshot(t, {"robot": scene.robot_at(t)}, laser, scene.color, velocity, person, around)
        yield t, scene.world_at(t) if t >= LEARN_S else 0, snapshot


def play(scene: Scene, cameras: Sequence[Camera], share: float = 1.0) -> List[Outcome]:
    """Plays so much of one scene's time; several cameras of the scene see the same pictures."""
    outcomes = [Outcome() for _ in cameras]
    for t, index, snapshot in course(scene, share * QUIET_S, share * scene.draw_s):
        image, frame, view = cameras[0].picture(t, index, snapshot)
        for camera, outcome in zip(cameras, outcomes):
            camera.look(t, image, frame, view, outcome)
    return outcomes


# ------------------------------------------------------------------ what moves how
def along(chain: np.ndarray, speed: float, closed: bool = True) -> Callable[[float], Place]:
    """Returns the motion of a spot round a chain (N, 2) [m], or to and fro, at a speed [m/s], with a hand's tremor of 1 cm."""
    points = np.vstack([chain, chain[:1]]) if closed else np.vstack([chain, chain[-2::-1]])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])

    def at(t: float) -> Place:
        s = (speed * t) % arc[-1]
        wave = 0.007 * math.sin(9.0 * t), 0.007 * math.sin(11.0 * t + 1.0)
        return float(np.interp(s, arc, points[:, 0])) + wave[0], float(np.interp(s, arc, points[:, 1])) + wave[1]

    return at


def place_and_velocity(laser_at: Callable[[float], Place], t: float) -> Tuple[Place, Tuple[float, float]]:
    """Returns where a spot is [m] at a time [s], and how fast it goes [m/s]."""
    (x, y), (later_x, later_y) = laser_at(t), laser_at(t + 0.01)
    return (x, y), ((later_x - x) / 0.01, (later_y - y) / 0.01)


def still(x: float, y: float, tremor: float = 0.0) -> Callable[[float], Place]:
    """Returns the motion of a spot that is held on one place, with a tremor [m]."""
    return lambda t: (x + tremor * math.sin(5.0 * t), y + tremor * math.sin(7.3 * t + 0.5))


class Walk:
    """Somebody who walks from place to place at about 1 m/s, where the floor is free.

    Args:
        glint: [grey levels] brightness of what shines on the right shoe; 0: nothing does.
    """

    def __init__(
        self,
        world: World,
        seed: int,
        shirt: Sequence[int] = DARK,
        shoes: Sequence[int] = DARK,
        speed: float = 1.0,
        glint: float = 0.0,
        seconds: float = 60.0,
    ) -> None:
        self._shirt, self._shoes, self._speed, self._glint = tuple(shirt), tuple(shoes), speed, glint
        clearance, random = DistanceField(physical_map(world)).clearance, np.random.default_rng(seed)

        def free(points: np.ndarray) -> bool:
            return all(clearance(*point) > 0.25 for point in points)

        def place() -> np.ndarray:
            while True:
                point = random.uniform((0.3, 0.3), np.array(world.room.size) - 0.3)
                if free(point[None]):
                    return point

        stations = [place()]
        while len(stations) < 2 + seconds * speed / 1.2:
            point = place()
            if free(stations[-1] + np.linspace(0, 1, 20)[:, None] * (point - stations[-1])):
                stations.append(point)
        self._stations = np.array(stations)
        self._arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self._stations, axis=0), axis=1))])

    def at(self, t: float) -> Tuple[Bystander, Tuple[Glint, ...]]:
        """Returns the person, and what shines on the shoes, at a time [s]."""
        s = min(self._speed * t, self._arc[-1] - 1e-6)
        leg = int(np.searchsorted(self._arc, s, side="right")) - 1
        a, b = self._stations[leg], self._stations[leg + 1]
        x, y = a + (s - self._arc[leg]) / (self._arc[leg + 1] - self._arc[leg]) * (b - a)
        yaw = math.atan2(b[1] - a[1], b[0] - a[0])
        who = Bystander((float(x), float(y), yaw), self._shirt, self._shoes)
        # a shoe turns its shine to the camera in a part of each step
        if not self._glint or (1.8 * t) % 1.0 > 0.4:
            return who, ()
        toe = (x + 0.15 * math.cos(yaw) + 0.1 * math.sin(yaw), y + 0.15 * math.sin(yaw) - 0.1 * math.cos(yaw), 0.07)
        return who, (Glint(toe, 0.012, self._glint),)


def walking(*walks: Walk) -> Callable[[float], SceneConditions]:
    """Returns the conditions with several people walking, as a function of time [s]."""

    def at(t: float) -> SceneConditions:
        states = [walk.at(t) for walk in walks]
        return SceneConditions(
            bystanders=tuple(who for who, _ in states), glints=sum((glints for _, glints in states), ())
        )

    return at


def every(period: float, *values: Any) -> Callable[[float], Any]:
    """Takes one value after the other, each for a period [s]."""
    return lambda t: values[int(t / period) % len(values)]


# ------------------------------------------------------------------ the cases
def lab(**changes: Any) -> World:
    """Returns the lab, changed."""
    return replace(load_world(str(TOP / "src/vb_sim/worlds/lab.yaml")), **changes)


def draw_round_carpet(room: World, rooms: Rooms, count: int) -> List[List[np.ndarray]]:
    """Renders for each ceiling camera the empty room, then so many frames: a person draws, two walk about."""
    border, people = along(CARPET, 0.4), walking(Walk(room, 3, WHITE, DARK), Walk(room, 4, (150, 40, 40), WHITE))
    found = []
    for camera in room.cameras:
        view = rooms.view(room, camera.name)
        frames = [view.frame(Snapshot(0.0, {})).copy()]
        for now in np.arange(count) / RATE:
            laser, velocity = place_and_velocity(border, now)
            person = (4.6, 2.9, math.atan2(laser[1] - 2.9, laser[0] - 4.6))
            frames.append(view.frame(Snapshot(now, {}, laser, "red", velocity, person, people(now))).copy())
        found.append(frames)
    return found


def with_camera(world: World, name: str = "green", **changes: Any) -> World:
    """Changes one of a world's ceiling cameras."""
    return replace(world, cameras=tuple(replace(c, **changes) if c.name == name else c for c in world.cameras))


def dots(
    places: Sequence[Place], colors: Sequence[Tuple[int, int, int]], size: float = 0.018
) -> Tuple[FloorPatch, ...]:
    """Returns printed dots [m] on the floor."""
    return tuple(
        FloorPatch.from_mapping(
            {"name": "dot", "x": x, "y": y, "size": [size, size], "color": list(color), "contrast": 0.0}
        )
        for (x, y), color in zip(places, colors)
    )


def ceiling_scenes(room: World) -> List[Scene]:
    """Lists every hard case under a ceiling camera."""
    border = along(CARPET, 0.4)
    chair = next(thing for thing in room.furniture if thing.name == "chair")
    moved = lab(furniture=tuple(replace(t, x=3.6, y=3.2, yaw=30.0) if t is chair else t for t in room.furniture))
    red, green, white = (235, 30, 40), (40, 230, 60), (250, 250, 250)
    places = ((3.5, 2.4), (4.6, 2.3), (5.3, 1.2))
    printed = lab(patches=room.patches + dots(places, (red, green, red)))
    whites = lab(patches=room.patches + dots(places, (white,) * 3))
    walkers = [Walk(room, 3, WHITE, DARK), Walk(room, 4, (150, 40, 40), WHITE)]
    shiny = [Walk(room, 5, DARK, DARK, glint=400.0), Walk(room, 6, (70, 90, 150), DARK, glint=250.0)]
    lamp = Glint((3.7, 2.3, 0.0), 0.03, 350.0)
    floors = {
        name: lab(floor=replace(room.floor, kind="tiles", color=color, contrast=contrast), patches=(), lights=())
        for name, color, contrast in (
            ("bright", (195, 192, 186), 0.06),
            ("overexposed", (228, 226, 220), 0.06),
            ("dark", (38, 34, 32), 0.2),
            ("black", (16, 15, 15), 0.2),
        )
    }

    def sun(t: float) -> SceneConditions:
        edge = 2.9 + 0.05 * t
        return SceneConditions(sun=((edge, 1.0), (edge + 1.2, 1.1), (edge + 1.3, 2.3), (edge + 0.1, 2.2)))

    scenes = [
        Scene("nothing else", border, (room,)),
        Scene("moved chair", border, (room, moved), every(4.0, 0, 1), walking(walkers[0])),
        Scene("light switched", border, (room,), around_at=every(3.0, SceneConditions(), SceneConditions(light=0.4))),
        Scene(
            "exposure step",
            border,
            (room,),
            around_at=every(3.0, SceneConditions(), SceneConditions(exposure=1.5), SceneConditions(exposure=0.7)),
        ),
        Scene("sun patch, moving edge", border, (room,), around_at=sun),
        Scene("walking people", border, (room,), around_at=walking(*walkers)),
        Scene("printed dots, always there", border, (printed,)),
        Scene("printed dots, laid down and taken away", border, (room, printed), every(4.0, 1, 0)),
        Scene("white dots, laid down and taken away", border, (room, whites), every(4.0, 1, 0)),
        Scene("shiny shoes", border, (room,), around_at=walking(*shiny)),
        Scene(
            "lamp's reflection, comes and goes",
            border,
            (room,),
            around_at=every(1.5, SceneConditions(), SceneConditions(glints=(lamp,))),
        ),
        Scene("held still", still(3.6, 2.2), (room,)),
        Scene("held in a hand", still(3.6, 2.2, 0.007), (room,)),
    ]
    scenes += [Scene(f"drawn at {speed} m/s", along(CARPET, speed), (room,)) for speed in (0.2, 0.5, 1.0, 1.5)]
    scenes += [
        Scene(f"{name} floor, {color}", border, (world,), color=color)
        for name, world in floors.items()
        for color in ("red", "green")
    ]
    scenes += [Scene(f"camera {height} m high", border, (with_camera(room, height=height),)) for height in (2.2, 4.0)]
    scenes += [
        Scene(f"{encoding} images", border, (with_camera(room, encoding=encoding),)) for encoding in ("bgr8", "mono8")
    ]
    scenes.append(Scene("strong distortion", border, (with_camera(room, distortion=(-0.28, 0.08, 0.0, 0.0, 0.0)),)))
    return scenes


def training_scenes(room: World) -> List[Scene]:
    """Lists what only the classifier's training sees: printed dots of other colours and sizes, on other floors, under
    both cameras.

    The dots of `ceiling_scenes` thus remain a test of whether paint is told from light.
    """
    colors = ((40, 60, 220), (240, 220, 40), (240, 120, 200), (250, 130, 30), (30, 200, 210))
    scenes = []
    for name, floor, size in (
        ("grey", room.floor, 0.012),
        ("pale", replace(room.floor, kind="tiles", color=(170, 165, 155)), 0.025),
        ("brown", replace(room.floor, kind="tiles", color=(120, 85, 60)), 0.018),
    ):
        bare = lab(floor=floor, patches=())
        for mobile, places in (
            (False, ((3.3, 2.3), (4.4, 2.5), (5.2, 1.6), (3.9, 1.4), (4.8, 1.1))),
            (True, ((5.9, 1.2), (5.6, 0.8), (5.3, 1.1), (5.7, 1.0), (5.5, 1.3))),
        ):
            printed = replace(bare, patches=dots(places, colors, size))
            # twice within the time that is learnt from; a robot stands still, so that they are new to it
            scenes.append(
                Scene(
                    f"dots on a {name} floor",
                    still(4.0, 3.0) if not mobile else still(5.8, 0.9),
                    (bare, printed),
                    every(1.0, 1, 0),
                    mobile=mobile,
                    person=False,
                    robot_at=lambda t: (6.9, 1.0, math.pi),
                )
            )
    return scenes


def mobile_scenes(room: World) -> List[Scene]:
    """Lists the scenes of the robot's camera: distances, motion, and what is no spot."""
    start = (6.9, 1.0, math.pi)  # looks along the free floor beside the carpet
    dark = lab(floor=replace(room.floor, color=(38, 34, 32)), patches=())
    bright = lab(floor=replace(room.floor, kind="tiles", color=(195, 192, 186), contrast=0.06), patches=())

    def ahead(distance: float, side: float = 0.15) -> Callable[[float], Place]:
        """[m] from the camera's foot; the spot goes to and fro across the view at about 0.2 m/s."""
        return lambda t: (start[0] - 0.1 - distance, start[1] + side * math.sin(1.3 * t))

    def drive(t: float) -> Tuple[float, float, float]:
        return (start[0] - 0.2 * max(0.0, t - 2.0) % 0.8, start[1], start[2])

    def turn(t: float) -> Tuple[float, float, float]:
        return (start[0], start[1], start[2] + 0.35 * math.sin(1.4 * t))

    def common(name: str, laser: Callable[[float], Place], world: World = room, **more: Any) -> Scene:
        return Scene(name, laser, (world,), mobile=True, **{"robot_at": lambda t: start, "person": False, **more})

    scenes = [
        common(f"{distance} m, {color}", ahead(distance), color=color)
        for distance in (0.5, 1.0, 1.5, 2.0, 2.5)
        for color in ("red", "green")
    ]
    scenes += [
        common(f"drawn at {speed} m/s, 1.2 m", along(np.array([[5.6, 0.7], [5.6, 1.3]]), speed, False))
        for speed in (0.5, 1.0)
    ]
    lights = (Light.from_mapping({"name": "lamp", "x": 5.7, "y": 1.25, "radius": 0.05, "brightness": 220.0}),)
    people = Walk(room, 8, WHITE, WHITE), Walk(room, 9, DARK, DARK, glint=400.0)
    scenes += [
        common("robot drives", ahead(1.6), robot_at=drive),
        common("robot turns", ahead(1.4), robot_at=turn),
        common("bright floor, red", ahead(1.2), bright),
        common("bright floor, green", ahead(1.2), bright, color="green"),
        common("dark floor, red", ahead(1.2), dark),
        common("dark floor, green", ahead(1.2), dark, color="green"),
        common(
            "printed dots",
            ahead(1.2),
            lab(
                patches=room.patches
                + dots(((5.9, 1.2), (5.6, 0.8), (5.3, 1.1)), ((235, 30, 40), (40, 230, 60), (250, 250, 250)))
            ),
            robot_at=turn,
        ),
        common("lamp's reflection", ahead(1.2), lab(lights=lights), robot_at=turn),
        common("walking people, shiny shoes", ahead(1.2), around_at=walking(*people)),
        common("light switched", ahead(1.2), around_at=every(3.0, SceneConditions(), SceneConditions(light=0.4))),
    ]
    return scenes


def quiet(minutes: float, seed: int) -> Dict[str, Outcome]:
    """Measures the lab without a laser: three people walk, one with shiny shoes, and a robot drives, under all ceiling cameras."""
    room, seconds, rooms = lab(), 60.0 * minutes, Rooms(CameraModels(), seed)
    people = walking(
        Walk(room, 10 * seed, WHITE, DARK, 0.9, 0.0, seconds),
        Walk(room, 10 * seed + 1, (150, 40, 40), WHITE, 1.1, 0.0, seconds),
        Walk(room, 10 * seed + 2, DARK, DARK, 0.6, 300.0, seconds),
    )
    driver = Walk(room, 10 * seed + 3, speed=0.3, seconds=seconds)
    scenes = {camera.name: Scene("no laser", still(0, 0), (room,), camera=camera.name) for camera in room.cameras}
    cameras = {name: Camera(scene, rooms) for name, scene in scenes.items()}
    outcomes = {name: Outcome() for name in cameras}
    for k in range(int(RATE * seconds)):
        t = k / RATE
        robot = driver.at(t)[0].pose
        snapshot = Snapshot(t, {"robot": robot}, around=people(t))
        for name, camera in cameras.items():
            camera.look(t, *camera.picture(t, 0, snapshot), outcomes[name])
    return outcomes
