"""Reads a simulated world from a YAML file: room, furniture, cameras, robots and scenarios.

An unknown key, a wrong type or a value out of range raises a `ParameterError` that says where it is in the file, for
instance "cameras[1]/height". Angles in the file and the fields are in degrees; methods return them in radians.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Mapping, Tuple

import numpy as np
from shapely.geometry import Polygon

from vb_core import geometry
from vb_core.camera_model import CameraModel
from vb_core.errors import ParameterError
from vb_core.geometry import base_to_map
from vb_core.parameters import Parameters, param
from vb_sim.model_params import read_document

CAMERA_FOV = 58.0  # [deg] horizontal field of view of a robot's camera; assumed
Rgb = Tuple[int, int, int]  # 0 .. 255
Point2 = Tuple[float, float]  # (x, y) [m], map frame


def _color(default: Rgb) -> Any:
    return param(default, "", low=0, high=255)


@dataclass(frozen=True)
class Room(Parameters):
    """The outer walls, and the grid of the map."""

    size: Tuple[float, float] = param((8.0, 5.0), "m", above=0.0, high=100.0)
    resolution: float = param(0.025, "m", low=0.005, high=0.5)
    margin: float = param(0.2, "m", low=0.0, high=5.0)
    wall_height: float = param(2.5, "m", above=0.0)
    wall_thickness: float = param(0.1, "m", above=0.0)


@dataclass(frozen=True)
class Floor(Parameters):
    """The floor's appearance."""

    kind: str = param("planks", choices=("planks", "tiles", "plain"))
    color: Rgb = _color((150, 122, 92))
    contrast: float = param(0.16, low=0.0, high=1.0)
    plank: Tuple[float, float] = param((1.2, 0.14), "m", above=0.01)


@dataclass(frozen=True)
class Wall(Parameters):
    """An inner wall between two points."""

    start: Tuple[float, float] = param((0.0, 0.0), "m")
    end: Tuple[float, float] = param((1.0, 0.0), "m")
    thickness: float = param(0.05, "m", above=0.0)
    height: float = param(0.5, "m", above=0.0)
    color: Rgb = _color((225, 222, 215))


@dataclass(frozen=True)
class Furniture(Parameters):
    """A box, a cylinder, or a table with four legs; x, y is its centre."""

    name: str = param("thing")
    kind: str = param("box", choices=("box", "cylinder", "table"))
    x: float = param(0.0, "m")
    y: float = param(0.0, "m")
    yaw: float = param(0.0, "deg")
    size: Tuple[float, float] = param((0.5, 0.5), "m", above=0.0)
    radius: float = param(0.2, "m", above=0.0)
    height: float = param(0.7, "m", above=0.0)
    leg: float = param(0.05, "m", above=0.0)
    color: Rgb = _color((160, 160, 160))

    def footprint(self) -> np.ndarray:
        """Returns the outline (N, 2) [m] seen from above, counter-clockwise."""
        if self.kind == "cylinder":
            angles = np.linspace(0, 2 * math.pi, 24, endpoint=False)
            x = self.x + self.radius * np.cos(angles)
            y = self.y + self.radius * np.sin(angles)
            return np.column_stack([x, y])
        return _rectangle(self.x, self.y, self.size, self.yaw)

    def contact_outlines(self) -> List[np.ndarray]:
        """Returns the outlines (N, 2) [m] of the parts on the floor, which a laser scanner sees."""
        if self.kind != "table":
            return [self.footprint()]
        between_legs = (self.size[0] - self.leg, self.size[1] - self.leg)
        legs = _rectangle(self.x, self.y, between_legs, self.yaw)
        return [_rectangle(x, y, (self.leg, self.leg), self.yaw) for x, y in legs]


@dataclass(frozen=True)
class FloorPatch(Parameters):
    """A carpet or scattered snippets of paper, flat on the floor."""

    name: str = param("patch")
    kind: str = param("rectangle", choices=("rectangle", "snippets"))
    x: float = param(0.0, "m")
    y: float = param(0.0, "m")
    yaw: float = param(0.0, "deg")
    size: Tuple[float, float] = param((1.0, 1.0), "m", above=0.0)
    count: int = param(40, low=0, high=10000)
    snippet: float = param(0.03, "m", above=0.0)
    contrast: float = param(0.2, low=0.0, high=1.0)
    color: Rgb = _color((128, 48, 52))

    def footprint(self) -> np.ndarray:
        """Returns the outline (4, 2) [m]."""
        return _rectangle(self.x, self.y, self.size, self.yaw)


