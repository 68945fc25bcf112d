"""Every parameter that we set for the navigation stack is one that it reads.

The real stack takes a misspelt parameter in silence and goes on with its default, which for borders is the wrong one.
The names are those of ros-planning/navigation, branch noetic-devel at 9ad6441 (1.17.3), where the files say.
"""

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import yaml

from vb_core.navigation_parameters import amcl_parameters, navigation_parameters
from vb_core.robot_profile import RobotProfile

TOP = Path(__file__).resolve().parents[1]
CONFIG = TOP / "src" / "vb_bringup" / "config" / "navigation"

# costmap_2d/src/costmap_2d_ros.cpp, costmap_2d/src/footprint.cpp, costmap_2d/cfg/Costmap2D.cfg
COSTMAP = set(
    "always_send_full_costmap footprint footprint_padding footprint_topic global_frame height origin_x origin_y "
    "plugins publish_frequency published_footprint_topic resolution robot_base_frame robot_radius rolling_window "
    "track_unknown_space transform_tolerance update_frequency width".split()
)
LAYERS = {
    # costmap_2d/plugins/static_layer.cpp, costmap_2d/cfg/GenericPlugin.cfg
    "costmap_2d::StaticLayer": set(
        "enabled first_map_only lethal_cost_threshold map_topic subscribe_to_updates track_unknown_space "
        "trinary_costmap unknown_cost_value use_maximum".split()
    ),
    # costmap_2d/plugins/obstacle_layer.cpp, costmap_2d/cfg/ObstaclePlugin.cfg; and one key for each observation source
    "costmap_2d::ObstacleLayer": set(
        "combination_method enabled footprint_clearing_enabled max_obstacle_height observation_sources "
        "track_unknown_space transform_tolerance".split()
    ),
    # costmap_2d/cfg/InflationPlugin.cfg
    "costmap_2d::InflationLayer": set("cost_scaling_factor enabled inflate_unknown inflation_radius".split()),
}
# costmap_2d/plugins/obstacle_layer.cpp, onInitialize
SOURCE = set(
    "clearing data_type expected_update_rate inf_is_valid marking max_obstacle_height min_obstacle_height "
    "observation_persistence obstacle_range raytrace_range sensor_frame topic".split()
)
# move_base/src/move_base.cpp, constructor
MOVE_BASE = set(
    "base_global_planner base_local_planner clearing_radius clearing_rotation_allowed conservative_reset_dist "
    "controller_frequency controller_patience make_plan_add_unreachable_goal make_plan_clear_costmap "
    "max_planning_retries oscillation_distance oscillation_timeout planner_frequency planner_patience "
    "recovery_behavior_enabled recovery_behaviors shutdown_costmaps".split()
)
NESTED = {
    # navfn/src/navfn_ros.cpp
    "NavfnROS": set("allow_unknown default_tolerance planner_window_x planner_window_y visualize_potential".split()),
    # dwa_local_planner/cfg/DWAPlanner.cfg, dwa_local_planner/src/dwa_planner.cpp,
    # base_local_planner/src/local_planner_limits/__init__.py
    "DWAPlannerROS": set(
        "acc_lim_theta acc_lim_trans acc_lim_x acc_lim_y angular_sim_granularity cheat_factor controller_frequency "
        "forward_point_distance global_frame_id goal_distance_bias latch_xy_goal_tolerance max_scaling_factor max_vel_theta max_vel_trans "
        "max_vel_x max_vel_y min_vel_theta min_vel_trans min_vel_x min_vel_y occdist_scale oscillation_reset_angle "
        "oscillation_reset_dist path_distance_bias prune_plan publish_cost_grid_pc publish_traj_pc scaling_speed "
        "sim_granularity sim_time stop_time_buffer sum_scores theta_stopped_vel trans_stopped_vel twirling_scale "
        "use_dwa vth_samples vx_samples vy_samples xy_goal_tolerance yaw_goal_tolerance".split()
    ),
    # clear_costmap_recovery/src/clear_costmap_recovery.cpp; the names: move_base.cpp, loadDefaultRecoveryBehaviors
    "conservative_reset": set("affected_maps force_updating invert_area_to_clear layer_names reset_distance".split()),
    "aggressive_reset": set("affected_maps force_updating invert_area_to_clear layer_names reset_distance".split()),
}
# amcl/src/amcl_node.cpp, amcl/cfg/AMCL.cfg; those that the launch file sets
AMCL = set(
    "base_frame_id odom_model_type first_map_only global_frame_id initial_cov_xx initial_cov_yy initial_pose_a "
    "initial_pose_x initial_pose_y laser_max_beams odom_alpha1 odom_alpha2 odom_alpha3 odom_alpha4 odom_frame_id "
    "transform_tolerance update_min_a update_min_d use_map_topic".split()
)


PROFILES = {path.stem: RobotProfile.load(path) for path in sorted((TOP / "robots").glob("*.yaml"))}


def merged(below, above):
    """Merges nested parameters as the parameter server does when both are set, the second one last."""
    found = dict(below)
    for key, value in above.items():
        found[key] = merged(found.get(key, {}), value) if isinstance(value, dict) else value
    return found


def load(name, profile="turtlebot2"):
    """Loads a file's parameters, and for move_base's own what follows from the robot's profile."""
    found = yaml.safe_load((CONFIG / name).read_text())
    derived = navigation_parameters(PROFILES[profile])
    if name == "move_base.yaml":
        found = merged(found, {key: value for key, value in derived.items() if key == "DWAPlannerROS"})
    return found


