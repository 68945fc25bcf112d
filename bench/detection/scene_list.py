"""Lists the hard cases for a spot detector, with and without a laser, as scenes of scene_rendering.py."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Callable, List, Tuple

import numpy as np

from bench.detection.scene_disturbances import Glint, SceneConditions
from bench.detection.scene_motions import DARK, MAROON, WHITE, ScenePoint, Walk
from bench.detection.scene_motions import alternate, conditions_with_people, motion_along, motion_at
from bench.detection.scene_rendering import Scene, lab, tiles, with_camera, with_dots
from vb_sim.world import Light, World

RED, GREEN, PAPER = (235, 30, 40), (40, 230, 60), (250, 250, 250)  # paint
CARPET = np.array([[3.12, 0.8], [5.12, 0.8], [5.12, 2.05], [3.12, 2.05]])
START = (6.9, 1.0, math.pi)  # of the robot, which faces the free floor beside the carpet


def ceiling_scenes(room: World) -> List[Scene]:
    """Lists the hard cases for a ceiling camera."""
    border, conditions = motion_along(CARPET, 0.4), SceneConditions
    chair = next(thing for thing in room.furniture if thing.name == "chair")
    moved_chair = replace(chair, x=3.6, y=3.2, yaw=30.0)
    moved = lab(furniture=tuple(moved_chair if thing is chair else thing for thing in room.furniture))
    places = ((3.5, 2.4), (4.6, 2.3), (5.3, 1.2))
    dotted, whites = with_dots(room, places, (RED, GREEN, RED)), with_dots(room, places, (PAPER,) * 3)
    walkers = [Walk(room, 3, WHITE, DARK), Walk(room, 4, MAROON, WHITE)]
    shiny = [Walk(room, 5, DARK, DARK, glint=400.0), Walk(room, 6, (70, 90, 150), DARK, glint=250.0)]
    lamp = conditions(glints=(Glint((3.7, 2.3, 0.0), 0.03, 350.0),))
    dim = conditions(light=0.4)
    floors = {"bright": ((195, 192, 186), 0.06), "overexposed": ((228, 226, 220), 0.06)}
    floors.update({"dark": ((38, 34, 32), 0.2), "black": ((16, 15, 15), 0.2)})

    def sun(t: float) -> SceneConditions:
        edge = 2.9 + 0.05 * t
        return conditions(sun=((edge, 1.0), (edge + 1.2, 1.1), (edge + 1.3, 2.3), (edge + 0.1, 2.2)))

    exposures = alternate(3.0, conditions(), conditions(exposure=1.5), conditions(exposure=0.7))
    scenes = [
        Scene("nothing else", border, (room,)),
        Scene("moved chair", border, (room, moved), alternate(4.0, 0, 1), conditions_with_people(walkers[0])),
        Scene("light switched", border, (room,), conditions_at=alternate(3.0, conditions(), dim)),
        Scene("exposure step", border, (room,), conditions_at=exposures),
        Scene("sun patch, moving edge", border, (room,), conditions_at=sun),
        Scene("walking people", border, (room,), conditions_at=conditions_with_people(*walkers)),
        Scene("printed dots, always there", border, (dotted,)),
        Scene("printed dots, laid down and taken away", border, (room, dotted), alternate(4.0, 1, 0)),
        Scene("white dots, laid down and taken away", border, (room, whites), alternate(4.0, 1, 0)),
        Scene("shiny shoes", border, (room,), conditions_at=conditions_with_people(*shiny)),
        Scene("lamp's reflection, comes and goes", border, (room,), conditions_at=alternate(1.5, conditions(), lamp)),
        Scene("held still", motion_at(3.6, 2.2), (room,)),
        Scene("held in a hand", motion_at(3.6, 2.2, 0.007), (room,)),
    ]
    scenes += [Scene(f"drawn at {speed} m/s", motion_along(CARPET, speed), (room,)) for speed in (0.2, 0.5, 1.0, 1.5)]
    for name, appearance in floors.items():
        world = tiles(room, *appearance)
        scenes += [Scene(f"{name} floor, {color}", border, (world,), color=color) for color in ("red", "green")]
    camera_changes = {f"camera {height} m high": {"height": height} for height in (2.2, 4.0)}
    camera_changes.update({f"{encoding} images": {"encoding": encoding} for encoding in ("bgr8", "mono8")})
    camera_changes["strong distortion"] = {"distortion": (-0.28, 0.08, 0.0, 0.0, 0.0)}
    return scenes + [Scene(name, border, (with_camera(room, **changes),)) for name, changes in camera_changes.items()]


def training_scenes(room: World) -> List[Scene]:
    """Lists scenes for training only: printed dots of other colours and sizes on other floors, under both cameras.

    The dots of the other scenes remain unseen, and so they test whether the detector distinguishes paint from light.
    """
    colors = ((40, 60, 220), (240, 220, 40), (240, 120, 200), (250, 130, 30), (30, 200, 210))
    ceiling = ((3.3, 2.3), (4.4, 2.5), (5.2, 1.6), (3.9, 1.4), (4.8, 1.1))
    ahead = ((5.9, 1.2), (5.6, 0.8), (5.3, 1.1), (5.7, 1.0), (5.5, 1.3))
    gray, pale = room.floor, replace(room.floor, kind="tiles", color=(170, 165, 155))
    brown = replace(room.floor, kind="tiles", color=(120, 85, 60))
    scenes = []
    for name, floor, size in (("grey", gray, 0.012), ("pale", pale, 0.025), ("brown", brown, 0.018)):
        bare = lab(floor=floor, patches=())
        for mobile, places, laser in ((False, ceiling, motion_at(4.0, 3.0)), (True, ahead, motion_at(5.8, 0.9))):
            worlds = bare, with_dots(bare, places, colors, size)
            # dots appear twice in the time used for training; the robot stands still, so that they are new to it
            more = {"mobile": mobile, "person": False, "robot_at": lambda t: START}
            scenes.append(Scene(f"dots on a {name} floor", laser, worlds, alternate(1.0, 1, 0), **more))
    return scenes


def mobile_scenes(room: World) -> List[Scene]:
    """Lists the scenes for the robot's camera: distances, motion, and objects that resemble spots."""
    dark = lab(floor=replace(room.floor, color=(38, 34, 32)), patches=())
    bright = lab(floor=replace(room.floor, kind="tiles", color=(195, 192, 186), contrast=0.06), patches=())
    dotted = with_dots(room, ((5.9, 1.2), (5.6, 0.8), (5.3, 1.1)), (RED, GREEN, PAPER))
    lamp = (Light.from_mapping({"name": "lamp", "x": 5.7, "y": 1.25, "radius": 0.05, "brightness": 220.0}),)
    people = Walk(room, 8, WHITE, WHITE), Walk(room, 9, DARK, DARK, glint=400.0)
    line = np.array([[5.6, 0.7], [5.6, 1.3]])

    def ahead(distance: float) -> Callable[[float], ScenePoint]:
        """Returns a motion back and forth across the view at about 0.2 m/s, at a distance [m] from the camera."""
        return lambda t: (START[0] - 0.1 - distance, START[1] + 0.15 * math.sin(1.3 * t))

    def drive(t: float) -> Tuple[float, float, float]:
        return (START[0] - 0.2 * max(0.0, t - 2.0) % 0.8, *START[1:])

    def turn(t: float) -> Tuple[float, float, float]:
        return (*START[:2], START[2] + 0.35 * math.sin(1.4 * t))

    def scene(name: str, laser: Callable[[float], ScenePoint] = ahead(1.2), world: World = room, **more: Any) -> Scene:
        return Scene(name, laser, (world,), mobile=True, **{"robot_at": lambda t: START, "person": False, **more})

    colors, switched = ("red", "green"), alternate(3.0, SceneConditions(), SceneConditions(light=0.4))
    return [
        *(scene(f"{m} m, {color}", ahead(m), color=color) for m in (0.5, 1.0, 1.5, 2.0, 2.5) for color in colors),
        *(scene(f"drawn at {speed} m/s, 1.2 m", motion_along(line, speed, False)) for speed in (0.5, 1.0)),
        scene("robot drives", ahead(1.6), robot_at=drive),
        scene("robot turns", ahead(1.4), robot_at=turn),
        *(scene(f"bright floor, {color}", world=bright, color=color) for color in colors),
        *(scene(f"dark floor, {color}", world=dark, color=color) for color in colors),
        scene("printed dots", world=dotted, robot_at=turn),
        scene("lamp's reflection", world=lab(lights=lamp), robot_at=turn),
        scene("walking people, shiny shoes", conditions_at=conditions_with_people(*people)),
        scene("light switched", conditions_at=switched),
    ]
