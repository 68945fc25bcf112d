"""Builds people and robots from rounded pieces. A person's dimensions are assumptions for a height of 1.75 m."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Optional, Sequence, Tuple

import numpy as np

from vb_core.camera_model import CameraModel
from vb_core.geometry import Pose, invert_transform, transform_from_pose2d, transform_points
from vb_sim.model_params import BodyProportions
from vb_sim.world import Point2

_NEAR = 0.15  # [m] along the optical axis; nearer pieces are not drawn
_ANGLES = np.linspace(0.0, 2.0 * math.pi, 16, endpoint=False)
UNIT_CIRCLE = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])

SHIRT, TROUSERS, SKIN, HAIR, SHOES = (78, 118, 112), (48, 54, 78), (206, 162, 134), (72, 54, 42), (38, 36, 38)

AVERAGE = BodyProportions()


@dataclass(frozen=True)
class BodyParts:
    """Pieces of a body, each the convex hull of a low and a high flat ellipse."""

    low: np.ndarray  # (N, 3) [m] centres, map frame
    high: np.ndarray
    low_radii: np.ndarray  # (N, 2) [m] semi-axes along and across the heading
    high_radii: np.ndarray
    yaws: np.ndarray  # (N,) [rad] headings
    colors: np.ndarray  # (N, 3) rgb

    def __len__(self) -> int:
        return len(self.yaws)

    def move_to(self, x: float, y: float, yaw: float) -> "BodyParts":
        """Returns the pieces of a body at the origin moved to a pose [m, m, rad]."""
        T = transform_from_pose2d(x, y, yaw)
        low = transform_points(T, self.low)
        high = transform_points(T, self.high)
        return replace(self, low=low, high=high, yaws=np.full(len(self), yaw))

    def scale_to(self, center: Point2, proportions: BodyProportions) -> "BodyParts":
        """Returns an average person's pieces scaled to other proportions, about `center` (x, y) [m]."""
        scale = np.array([proportions.breadth, proportions.breadth, proportions.height / AVERAGE.height])
        origin = np.array([*center, 0.0])
        return replace(
            self,
            low=origin + (self.low - origin) * scale,
            high=origin + (self.high - origin) * scale,
            low_radii=self.low_radii * proportions.breadth,
            high_radii=self.high_radii * proportions.breadth,
        )


def join_pieces(parts: Sequence[BodyParts]) -> BodyParts:
    """Joins the pieces of several bodies."""
    columns = zip(*(vars(part).values() for part in parts))
    return BodyParts(*map(np.concatenate, columns))


def piece_outlines(pieces: BodyParts) -> np.ndarray:
    """Returns 32 points (N, 32, 3) [m] on the two ellipses of each piece."""
    c = np.cos(pieces.yaws)[:, None]
    s = np.sin(pieces.yaws)[:, None]
    circle_x, circle_y = UNIT_CIRCLE.T
    ends = []
    for centers, radii in ((pieces.low, pieces.low_radii), (pieces.high, pieces.high_radii)):
        along = circle_x * radii[:, :1]
        across = circle_y * radii[:, 1:]
        x = c * along - s * across
        y = s * along + c * across
        offsets = np.stack([x, y, np.zeros(along.shape)], axis=2)
        ends.append(centers[:, None, :] + offsets)
    return np.concatenate(ends, axis=1)


def _make_parts(rows: Sequence[Tuple]) -> BodyParts:
    """Converts rows (forward, left, z low, z high, radii low, radii high, colour) to pieces."""
    x, y, low, high, *radii, colors = (np.array(column, dtype=float) for column in zip(*rows))
    low_centers = np.column_stack([x, y, low])
    high_centers = np.column_stack([x, y, high])
    return BodyParts(low_centers, high_centers, *radii, np.zeros(len(x)), colors)


def _tint(color: Tuple[int, int, int], brightness: float) -> Tuple[int, ...]:
    return tuple(int(value * brightness) for value in color)