@dataclass(frozen=True)
class Light(Parameters):
    """A bright region of the floor, such as a reflection or a patch of sunlight."""

    name: str = param("light")
    x: float = param(0.0, "m")
    y: float = param(0.0, "m")
    radius: float = param(0.1, "m", above=0.0)
    brightness: float = param(60.0, "grey levels", low=0.0, high=255.0)


@dataclass(frozen=True)
class CeilingCamera(Parameters):
    """A stationary camera.

    At pitch 90 it looks straight down; the top of its image is then towards +y at yaw 0. With less pitch, it looks
    towards +y at yaw 0, and towards -x at yaw 90.
    """

    name: str = param("camera")
    x: float = param(0.0, "m")
    y: float = param(0.0, "m")
    height: float = param(2.95, "m", above=0.1)
    pitch: float = param(90.0, "deg", low=5.0, high=90.0)
    yaw: float = param(0.0, "deg")
    width: int = param(1920, "px", low=16)
    image_height: int = param(1080, "px", low=16)
    horizontal_fov: float = param(82.0, "deg", low=5.0, high=150.0)
    distortion: Tuple[float, ...] = param((-0.06, 0.01, 0.0, 0.0, 0.0), "")
    rate: float = param(25.0, "1/s", above=0.0, high=120.0)
    encoding: str = param("bayer_rggb8", choices=("bayer_rggb8", "bgr8", "mono8"))

    def model(self) -> CameraModel:
        """Returns the camera's intrinsic parameters."""
        focal = self.width / 2.0 / math.tan(math.radians(self.horizontal_fov) / 2.0)
        ideal = CameraModel.ideal(self.width, self.image_height, focal)
        return CameraModel(self.width, self.image_height, ideal.matrix, np.array(self.distortion))

    def pose(self) -> np.ndarray:
        """Returns the camera's true pose, T_map_optical, 4x4."""
        # the body faces +x; with the additional quarter turn, the map is upright in the image at yaw 0
        yaw = math.radians(self.yaw) + math.pi / 2.0
        body = geometry.rotation_from_rpy(0.0, math.radians(self.pitch), yaw)
        return geometry.make_transform(body @ geometry.optical_rotation(), (self.x, self.y, self.height))


@dataclass(frozen=True)
class Robot(Parameters):
    """A robot like a TurtleBot, with a camera at its front. The camera's values are assumptions."""

    name: str = param("robot")
    namespace: str = param("")
    start: Tuple[float, float, float] = param((0.0, 0.0, 0.0), "m, m, deg")
    radius: float = param(0.18, "m", above=0.0)
    camera_x: float = param(0.10, "m")
    camera_height: float = param(0.45, "m", above=0.05)
    camera_pitch: float = param(30.0, "deg", low=0.0, high=89.0)

    def start_pose(self) -> Tuple[float, float, float]:
        """Returns the start pose (x, y, yaw) [m, m, rad]."""
        return self.start[0], self.start[1], math.radians(self.start[2])

    def color_model(self) -> CameraModel:
        """Returns the model of the colour camera, 640 x 480 px (paper)."""
        return CameraModel.ideal(640, 480, 320.0 / math.tan(math.radians(CAMERA_FOV) / 2.0))

    def depth_model(self) -> CameraModel:
        """Returns the model of the depth camera, 160 x 120 px (paper), registered to the colour image."""
        return self.color_model().scaled_to(160, 120)

    def camera_mount(self) -> np.ndarray:
        """Returns T_base_optical, 4x4."""
        body = geometry.rotation_from_rpy(0.0, math.radians(self.camera_pitch), 0.0)
        return geometry.make_transform(body @ geometry.optical_rotation(), (self.camera_x, 0.0, self.camera_height))


@dataclass(frozen=True)
class DetourQuery(Parameters):
    """Start and goal of a path through the region, whose detour shows that the border takes effect."""

    start: Tuple[float, float, float] = param((0.0, 0.0, 0.0), "m, m, deg")
    goal: Tuple[float, float, float] = param((1.0, 0.0, 0.0), "m, m, deg")


@dataclass(frozen=True)
class Scenario(Parameters):
    """A participant's task. Its points are converted to arrays."""

    key: str = param("")  # the task's name in the file
    title: str = param("")
    closed: bool = param(False)  # whether the border is a polygon
    border: np.ndarray = param(None, "m")  # (N, 2) the polygonal chain to draw
    seed: np.ndarray = param(None, "m")  # (2,) the seed point
    region: np.ndarray = param(None, "m")  # (M, 2) outline of the ground truth
    stand: np.ndarray = param(None, "m")  # (2,) the person's position while drawing
    guide: np.ndarray = param(
        None, "m"
    )  # (K, 2) the path along which a person without ceiling cameras guides the robot
    proof: DetourQuery = param(DetourQuery())  # the path that is planned without and with the border

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, min_points in (("border", 2), ("seed", 1), ("region", 3), ("stand", 1), ("guide", 0)):
            points = _read_points(getattr(self, name), name, min_points)
            object.__setattr__(self, name, points[0] if name in ("seed", "stand") else points)
        if not Polygon(self.region).is_valid:
            raise ParameterError("region", "the outline crosses itself")


