"""Motions of spots and people in rendered scenes, as functions of time [s]."""

from __future__ import annotations

import math
from typing import Any, Callable, Tuple

import numpy as np

from bench.detection.scene_disturbances import Bystander, Glint, SceneConditions
from vb_core.geometry import arc_lengths
from vb_sim.floor_plan import physical_map
from vb_sim.simulated_lab import DistanceField
from vb_sim.world import World

WHITE, DARK, MAROON = (238, 236, 230), (40, 40, 44), (150, 40, 40)  # clothes
WALK_S = 60.0  # [s] for which people walk
ScenePoint = Tuple[float, float]  # (x, y) [m]


def motion_along(chain: np.ndarray, speed: float, closed: bool = True) -> Callable[[float], ScenePoint]:
    """Returns a spot's motion round a chain (N, 2) [m], or back and forth, at a speed [m/s], with a tremor of 1 cm."""
    points = np.vstack([chain, chain[:1] if closed else chain[-2::-1]])
    arc = arc_lengths(points)

    def at(t: float) -> ScenePoint:
        position = (speed * t) % arc[-1]
        x, y = [np.interp(position, arc, axis) for axis in points.T]
        return float(x) + 0.007 * math.sin(9.0 * t), float(y) + 0.007 * math.sin(11.0 * t + 1.0)

    return at


def motion_at(x: float, y: float, tremor: float = 0.0) -> Callable[[float], ScenePoint]:
    """Returns the motion of a spot held at one point, with a tremor [m]."""
    return lambda t: (x + tremor * math.sin(5.0 * t), y + tremor * math.sin(7.3 * t + 0.5))


class Walk:
    """A person who walks between random points at 1 m/s on free floor.

    Args:
        glint: [grey levels] brightness of the reflection on the right shoe; 0 for none.
    """

    def __init__(self, world: World, seed: int, shirt: Any = DARK, shoes: Any = DARK, glint: float = 0.0) -> None:
        self._shirt, self._shoes, self._glint = tuple(shirt), tuple(shoes), glint
        clearance = DistanceField(physical_map(world)).clearance
        random = np.random.default_rng(seed)

        def is_free(points: np.ndarray) -> bool:
            return all(clearance(*point) > 0.25 for point in points)

        def place() -> np.ndarray:
            while True:
                point = random.uniform((0.3, 0.3), np.array(world.room.size) - 0.3)
                if is_free(point[None]):
                    return point

        stations = [place()]
        while len(stations) < 2 + WALK_S / 1.2:
            point = place()
            way = stations[-1] + np.linspace(0, 1, 20)[:, None] * (point - stations[-1])
            if is_free(way):
                stations.append(point)
        self._stations = np.array(stations)
        self._arc = arc_lengths(self._stations)

    def at(self, t: float) -> Tuple[Bystander, Tuple[Glint, ...]]:
        """Returns the person, and the reflections on the shoes, at time `t` [s]."""
        way = min(t, self._arc[-1] - 1e-6)  # [m] at 1 m/s
        leg = int(np.searchsorted(self._arc, way, side="right")) - 1
        a, b = self._stations[leg], self._stations[leg + 1]
        share = (way - self._arc[leg]) / (self._arc[leg + 1] - self._arc[leg])
        x, y = a + share * (b - a)
        yaw = math.atan2(b[1] - a[1], b[0] - a[0])
        person = Bystander((float(x), float(y), yaw), self._shirt, self._shoes)
        # a shoe reflects into the camera during a part of each step
        if not self._glint or (1.8 * t) % 1.0 > 0.4:
            return person, ()
        c, s = math.cos(yaw), math.sin(yaw)
        toe = (x + 0.15 * c + 0.1 * s, y + 0.15 * s - 0.1 * c, 0.07)
        return person, (Glint(toe, 0.012, self._glint),)


def conditions_with_people(*walks: Walk) -> Callable[[float], SceneConditions]:
    """Returns a function of time [s] that gives the conditions while several people walk."""

    def at(t: float) -> SceneConditions:
        people, glints = zip(*(walk.at(t) for walk in walks))
        return SceneConditions(bystanders=people, glints=sum(glints, ()))

    return at


def alternate(period: float, *values: Any) -> Callable[[float], Any]:
    """Returns a function of time [s] that gives one value after another, each for a period [s]."""
    return lambda t: values[int(t / period) % len(values)]


def place_and_velocity(laser_at: Callable[[float], ScenePoint], t: float) -> Tuple[ScenePoint, Tuple[float, float]]:
    """Returns a spot's position [m] and velocity [m/s] at time `t` [s]."""
    (x, y), (later_x, later_y) = laser_at(t), laser_at(t + 0.01)
    return (x, y), ((later_x - x) / 0.01, (later_y - y) / 0.01)