# from the feet to the hair, without the right arm, which moves
_PERSON = _make_parts(
    [
        *(
            row
            for left in (0.10, -0.10)
            for row in (
                (0.06, left, 0.0, 0.07, (0.14, 0.05), (0.11, 0.045), SHOES),
                (0.0, left, 0.05, 0.45, (0.055, 0.055), (0.07, 0.07), TROUSERS),
                (0.0, left, 0.45, 0.85, (0.07, 0.07), (0.09, 0.09), TROUSERS),
            )
        ),
        (0.0, 0.0, 0.82, 1.0, (0.12, 0.18), (0.11, 0.17), TROUSERS),
        (0.0, 0.0, 0.98, 1.2, (0.115, 0.17), (0.125, 0.19), SHIRT),
        (0.0, 0.0, 1.2, 1.38, (0.125, 0.19), (0.115, 0.22), SHIRT),
        (0.0, 0.0, 1.38, 1.46, (0.11, 0.22), (0.06, 0.12), _tint(SHIRT, 1.12)),
        # the left arm hangs
        (0.0, 0.235, 1.1, 1.4, (0.05, 0.05), (0.055, 0.055), _tint(SHIRT, 0.9)),
        (0.03, 0.245, 0.82, 1.1, (0.045, 0.035), (0.045, 0.045), SKIN),
        (0.0, 0.0, 1.44, 1.53, (0.055, 0.055), (0.055, 0.055), SKIN),
        (0.015, 0.0, 1.53, 1.62, (0.075, 0.065), (0.098, 0.078), SKIN),
        (0.0, 0.0, 1.60, 1.69, (0.10, 0.08), (0.095, 0.078), HAIR),
        (-0.01, 0.0, 1.69, 1.75, (0.095, 0.078), (0.045, 0.04), HAIR),
    ]
)
# of three pieces: the upper arm, the forearm, and the pointer in the hand
_ARM_LOW_RADII = np.array([(0.055, 0.055), (0.045, 0.045), (0.014, 0.014)])
_ARM_HIGH_RADII = np.array([(0.046, 0.046), (0.035, 0.035), (0.01, 0.01)])
_ARM_COLORS = np.array([_tint(SHIRT, 1.05), SKIN, (30, 30, 32)], dtype=float)


def hand_position(person: Pose, target: Optional[Point2], height: float) -> np.ndarray:
    """Returns the position (3,) [m] of the right hand, which holds the pointer at a height [m]."""
    x, y, yaw = person
    shoulder_x = x + 0.20 * math.sin(yaw)
    shoulder_y = y - 0.20 * math.cos(yaw)
    along_x, along_y = math.cos(yaw), math.sin(yaw)
    if target is not None:
        to_x, to_y = target[0] - shoulder_x, target[1] - shoulder_y
        distance = math.hypot(to_x, to_y)
        if distance > 0.05:
            along_x, along_y = to_x / distance, to_y / distance
    return np.array([shoulder_x + 0.42 * along_x, shoulder_y + 0.42 * along_y, height])


def person_pieces(
    person: Pose, target: Optional[Point2], hand_height: float, proportions: BodyProportions = AVERAGE
) -> BodyParts:
    """Builds a standing person with the right arm raised towards a point on the floor, or hanging.

    Args:
        hand_height: [m] at which the person holds the pointer.
    """
    x, y, yaw = person
    c, s = math.cos(yaw), math.sin(yaw)
    tallness = proportions.height / AVERAGE.height
    side = 0.21 * proportions.breadth
    shoulder = np.array([x + side * s, y - side * c, 1.38 * tallness])
    if target is None:
        hand = np.array([shoulder[0] + 0.05 * c, shoulder[1] + 0.05 * s, 0.82 * tallness])
        joints = [shoulder, 0.5 * (shoulder + hand), hand]
    else:
        hand = hand_position(person, target, hand_height)
        elbow = 0.5 * (shoulder + hand) - (0.0, 0.0, 0.06)
        beam = np.array([*target, 0.0]) - hand
        tip = hand + beam / max(1e-6, float(np.linalg.norm(beam))) * 0.09
        joints = [shoulder, elbow, hand, tip]
    count = len(joints) - 1
    arm = BodyParts(
        low=np.array(joints[:-1]),
        high=np.array(joints[1:]),
        low_radii=proportions.breadth * _ARM_LOW_RADII[:count],
        high_radii=proportions.breadth * _ARM_HIGH_RADII[:count],
        yaws=np.full(count, yaw),
        colors=_ARM_COLORS[:count],
    )
    body = _PERSON.move_to(x, y, yaw)
    if proportions != AVERAGE:
        body = body.scale_to((x, y), proportions)
    return join_pieces([body, arm])