@dataclass(frozen=True)
class World(Parameters):
    """The content of a world file."""

    name: str = param("world")
    room: Room = param(Room())
    floor: Floor = param(Floor())
    walls: Tuple[Wall, ...] = param((), of=Wall)
    furniture: Tuple[Furniture, ...] = param((), of=Furniture)
    patches: Tuple[FloorPatch, ...] = param((), of=FloorPatch)
    lights: Tuple[Light, ...] = param((), of=Light)
    cameras: Tuple[CeilingCamera, ...] = param((), of=CeilingCamera)
    robots: Tuple[Robot, ...] = param((), of=Robot)
    scenarios: Dict[str, Scenario] = param({})

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.robots:
            raise ParameterError("robots", "a world needs at least one robot")
        for kind, items in (("cameras", self.cameras), ("robots", self.robots)):
            for name, count in Counter(item.name for item in items).items():
                if count > 1:
                    raise ParameterError(kind, f"the name '{name}' is used twice")
        documents = {str(key): document for key, document in self.scenarios.items()}
        scenarios = {key: _read_scenario(key, document) for key, document in documents.items()}
        object.__setattr__(self, "scenarios", scenarios)

    def scenario(self, key: str) -> Scenario:
        """Returns the scenario with a key.

        Raises:
            ParameterError: lists the known keys; `camera` and `robot` raise it too.
        """
        return self._find("scenario", key, self.scenarios)

    def camera(self, name: str) -> CeilingCamera:
        """Returns the ceiling camera with a name."""
        return self._find("camera", name, {camera.name: camera for camera in self.cameras})

    def robot(self, name: str) -> Robot:
        """Returns the robot with a name."""
        return self._find("robot", name, {robot.name: robot for robot in self.robots})

    def _find(self, kind: str, name: str, items: Mapping[str, Any]) -> Any:
        if name not in items:
            raise ParameterError(kind, f"'{name}' is not in world '{self.name}'; known are {', '.join(items)}")
        return items[name]

    def robot_radii(self) -> Dict[str, float]:
        """Returns the radius [m] of each robot, by its name and by its namespace, which precedes its topics."""
        radii = {robot.namespace.strip("/"): robot.radius for robot in self.robots}
        radii.update({robot.name: robot.radius for robot in self.robots})
        return radii


def _rectangle(x: float, y: float, size: Tuple[float, float], yaw_deg: float) -> np.ndarray:
    hx, hy = size[0] / 2.0, size[1] / 2.0
    corners = np.array([[-hx, -hy], [hx, -hy], [hx, hy], [-hx, hy]])
    return base_to_map(corners, (x, y, math.radians(yaw_deg)))


def load_world(path: str) -> World:
    """Reads a world file. With the key `like`, it extends another file in the same folder.

    Raises:
        CodedError: "no_world" if there is no such file, "bad_world" if it is not YAML.
        ParameterError: names the wrong key, or says that the path is empty.
    """
    if not path:
        raise ParameterError("world", "must be set: the path of a world's file")
    file = Path(path)
    document = read_document(file, "world")
    if isinstance(document, Mapping) and "like" in document:
        overrides = dict(document)
        base = read_document(file.parent / str(overrides.pop("like")), "world")
        document = {**base, **overrides} if isinstance(base, Mapping) else base
    return world_from_mapping(document, file.stem)


def world_from_mapping(document: Any, default_name: str = "world") -> World:
    """Creates a world from a YAML document.

    Raises:
        ParameterError: names the wrong key.
    """
    if not isinstance(document, Mapping):
        raise ParameterError("world", "expected keys and values at the top of the file")
    # a key without a value counts as absent
    values = {key: value for key, value in document.items() if value is not None}
    return World.from_mapping({"name": default_name, **values})


def _read_points(value: Any, key: str, min_points: int = 1) -> np.ndarray:
    try:
        points = np.array(value, dtype=float).reshape(-1, 2)
    except (TypeError, ValueError):
        points = np.zeros((0, 2))
    if len(points) < min_points or not np.isfinite(points).all():
        raise ParameterError(key, f"expected at least {min_points} point(s) [x, y], got {value!r}")
    return points


def _read_scenario(key: str, document: Any) -> Scenario:
    if isinstance(document, Scenario):
        return document
    scenario = Scenario.from_mapping(document, f"scenarios/{key}")
    return scenario.replace(key=key, title=scenario.title or key)
