"""Curves over the surroundings, and sensitivity to what is assumed: which runs they consist of."""
from __future__ import annotations

import copy
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Mapping, Sequence, Tuple

import numpy as np

from vb_core import geometry
from vb_core.errors import CodedError, ParameterError
from vb_core.grid_map import FREE
from vb_evaluation.study.config import Study, top
from vb_evaluation.study.plan import CURVES, SENSITIVITY, Job
from vb_evaluation.study.registry import Registry
from vb_evaluation.study.runner import Task
from vb_sim import floor_plan
from vb_sim.costmap import Costmap, CostmapParams
from vb_sim.planner import Planner
from vb_sim.world import CeilingCamera, Scenario, World

sweeps: Registry[Callable[["Study", Mapping[str, Any], str], Iterator["Point"]]] = Registry("curves")

# who leads a robot gives walls a wide berth: it must still see the spot when that has gone round the corner
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


def curve_jobs(study: Study, participants: int, only: Sequence[str] = ()) -> List[Job]:
    """The runs of every sweep that the configuration has.

    Args:
        participants: so many at each point.
        only: names of sweeps; empty: all.
    """
    jobs = []
    for name, settings in (study.document.get("curves") or {}).items():
        if not isinstance(settings, Mapping) or (only and name not in only):
            continue
        for scenario in settings.get("scenarios", study.design.scenarios):
            for point in sweeps.get(name)(study, settings, scenario):
                conditions = {"sweep": name, "value": round(point.value, 3)}
                jobs += _jobs(study, CURVES, participants, scenario, point.changes, conditions, point.untouched)
    return jobs


def _jobs(
    study: Study, file: str, participants: int, scenario: str, changes: Mapping[str, Any], conditions: Mapping[str, Any],
    untouched: Sequence[str],
) -> List[Job]:
    return [
        Job(Task(participant, scenario, method), file, {} if method in untouched else changes, conditions)
        for participant in range(1, participants + 1) for method in study.design.methods
    ]


# ---------------------------------------------------------------- curves
@sweeps.register("coverage")
def coverage(study: Study, settings: Mapping[str, Any], scenario: str) -> Iterator[Point]:
    """Over the part of the free floor that ceiling cameras see; settings: `cameras`, lists of names or of cameras."""
    cameras = study.sources["world"]["cameras"]
    by_name = {camera["name"]: camera for camera in cameras}
    for chosen in settings["cameras"]:
        entries = [by_name[entry] if isinstance(entry, str) else {**cameras[0], **entry} for entry in chosen]
        world = study.changed({"world/cameras": entries}).world
        changes = {} if entries == cameras else {"world/cameras": entries}
        # who has nothing but the robot does not notice the ceiling
        yield Point(seen_share(world), changes, ("robot_only",))


def seen_share(world: World) -> float:
    """Share of a world's free floor in some ceiling camera's picture; what furniture hides is not taken off."""
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


@sweeps.register("distance")
def distance(study: Study, settings: Mapping[str, Any], scenario: str) -> Iterator[Point]:
    """Over the robot's shortest way to the border; settings: `starts`, poses [x, y, yaw] [m, m, deg]."""
    for start in settings["starts"]:
        way = _way_to_border(study.world, study.world.scenario(scenario), start[:2])
        changes: Dict[str, Any] = {}
        if list(start) != list(study.world.robots[0].start):
            # the way along which a person leads the robot belongs to where it starts
            led = _led_along(study.world, study.world.scenario(scenario), start[:2])
            changes = {"world/robots/0/start": list(start), f"world/scenarios/{scenario}/guide": led}
        yield Point(geometry.chain_length(way), changes)


def _way_to_border(
    world: World, scenario: Scenario, start: Sequence[float], costs: CostmapParams = CostmapParams()
) -> np.ndarray:
    """(N, 2) [m] the shortest way of a robot to a place from which it sees the nearest part of the border."""
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
    of the scenario's own way.
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


@sweeps.register("border_length")
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


@sweeps.register("robots")
def robots(study: Study, settings: Mapping[str, Any], scenario: str) -> Iterator[Point]:
    """Over the number of robots; settings: `more`, the others' entries of the world. The baseline leads the first."""
    first = {**study.sources["world"]["robots"][0], "namespace": "robot1"}
    for count in range(len(settings["more"]) + 1):
        # among several each has a namespace, as in the live system
        changes = {"world/robots": [first, *settings["more"][:count]]} if count else {}
        yield Point(float(count + 1), changes, ("robot_only",))


