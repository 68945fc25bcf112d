"""Finds what a robot's navigation is connected to, from the ROS graph and the navigation's parameters."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Any, List, Mapping, Optional, Sequence, Tuple

import cv2
import numpy as np
import yaml

from vb_core import names

# local planners whose speed can be limited while they run, and their parameters: the maximum speeds, and others that
# must stay below these
PLANNERS: Mapping[str, Tuple[str, ...]] = {
    "DWAPlannerROS": ("max_vel_trans", "max_vel_x", "min_vel_trans"),
    "TebLocalPlannerROS": ("max_vel_x", "max_vel_x_backwards", "penalty_epsilon"),
    "TrajectoryPlannerROS": ("max_vel_x", "min_vel_x"),
}


@dataclass(frozen=True)
class NavigationWiring:
    """What a robot's move_base is connected to. An empty name means that there is none, or that it is not known."""

    move_base: str = ""  # the name of its node
    maps: Tuple[str, ...] = ()  # the map topics that it subscribes to
    missing_maps: Tuple[str, ...] = ()  # those of them for which it waits in vain
    unheard: Tuple[str, ...] = ()  # see vb_msgs/RobotStatus
    plans_round_borders: bool = False  # see vb_msgs/RobotStatus
    path: str = ""  # the topic of its path
    planner: str = ""  # the name of its local planner, one of PLANNERS
    radius: Optional[float] = None  # [m] of the robot's inscribed circle, from its costmap; None if not given


def resolve_name(robot: str, name: str) -> str:
    """Returns the full name of a topic or node in a robot's namespace."""
    return f"/{robot}/{name}" if robot else f"/{name}"


def find_move_base(graph: Any, robot: str) -> str:
    """Finds the node that plans for a robot, whatever its name, even while it waits for a map. Returns "" for none."""
    servers = graph.publishers.get(resolve_name(robot, "move_base/status"))
    nodes = servers or graph.subscribers.get(resolve_name(robot, "move_base_simple/goal"))
    return nodes[0] if nodes else ""


def find_wiring(graph: Any, robot: str, parameters: Mapping[str, Any]) -> NavigationWiring:
    """Finds the wiring of a robot's navigation.

    Args:
        graph: the vb_core.node_graph.NodeGraph.
        parameters: the parameters of the move_base node.
    """
    node = find_move_base(graph, robot)
    if not node:
        return NavigationWiring()
    maps = tuple(sorted(graph.subscriptions(node, "nav_msgs/OccupancyGrid")))
    is_serving = bool(graph.publishers.get(resolve_name(robot, "move_base/status")))
    velocities = graph.publications(node, "geometry_msgs/Twist")
    paths = sorted(graph.publications(node, "nav_msgs/Path"))
    planner = next((name for name in PLANNERS if f"{node}/{name}/set_parameters" in graph.services), "")
    return NavigationWiring(
        move_base=node,
        maps=maps,
        # the action server starts once it has all maps, so a running one waits for none
        missing_maps=tuple(topic for topic in maps if not (is_serving or graph.publishers.get(topic))),
        unheard=tuple(topic for topic in velocities if not graph.subscribers.get(topic)),
        plans_round_borders=_plans_round_borders(robot, maps, parameters),
        # the global planner's path; local planners call theirs global_plan and local_plan
        path=next((topic for topic in paths if topic.endswith("/plan")), ""),
        planner=planner,
        radius=_radius(parameters),
    )


def _plans_round_borders(robot: str, maps: Sequence[str], parameters: Mapping[str, Any]) -> bool:
    border_maps = {names.MAP_WITH_BORDERS, resolve_name(robot, names.MAP_WITH_BORDERS.strip("/"))}
    plain_maps = {names.PHYSICAL_MAP, resolve_name(robot, "map")}
    if border_maps.isdisjoint(maps) or not plain_maps.isdisjoint(maps):
        return False
    local = parameters.get("local_costmap")
    if not local or _has_static_map(local):
        return True
    # if the local costmap lacks the map, a new border is noticed only when the global plan is renewed
    return float(parameters.get("planner_frequency", 0.0)) > 0.0


def _has_static_map(costmap: Mapping[str, Any]) -> bool:
    layers = [plugin for plugin in costmap.get("plugins", []) if isinstance(plugin, dict)]
    return any(str(layer.get("type", "")).endswith("StaticLayer") for layer in layers)


def _radius(parameters: Mapping[str, Any]) -> Optional[float]:
    costmap = parameters.get("global_costmap") or {}
    footprint: Any = costmap.get("footprint")
    if isinstance(footprint, str):
        with contextlib.suppress(yaml.YAMLError):
            footprint = yaml.safe_load(footprint)
    corners: List[Any] = footprint if isinstance(footprint, list) else []
    try:
        if len(corners) >= 3:
            edges = np.asarray(corners, np.float32).reshape(-1, 1, 2)
            return abs(cv2.pointPolygonTest(edges, (0.0, 0.0), True))
        return float(costmap["robot_radius"])
    except (KeyError, TypeError, ValueError):
        return None
