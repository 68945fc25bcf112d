"""Rooms of rendered scenes, which are variants of the simulated lab."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, List, Sequence, Tuple

from bench.detection.scene_disturbances import with_disturbances
from bench.detection.scene_motions import ScenePoint
from bench.harness import TOP
from vb_sim.rendering.ceiling_view import CeilingView
from vb_sim.rendering.robot_view import RobotView
from vb_sim.model_params import Models
from vb_sim.rendering.floor_texture import FloorTexture, render_floor
from vb_sim.rendering.mesh import world_mesh
from vb_sim.world import FloorPatch, World, load_world


def lab(**changes: Any) -> World:
    """Returns the lab with these changes."""
    return replace(load_world(str(TOP / "src/vb_sim/worlds/lab.yaml")), **changes)


def tiles(room: World, color: Sequence[int], contrast: float = 0.06) -> World:
    """Returns the lab with another, empty floor."""
    return lab(floor=replace(room.floor, kind="tiles", color=color, contrast=contrast), patches=(), lights=())


def with_camera(world: World, **changes: Any) -> World:
    """Returns the world with changes to the ceiling camera that the scenes use."""
    cameras = [replace(camera, **changes) if camera.name == "green" else camera for camera in world.cameras]
    return replace(world, cameras=tuple(cameras))


def with_dots(
    world: World, places: Sequence[ScenePoint], colors: Sequence[Sequence[int]], size: float = 0.018
) -> World:
    """Returns a world with printed dots of a size [m] on the floor."""
    dots = (
        {"name": "dot", "x": x, "y": y, "size": [size, size], "color": list(color), "contrast": 0.0}
        for (x, y), color in zip(places, colors)
    )
    return replace(world, patches=world.patches + tuple(map(FloorPatch.from_mapping, dots)))


class Rooms:
    """Draws each room once, since most scenes share a room."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self._views: List[Tuple[World, str, Any]] = []
        self._floors: List[Tuple[World, FloorTexture]] = []

    def view(self, world: World, camera: str) -> Any:
        """Returns a ceiling camera's view, or the robot camera's if the name is empty."""
        for cached, name, view in self._views:
            if cached is world and name == camera:
                return view
        floor = next((floor for cached, floor in self._floors if _same_floor(cached, world)), None)
        if floor is None:
            floor = render_floor(world, self.seed)
            self._floors.append((world, floor))
        mesh, radii = world_mesh(world), world.robot_radii()
        kind, device = (CeilingView, world.camera(camera)) if camera else (RobotView, world.robots[0])
        view = with_disturbances(kind)(device, radii, floor, mesh, Models(), self.seed)
        self._views.append((world, camera, view))
        return view


def _same_floor(a: World, b: World) -> bool:
    return all(getattr(a, part) == getattr(b, part) for part in "room floor walls furniture patches lights".split())
