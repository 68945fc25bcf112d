"""Derives move_base's parameters from a robot's profile, and checks how costmaps treat soft occupancies.

move_base's other parameters are in vb_bringup/config/navigation.
"""

from __future__ import annotations

from typing import Any, Dict, Mapping

from vb_core.robot_profile import RobotProfile

INFLATION_MARGIN = 0.17  # [m] inflation beyond the radius: the robot keeps that distance where it can
# [m] distance beyond the radius that a path keeps from borders and walls. Without it, paths lead through gaps in which
# the footprint touches something as soon as the controller or the localisation is off by 3 cm. DWA then finds no
# trajectory any more, and no recovery behaviour frees the robot.
PATH_MARGIN = 0.04
SIM_TIME = 2.0  # [s] DWA's look-ahead: with less, the robot turns back and forth where a path bends round a border


def navigation_parameters(profile: RobotProfile, prefix: str = "") -> Dict[str, Any]:
    """Derives the nested parameters of move_base from a robot's profile.

    Args:
        prefix: prefix of the robot's frames, for instance "robot1/".
    """
    limits, scanner = profile.limits, profile.scanner
    base, odom = prefix + profile.frames.base, prefix + profile.frames.odom
    reach = scanner.obstacle_range
    source = {"topic": scanner.topic, "obstacle_range": reach, "raytrace_range": reach + 0.5}
    costmap = {
        "robot_base_frame": base,
        "robot_radius": profile.radius,
        "inflation_layer": {"inflation_radius": round(profile.radius + INFLATION_MARGIN, 3)},
        "obstacle_layer": {"scan": source} if scanner.present else {"observation_sources": ""},
    }
    # with few samples DWA could choose only between full speed and standing still
    samples = max(8, int(round(limits.max_speed / 0.025)))
    return {
        "global_costmap": {**costmap, "robot_radius": round(profile.radius + PATH_MARGIN, 3)},
        "local_costmap": {**costmap, "global_frame": odom},
        "DWAPlannerROS": {
            "max_vel_x": limits.max_speed,
            "max_vel_trans": limits.max_speed,
            "max_vel_theta": limits.max_turn_rate,
            "acc_lim_x": limits.acceleration,
            "acc_lim_trans": limits.acceleration,
            "acc_lim_theta": limits.turn_acceleration,
            "vx_samples": samples,
            "sim_time": SIM_TIME,
        },
    }


def amcl_parameters(profile: RobotProfile, prefix: str = "") -> Dict[str, Any]:
    """Derives AMCL's parameters from a robot's profile. `prefix` as in `navigation_parameters`."""
    return {"base_frame_id": prefix + profile.frames.base, "odom_frame_id": prefix + profile.frames.odom}


def is_trinary(costmap: Any) -> bool:
    """Returns whether a costmap, read as by `rosparam get`, treats soft occupancies as free, which is the default."""
    if not isinstance(costmap, Mapping):
        return False  # there is no such costmap
    static_layers = [
        str(plugin.get("name", "static_layer"))
        for plugin in costmap.get("plugins") or []
        if isinstance(plugin, Mapping) and str(plugin.get("type", "")).endswith("StaticLayer")
    ]
    layers = [costmap.get(name) for name in static_layers or ["static_layer"]]
    return any(not isinstance(layer, Mapping) or layer.get("trinary_costmap", True) for layer in layers)
