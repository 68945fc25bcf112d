"""Curves over the surroundings: their values, and what changes in the configuration for each."""
from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any, Callable, Dict, Iterator, List, Mapping, Sequence, Tuple

import numpy as np

from vb_core import geometry
from vb_core.errors import CodedError, ParameterError
from vb_core.grid_map import FREE
from vb_evaluation.study.config import Study
from vb_sim.room import floor_plan
from vb_sim.robot.costmap import Costmap, CostmapParams
from vb_sim.robot.planner import Planner
from vb_sim.room.world import CeilingCamera, Scenario, World

# a person who guides a robot keeps off walls: it must still see the spot once that is around the corner
_LED = CostmapParams(inflation_radius=1.0, cost_scaling_factor=3.0)


@dataclass(frozen=True)
class Point:
    """One value of a sweep in one scenario.

    Attributes:
        value: what the curve is drawn over.
        changes: of the configuration.
        untouched: methods that these changes cannot concern: their runs are those of the study itself.
    """

    value: float
    changes: Mapping[str, Any]
    untouched: Tuple[str, ...] = ()


def points(study: Study, name: str, settings: Mapping[str, Any], scenario: str) -> Iterator[Point]:
    """The values of a sweep in a scenario.

    Raises:
        ParameterError: for a sweep that is unknown.
    """
    if name not in SWEEPS:
        raise ParameterError(f"curves/{name}", f"unknown sweep; known are {', '.join(SWEEPS)}")
    return SWEEPS[name](study, settings, scenario)


def coverage(study: Study, settings: Mapping[str, Any], scenario: str) -> Iterator[Point]:
    """Over the part of the free floor that ceiling cameras see; settings: `cameras`, lists of names or of cameras."""
    cameras = study.sources["world"]["cameras"]
    by_name = {camera["name"]: camera for camera in cameras}
    for chosen in settings["cameras"]:
        entries = [by_name[entry] if isinstance(entry, str) else {**cameras[0], **entry} for entry in chosen]
        world = study.changed({"world/cameras": entries}).world
        changes = {} if entries == cameras else {"world/cameras": entries}
        # the robot-only method does not depend on ceiling cameras
        yield Point(seen_share(world), changes, ("robot_only",))


def seen_share(world: World) -> float:
    """Share of a world's free floor in some ceiling camera's image; what furniture hides is not subtracted."""
    grid = floor_plan.physical_map(world)
    # every seventh cell is as good as all of them: to within half a percent
    cells = grid.cell_to_world(np.argwhere(grid.data == FREE)[::7])
    seen = np.zeros(len(cells), bool)
    for camera in world.cameras:
        seen |= _in_picture(camera, cells)
    return float(seen.mean())


def _in_picture(camera: CeilingCamera, points: np.ndarray) -> np.ndarray:
    in_camera = geometry.apply(geometry.invert(camera.pose()), np.column_stack([points, np.zeros(len(points))]))
    model = camera.model()
    # far off the axis the lens model means nothing
    near = (in_camera[:, 2] > 0.05) & (np.abs(in_camera[:, :2]).max(axis=1) < 2.0 * in_camera[:, 2])
    inside = np.zeros(len(points), bool)
    inside[near] = model.contains(model.project(in_camera[near]))
    return inside


def distance(study: Study, settings: Mapping[str, Any], scenario: str) -> Iterator[Point]:
    """Over the robot's shortest path to the border; settings: `starts`, poses [x, y, yaw] [m, m, deg]."""
    for start in settings["starts"]:
        way = _way_to_border(study.world, study.world.scenario(scenario), start[:2])
        changes: Dict[str, Any] = {}
        if list(start) != list(study.world.robots[0].start):
            # the path along which a person guides the robot belongs to its start
            led = _led_along(study.world, study.world.scenario(scenario), start[:2])
            changes = {"world/robots/0/start": list(start), f"world/scenarios/{scenario}/guide": led}
        yield Point(geometry.chain_length(way), changes)


def _way_to_border(
    world: World, scenario: Scenario, start: Sequence[float], costs: CostmapParams = CostmapParams()
) -> np.ndarray:
    """(N, 2) [m] the shortest path of a robot to a place from which it sees the nearest part of the border."""
    planner = Planner(Costmap(floor_plan.physical_map(world), costs))
    ways = []
    for place in geometry.resample_chain(scenario.border, 0.25, scenario.closed):
        try:
            ways.append(planner.plan(np.asarray(start, dtype=float), place, tolerance=0.6))
        except CodedError:
            continue
    if not ways:
        reason = f"no way leads from {list(start)} to the border of '{scenario.key}'"
        raise ParameterError("curves/distance/starts", reason)
    return min(ways, key=geometry.chain_length)


def _led_along(world: World, scenario: Scenario, start: Sequence[float]) -> List[List[float]]:
    """Places [m] about 1 m apart, along which a person leads a robot from its start.

    A closed border can be begun anywhere. Before an open one there is a place from which all of it is seen: the last
    of the scenario's own path.
    """
    if scenario.closed or not len(scenario.guide):
        way, shown = _way_to_border(world, scenario, start, _LED), []
    else:
        planner = Planner(Costmap(floor_plan.physical_map(world), _LED))
        way, shown = planner.plan(np.asarray(start, dtype=float), scenario.guide[-1]), [scenario.guide[-1]]
    places = geometry.resample_chain(way, 0.05)
    chosen = np.linspace(0, len(places) - 1, int(geometry.chain_length(way)) + 2)[1:-1]
    between = [places[int(round(index))] for index in chosen]
    return [[round(float(value), 3) for value in place] for place in (*between, *shown)]


def border_length(study: Study, settings: Mapping[str, Any], scenario: str) -> Iterator[Point]:
    """Over the border's length; settings: `factors`, and for each scenario in `about` the point that stays [x, y]."""
    entry = study.sources["world"]["scenarios"][scenario]
    about = np.array(settings["about"][scenario], dtype=float)
    for factor in settings["factors"]:
        changed = copy.deepcopy(entry)
        moved = {tuple(corner): np.round(about + factor * (np.array(corner) - about), 4).tolist() for corner in entry["border"]}
        changed["border"] = [moved[tuple(corner)] for corner in entry["border"]]
        # corners of the region that are the border's move with it; the room's do not
        changed["region"] = [moved.get(tuple(corner), corner) for corner in entry["region"]]
        changes = {} if factor == 1.0 else {f"world/scenarios/{scenario}": changed}
        length = geometry.chain_length(np.array(changed["border"], dtype=float), bool(entry["closed"]))
        yield Point(length, changes)


def robots(study: Study, settings: Mapping[str, Any], scenario: str) -> Iterator[Point]:
    """Over the number of robots; settings: `more`, the others' entries of the world. The baseline leads the first."""
    first = {**study.sources["world"]["robots"][0], "namespace": "robot1"}
    for count in range(len(settings["more"]) + 1):
        # among several each has a namespace, as in the live system
        changes = {"world/robots": [first, *settings["more"][:count]]} if count else {}
        yield Point(float(count + 1), changes, ("robot_only",))


SWEEPS: Dict[str, Callable[[Study, Mapping[str, Any], str], Iterator[Point]]] = {
    "coverage": coverage, "distance": distance, "border_length": border_length, "robots": robots}
