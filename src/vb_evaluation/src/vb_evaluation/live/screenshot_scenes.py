"""The scenes that `screenshots` shows: one for each state, in any world."""
from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import List, Optional, Sequence, Tuple

import numpy as np
from shapely.geometry import Polygon

from vb_core.geometry import resample_chain
from vb_core.grid_map import GridMap
from vb_core.notices import Notice, Severity
from vb_map_integration.border import VirtualBorder
from vb_map_integration.integration import integrate
from vb_sim.room import floor_plan
from vb_sim.room.world import Scenario, World


@dataclass(frozen=True)
class Scene:
    """What the system would publish at a moment. Lengths in metres, map frame."""

    name: str
    posterior: GridMap
    borders: Tuple[Tuple[VirtualBorder, float], ...]
    robot: Tuple[float, float, float]
    state: str = "default"
    elapsed_s: float = 0.0
    commands: Tuple[str, ...] = ("define_border", "guide_robot")
    success: bool = True
    code: str = ""  # of the last answer
    stopped: bool = False
    cameras: Tuple[str, ...] = ()
    seeing: Tuple[str, ...] = ()
    points: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    point_cameras: Sequence[int] = ()
    chain: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    closed: bool = False
    seed: Optional[Tuple[float, float]] = None
    spots: Tuple[Tuple[str, float, float], ...] = ()
    region: Optional[np.ndarray] = None
    area_m2: float = 0.0
    issues: Tuple[Notice, ...] = ()
    path: Tuple[Tuple[float, float], ...] = ()
    notices: Tuple[Notice, ...] = ()


def scenes(world: World) -> List[Scene]:
    """Default with borders, Border, Seed with a preview, Guide, saved, refused, a robot in a border, and stopped."""
    grid = floor_plan.physical_map(world)
    drawn = min(world.scenarios.values(), key=lambda scenario: not scenario.closed)
    cameras = tuple(camera.name for camera in world.cameras)[-2:] + ("robot",)
    new, stored = _border(drawn), _stored(world, drawn)
    before, kept = _apply(grid, stored)
    after, all_kept = _apply(grid, [*stored, new])
    added = integrate(grid, new)
    start = world.robots[0].start_pose()
    chain = np.vstack([drawn.border, drawn.border[:1]]) if drawn.closed else drawn.border
    line = resample_chain(chain, 0.04)
    part = line[: int(0.62 * len(line))]
    watching = (*_beside(part[-1], start), float(np.arctan2(*(part[-1] - _beside(part[-1], start))[::-1])))
    default = Scene("default", before, kept, start)
    border = replace(
        default, name="border", state="border", elapsed_s=9.0, commands=("define_seed", "guide_robot", "cancel"), code="draw_border",
        cameras=cameras, seeing=cameras, points=_scattered(part), point_cameras=[number % 3 for number in range(len(part))],
        chain=part, robot=watching, spots=_spots(part[-14:], cameras), path=_way(start, watching),
    )
    seed_line = drawn.seed + np.column_stack([np.linspace(-0.04, 0.0, 8), np.linspace(0.02, 0.0, 8)])
    seed = replace(
        border, name="seed", state="seed", elapsed_s=27.0, commands=("save", "define_border", "guide_robot", "cancel"),
        code="point_seed", points=_scattered(line), point_cameras=[number % 3 for number in range(len(line))], chain=chain,
        closed=False, seed=tuple(drawn.seed), spots=_spots(seed_line, cameras[:2]), seeing=cameras[:2], region=added.region,
        area_m2=added.area_m2, path=(),
    )
    led = drawn.guide[0] if len(drawn.guide) else drawn.stand
    along = np.linspace(start[:2], led, 40)
    guide = replace(
        default, name="guide", state="guide", elapsed_s=14.0, commands=("define_border", "define_seed", "cancel"),
        code="guide", cameras=("robot",), seeing=("robot",), spots=_spots(along[-14:], ("robot",)),
        robot=(*along[22], float(np.arctan2(*(along[-1] - along[0])[::-1]))),
    )
    return [
        default, border, seed,
        replace(seed, name="seed_mind", issues=(Notice("preview_parts", values={"parts": "2"}),)),
        guide,
        replace(default, name="saved", posterior=after, borders=all_kept, code="saved"),
        replace(
            seed, name="refusal", success=False, region=None, seed=None, spots=(), seeing=(), state="border",
            commands=("define_seed", "guide_robot", "cancel"),
            code="missing_seed",
        ),
        replace(
            default, name="robot_in_border", posterior=after, borders=all_kept, robot=(*(0.25 * drawn.seed + 0.75 * drawn.border[0]), 0.6),
            code="saved", notices=(Notice("robot_inside_border", Severity.WARNING, values={"robot": "the robot", "border": new.name},
                                          message=f"The robot is inside '{new.name}'."),),
        ),
        replace(
            guide, name="stopped", stopped=True, code="stopped", spots=(), seeing=(), commands=("resume", "define_border", "cancel"),
            notices=(Notice("robots_stopped", Severity.WARNING),),
        ),
    ]


def _border(scenario: Scenario) -> VirtualBorder:
    name = scenario.title.replace(" exclusion", "")
    return VirtualBorder(scenario.border, scenario.seed, 1.0, scenario.closed, name=name)


def _stored(world: World, drawn: Scenario) -> List[VirtualBorder]:
    """The smallest of the other scenarios as a hard border, what lies on the floor elsewhere as soft ones."""
    others = [scenario for scenario in world.scenarios.values() if scenario is not drawn]
    stored = [_border(min(others, key=lambda scenario: Polygon(scenario.region).area))] if others else []
    for patch in world.patches:
        outline = patch.footprint()
        if not Polygon(outline).intersects(Polygon(drawn.region)):
            stored.append(VirtualBorder(outline, outline.mean(axis=0), 0.5, True, name=patch.name.capitalize()))
    return stored


def _apply(grid: GridMap, borders: Sequence[VirtualBorder]) -> Tuple[GridMap, Tuple[Tuple[VirtualBorder, float], ...]]:
    areas = []
    posterior = grid
    for border in borders:
        found = integrate(grid, border)
        posterior = posterior.with_data(np.maximum(posterior.data, found.posterior.data))
        areas.append((border, found.area_m2))
    return posterior, tuple(areas)


def _beside(place: np.ndarray, start: Sequence[float]) -> np.ndarray:
    """Where the robot looks at a place from: 1 m away, on the side from which it comes."""
    away = np.array(start[:2]) - place
    return place + away / max(1e-6, float(np.linalg.norm(away)))


def _way(start: Sequence[float], end: Sequence[float]) -> Tuple[Tuple[float, float], ...]:
    share = np.linspace(0.0, 1.0, 60)[:, None]
    bow = 0.35 * np.sin(np.pi * share) * np.array([[-1.0, 0.3]])
    return tuple(map(tuple, np.array(start[:2]) * (1 - share) + np.array(end[:2]) * share + bow))


def _scattered(line: np.ndarray) -> np.ndarray:
    return line + np.random.default_rng(4).normal(0.0, 0.015, line.shape)


def _spots(line: np.ndarray, cameras: Sequence[str]) -> Tuple[Tuple[str, float, float], ...]:
    offsets = 0.025 * np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]])
    return tuple(
        (camera, float(x + dx), float(y + dy))
        for x, y in line for camera, (dx, dy) in zip(cameras, offsets)
    )