def person_key(person: Pose, target: Optional[Point2]) -> Tuple:
    """Returns a key that is the same for people who look the same to within some centimetres, to reuse images."""
    hand: Tuple = ()
    if target is not None:
        hand_x, hand_y, _ = hand_position(person, target, 0.0)
        hand = (round(hand_x / 0.04), round(hand_y / 0.04))
    x, y, yaw = person
    return (round(x / 0.006), round(y / 0.006), round(yaw / 0.03), hand)


def robot_key(pose: Pose) -> Tuple:
    """Returns a key that is the same for robots that look the same to within a few millimetres."""
    x, y, yaw = pose
    return (round(x / 0.003), round(y / 0.003), round(yaw / 0.02))


# a TurtleBot 2 with a round base, plates on poles, a camera at the front and a green button
_ROBOT_RADIUS = 0.18
_ROBOT = _make_parts(
    [
        (0.0, 0.0, 0.01, 0.10, (0.18, 0.18), (0.18, 0.18), (40, 40, 43)),
        (0.0, 0.0, 0.10, 0.115, (0.1728, 0.1728), (0.1728, 0.1728), (70, 70, 72)),
        *(
            (x, y, 0.11, 0.40, (0.008, 0.008), (0.008, 0.008), (150, 150, 152))
            for x in (0.099, -0.108)
            for y in (0.108, -0.108)
        ),
        *((0.0, 0.0, z, z + 0.008, (0.153, 0.153), (0.153, 0.153), (58, 56, 54)) for z in (0.19, 0.28)),
        (0.0, 0.0, 0.40, 0.41, (0.1584, 0.1584), (0.1584, 0.1584), (92, 88, 82)),
        (0.0, 0.0, 0.412, 0.414, (0.108, 0.108), (0.108, 0.108), (104, 100, 94)),
        (0.099, 0.0, 0.41, 0.45, (0.025, 0.09), (0.025, 0.09), (26, 26, 28)),
        (-0.063, 0.0, 0.414, 0.417, (0.035, 0.035), (0.03, 0.03), (120, 168, 96)),
    ]
)


def robot_pieces(pose: Pose, radius: float) -> BodyParts:
    """Builds a robot with a TurtleBot 2's proportions, scaled to a radius [m]."""
    scale = radius / _ROBOT_RADIUS
    parts = (_ROBOT.low, _ROBOT.high, _ROBOT.low_radii, _ROBOT.high_radii)
    return BodyParts(*(scale * part for part in parts), _ROBOT.yaws, _ROBOT.colors).move_to(*pose)


@dataclass(frozen=True)
class Outlines:
    """The outlines of pieces in a camera's image, the furthest first."""

    points: np.ndarray  # (N, 32, 2) [px]; each outline is the convex hull of its points
    depths: np.ndarray  # (N,) [m] of each piece's centre along the optical axis
    colors: np.ndarray  # (N, 3) rgb


def project_pieces(pieces: BodyParts, camera: CameraModel, T_map_optical: np.ndarray) -> Outlines:
    """Projects the pieces that are entirely before the camera and not far outside its image."""
    T = invert_transform(T_map_optical)
    points = transform_points(T, piece_outlines(pieces).reshape(-1, 3))
    pixels = camera.project(points).reshape(len(pieces), -1, 2)
    depths = points[:, 2].reshape(len(pieces), -1)
    # the distortion model is invalid far outside the image
    limit = 3.0 * max(camera.width, camera.height)
    with np.errstate(invalid="ignore"):
        usable = (depths.min(axis=1) > _NEAR) & (np.abs(pixels).max(axis=(1, 2)) < limit)
    center_depths = depths.mean(axis=1)
    order = np.argsort(-center_depths)
    order = order[usable[order]]
    return Outlines(pixels[order], center_depths[order], pieces.colors[order])