# ---------------------------------------------------------------- sensitivity
@dataclass(frozen=True)
class Assumption:
    """One figure that is assumed.

    Attributes:
        key: what `Study.changed` calls it.
        unit: as the comment says.
        only: the methods that it can concern; empty: all.
    """

    key: str
    unit: str
    only: Tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Section and key."""
        return self.key.split("/", 1)[1].replace("traits/", "participant/")


_SECTIONS = ("robot", "localisation", "scan", "optics", "camera_noise", "robot_camera", "participant")
# sections whose figures concern the ceiling cameras alone, and keys that concern one method alone
_ONLY_SECTIONS = {"camera_noise": ("nrs",)}
_ONLY_KEYS = {
    **{key: ("nrs",) for key in ("calibration_point_m", "vignetting", "drawing_speed")},
    **{key: ("robot_only",) for key in ("leading_distance", "leading_distance_max", "leading_speed", "robot_drawing_speed")},
}
_NO_MODEL = "mechanics"
NOMINAL = "nominal"  # in the column `parameter`: nothing is changed


def assumptions(study: Study) -> List[Assumption]:
    """Every figure of the models and of the participants beside which the word "assumed" stands."""
    found = []
    traits = study.document["participants"].get("traits") or {}
    body = study.document["participants"].get("body") or {}
    for section_name, key, unit in _assumed(top() / "src" / "vb_sim" / "config" / "models.yaml", 2):
        drawn = (section_name == "participant" and key in traits) or (section_name == "body" and key in body)
        if drawn or section_name not in _SECTIONS:
            continue
        only = _ONLY_KEYS.get(key, _ONLY_SECTIONS.get(section_name, ()))
        found.append(Assumption(f"models/{section_name}/{key}", unit, only))
    found += [Assumption(f"participants/traits/{key}", "", _ONLY_KEYS.get(key, ())) for key in traits]
    found += [Assumption(f"participants/body/{key}", "") for key in body]
    if "stand_offset" in study.document["participants"]:
        found.append(Assumption("participants/stand_offset", "m"))
    return found


def _assumed(path: Path, indent: int) -> Iterator[Tuple[str, str, str]]:
    """(section, key, unit) of each line of a YAML file whose comment says "assumed"."""
    section_name = ""
    for line in path.read_text(encoding="utf-8").splitlines():
        head = re.match(r"(\w+):\s*(#.*)?$", line)
        if head:
            section_name = head.group(1)
        entry = re.match(r"\s{%d}(\w+):\s*[^#]+#\s*(.*)$" % indent, line)
        if entry and "assumed" in entry.group(2) and _NO_MODEL not in entry.group(2):
            unit = re.match(r"\[([^\]]*)\]", entry.group(2))
            yield section_name, entry.group(1), unit.group(1) if unit else ""


def sensitivity_jobs(study: Study, participants: int, only: Sequence[str] = ()) -> List[Job]:
    """The same participants with nothing changed, and with each assumption at each factor.

    Args:
        only: names of assumptions; empty: all.
    """
    settings = study.document.get("sensitivity") or {}
    scenarios = settings.get("scenarios", study.design.scenarios)
    jobs: List[Job] = []
    for scenario in scenarios:
        conditions = {"parameter": NOMINAL, "factor": 1, "value": "", "unit": ""}
        jobs += _jobs(study, SENSITIVITY, participants, scenario, {}, conditions, ())
    for assumption in assumptions(study):
        if only and assumption.name not in only:
            continue
        for factor in settings.get("factors", (0.5, 2.0)):
            changed, words = _scaled(study, assumption, float(factor))
            untouched = [method for method in study.design.methods if assumption.only and method not in assumption.only]
            for scenario in scenarios:
                conditions = {"parameter": assumption.name, "factor": factor, "value": words, "unit": assumption.unit}
                jobs += _jobs(study, SENSITIVITY, participants, scenario, changed, conditions, untouched)
    return jobs


def _scaled(study: Study, assumption: Assumption, factor: float) -> Tuple[Mapping[str, Any], str]:
    """(changes, the value in words); where a limit of what is possible lies in between, the value is the limit."""
    value = scaled(_get(study, assumption.key), factor)
    for _ in range(3):
        try:
            study.changed({assumption.key: value})
            break
        except ParameterError as error:
            limit = re.search(r"must be at (?:most|least) ([-\d.e]+)", str(error))
            if limit is None:
                raise
            value = _limited(value, float(limit.group(1)), "most" in str(error))
    return {assumption.key: value}, f"{factor:g} x what is drawn" if isinstance(value, Mapping) else str(value)


def _get(study: Study, key: str) -> Any:
    head, _, rest = key.partition("/")
    document: Any = study.sources[head] if head in study.sources else study.document[head]
    for name in rest.split("/"):
        document = document[name]
    return document


def scaled(value: Any, factor: float) -> Any:
    """A number, a list of numbers or a distribution, times a factor; whole numbers stay whole."""
    if isinstance(value, bool):
        return value
    if isinstance(value, int):
        return max(1, int(round(value * factor)))
    if isinstance(value, float):
        return round(value * factor, 9)
    if isinstance(value, list):
        return [scaled(entry, factor) for entry in value]
    return {"scaled": [value, factor]}


def _limited(value: Any, limit: float, most: bool) -> Any:
    if isinstance(value, list):
        return [_limited(entry, limit, most) for entry in value]
    if isinstance(value, int) and not isinstance(value, bool):
        limit = int(limit)
    return min(value, limit) if most else max(value, limit)
