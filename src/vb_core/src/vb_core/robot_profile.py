"""A robot type's profile: shape, limits, sensors, topics and frames.

Every program that needs to know something about a robot reads it from the same file (robots/<type>.yaml), so that
another robot needs only another file.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import yaml

from vb_core.errors import CodedError, ParameterError
from vb_core.parameters import Parameters, param


@dataclass(frozen=True)
class RobotShape(Parameters):
    """An upright cylinder about base_link."""

    radius: float = param(0.18, "m", above=0.0, high=2.0)
    height: float = param(0.45, "m", above=0.0, high=3.0, doc="including everything mounted on it")


@dataclass(frozen=True)
class Limits(Parameters):
    """Limits of the base: what it can do, and what it is allowed to do."""

    max_speed: float = param(0.5, "m/s", above=0.0, high=3.0, doc="whatever drives it")
    max_turn_rate: float = param(1.0, "rad/s", above=0.0, high=6.0)
    acceleration: float = param(1.0, "m/s^2", above=0.0, high=10.0)
    turn_acceleration: float = param(3.2, "rad/s^2", above=0.0, high=20.0)
    deceleration: float = param(1.5, "m/s^2", above=0.0, high=10.0, doc="when it must stop")
    reaction_time: float = param(0.15, "s", low=0.0, high=2.0, doc="from a scan to the wheels")


@dataclass(frozen=True)
class Scanner(Parameters):
    """The laser scanner, or a depth camera used as one. Its coverage is read from its messages."""

    topic: str = param("scan")
    present: bool = param(True, doc="false: the robot is driven by its map alone, and slowly")
    no_return: str = param(
        "inf", choices=("inf", "zero", "nan"), doc="the range of a beam without a return; inf always counts as one"
    )
    obstacle_range: float = param(2.5, "m", above=0.0, doc="up to here navigation marks obstacles")


BASE_KINDS = {
    "differential": "",
    "car": "cannot turn on the spot, which the driver makes it do",
    "omnidirectional": "moves sideways, where the driver checks nothing",
}


@dataclass(frozen=True)
class Base(Parameters):
    """The robot's base. The driver checks that only itself and trusted nodes can command it."""

    kind: str = param("differential", choices=tuple(BASE_KINDS), doc="how it moves; only differential is supported")
    topic: str = param("cmd_vel", doc="topic of the driver's commands: the base's own, or an input of its mux")
    output: str = param("", doc="behind a mux: the topic on which the mux commands the base; empty: no mux")
    trusted: tuple = param((), doc="nodes that may command the base too, for instance a bumper's reflex")

    def __post_init__(self) -> None:
        super().__post_init__()
        if BASE_KINDS[self.kind]:
            raise ParameterError("kind", f"this robot is not supported: it {BASE_KINDS[self.kind]}")


@dataclass(frozen=True)
class OnboardCamera(Parameters):
    """The robot's camera. Its lens is described by camera_info, its mount by tf."""

    info: str = param("camera/rgb/camera_info")
    max_range: float = param(3.0, "m", above=0.0, doc="farther away, a spot is too small to be detected")


@dataclass(frozen=True)
class Contact(Parameters):
    """Bumpers, cliff sensors or wheel drop sensors: a field of a message, and which of its values mean danger."""

    topic: str = param("")
    type: str = param("", doc="for instance kobuki_msgs/BumperEvent")
    field: str = param("state")
    clear: int = param(0, doc="the value that means no contact; every other value counts as contact")
    sensor: str = param("", doc="field that names the sensor a message is from; empty: a message describes all sensors")
    blocks: str = param("forward", choices=("forward", "all"), doc="motion that contact blocks: forward only, or all")


@dataclass(frozen=True)
class Frames(Parameters):
    """Names of frames, without the robot's prefix."""

    base: str = param("base_link")
    odom: str = param("odom")


@dataclass(frozen=True)
class RobotProfile(Parameters):
    """One robot type."""

    model: str = param("")
    shape: RobotShape = param(RobotShape())
    limits: Limits = param(Limits())
    base: Base = param(Base())
    scanner: Scanner = param(Scanner())
    camera: OnboardCamera = param(OnboardCamera())
    frames: Frames = param(Frames())
    contacts: tuple = param((), of=Contact)

    @property
    def radius(self) -> float:
        """Radius of its shape [m]."""
        return self.shape.radius

    @classmethod
    def load(cls, path: Path) -> "RobotProfile":
        """Reads a profile from a file. Raises ParameterError if it is unreadable, is not YAML, or as `from_mapping`."""
        try:
            document = yaml.safe_load(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise ParameterError(path.name, f"cannot read {path}: {error.strerror}") from None
        except (yaml.YAMLError, ValueError, RecursionError):  # a date that does not exist is a ValueError
            raise ParameterError(path.name, f"{path} is not a YAML file") from None
        return cls.from_mapping(document, path.name)


def find_profile(robot: str, folder: Path) -> Path:
    """Returns the file of a robot type. Raises CodedError "unknown_robot_type" if the folder has none."""
    known_types = sorted(path.stem for path in folder.glob("*.yaml"))
    if robot not in known_types:
        raise CodedError("unknown_robot_type", robot=robot, known=", ".join(known_types))
    return folder / f"{robot}.yaml"