def costmap(name, profile="turtlebot2"):
    found = {**load("costmap_common.yaml"), **load(f"{name}_costmap.yaml")}
    return merged(found, navigation_parameters(PROFILES[profile])[f"{name}_costmap"])


@pytest.mark.parametrize("name", sorted(PROFILES))
def test_what_follows_from_the_robot_is_known_and_is_the_robots(name):
    profile = PROFILES[name]
    found = merged(load("move_base.yaml", name), {})
    assert set(found["DWAPlannerROS"]) <= NESTED["DWAPlannerROS"]
    assert found["DWAPlannerROS"]["max_vel_x"] == found["DWAPlannerROS"]["max_vel_trans"] == profile.limits.max_speed
    assert found["DWAPlannerROS"]["min_vel_x"] >= 0.0, "many scanners do not look back"
    for which in ("global", "local"):
        settings = costmap(which, name)
        assert set(settings) - {plugin["name"] for plugin in settings["plugins"]} <= COSTMAP
        # paths keep more than the controller needs
        assert settings["robot_radius"] == pytest.approx(profile.radius + (0.04 if which == "global" else 0.0))
        assert settings["inflation_layer"]["inflation_radius"] > profile.radius
        assert settings["obstacle_layer"]["scan"]["topic"] == profile.scanner.topic
        assert settings["robot_base_frame"] == profile.frames.base
    prefixed = navigation_parameters(profile, "robot1/")
    assert prefixed["local_costmap"]["global_frame"] == "robot1/odom"
    assert prefixed["global_costmap"]["robot_base_frame"] == f"robot1/{profile.frames.base}"
    assert set(amcl_parameters(profile)) <= AMCL


@pytest.mark.parametrize("name", ["global", "local"])
def test_the_costmaps_parameters_are_known(name):
    found = costmap(name)
    layers = {plugin["name"]: plugin["type"] for plugin in found["plugins"]}
    assert set(found) - set(layers) <= COSTMAP
    for layer, kind in layers.items():
        settings = found.get(layer, {})
        sources = set(settings.get("observation_sources", "").split())
        assert set(settings) - sources <= LAYERS[kind], layer
        for source in sources:
            assert set(settings[source]) <= SOURCE, source


def test_the_parameters_of_move_base_are_known():
    found = load("move_base.yaml")
    assert set(found) <= MOVE_BASE | set(NESTED)
    for name, known in NESTED.items():
        assert set(found.get(name, {})) <= known, name


@pytest.mark.parametrize("name", ["global", "local"])
def test_borders_act_in_both_costmaps_below_inflation(name):
    found = costmap(name)
    kinds = [plugin["type"].split("::")[1] for plugin in found["plugins"]]
    # an obstacle layer above the static one keeps its obstacles: it takes the larger value
    assert kinds == ["StaticLayer", "StaticLayer", "ObstacleLayer", "InflationLayer"]
    static, keep_out = found["static_layer"], found["keep_out_layer"]
    assert static["map_topic"] == "/virtual_borders/map" and keep_out["map_topic"] == "robot_driver/keep_out"
    assert keep_out["use_maximum"] is True, "it adds to the layer below"
    for layer in (static, keep_out):
        assert layer["trinary_costmap"] is False and layer["lethal_cost_threshold"] == 100
        assert layer["subscribe_to_updates"] is False


def test_plans_keep_to_borders():
    found = load("move_base.yaml")
    assert found["planner_frequency"] >= 1.0
    assert found["make_plan_clear_costmap"] is False and found["make_plan_add_unreachable_goal"] is False
    assert found["NavfnROS"]["allow_unknown"] is False and found["NavfnROS"]["default_tolerance"] == 0.0
    # obstacle_layer.cpp takes the costmap's track_unknown_space, whose default makes unknown cells free
    assert costmap("global")["track_unknown_space"] is True and costmap("global")["global_frame"] == "map"
    for name in ("conservative_reset", "aggressive_reset"):
        assert found[name]["layer_names"] == ["obstacle_layer"]


def test_the_launch_file_gives_each_node_its_map():
    launch = ElementTree.parse(str(TOP / "launch" / "navigation.launch"))
    nodes = {node.get("name"): node for node in launch.iter("node")}
    amcl = {param.get("name"): param.get("value") for param in nodes["amcl"].iter("param")}
    assert set(amcl) - {"prefix"} <= AMCL and amcl["use_map_topic"] == amcl["first_map_only"] == "true"
    # the corrected model takes them as variances: the defaults, meant for the other, are half of each motion
    assert amcl["odom_model_type"] == "diff-corrected" and all(
        float(amcl[f"odom_alpha{i}"]) <= 0.05 for i in (1, 2, 3, 4)
    )
    assert ("map", "/map") in {(remap.get("from"), remap.get("to")) for remap in nodes["amcl"].iter("remap")}
    loaded = [(param.get("file").rsplit("/", 1)[1], param.get("ns")) for param in nodes["move_base"].iter("rosparam")]
    # what is common comes first: what is loaded later wins
    for name in ("global", "local"):
        own = [file for file, namespace in loaded if namespace == f"{name}_costmap"]
        assert own == ["costmap_common.yaml", f"{name}_costmap.yaml"]
    text = (TOP / "launch" / "navigation.launch").read_text()
    assert not re.search(r'to="/?virtual_borders/map"', text), "AMCL must not be given the map with borders"
