"""The parameters that borders need are set, under the names that the navigation stack reads.

The stack silently ignores a misspelt parameter and uses its default, which is wrong for borders.
"""

import re
import xml.etree.ElementTree as ElementTree

import pytest
import yaml

from vb_testing import TOP
from vb_core.navigation_parameters import navigation_parameters
from vb_core.robot_profile import RobotProfile

CONFIG = TOP / "src" / "vb_bringup" / "config" / "navigation"
PROFILES = {path.stem: RobotProfile.load(path) for path in sorted((TOP / "robots").glob("*.yaml"))}


def merged(below, above):
    """Merges nested parameters as the parameter server does when `above` is set after `below`."""
    result = dict(below)
    for key, value in above.items():
        result[key] = merged(result.get(key, {}), value) if isinstance(value, dict) else value
    return result


def load(name, profile="turtlebot2"):
    """Loads a file's parameters; for move_base.yaml with those that follow from the robot's profile."""
    above = {"DWAPlannerROS": navigation_parameters(PROFILES[profile])["DWAPlannerROS"]}
    return merged(yaml.safe_load((CONFIG / name).read_text()), above if name == "move_base.yaml" else {})


def costmap(name, profile="turtlebot2"):
    parameters = {**load("costmap_common.yaml"), **load(f"{name}_costmap.yaml")}
    return merged(parameters, navigation_parameters(PROFILES[profile])[f"{name}_costmap"])


@pytest.mark.parametrize("name", sorted(PROFILES))
def test_robot_parameters_follow_from_the_profile(name):
    profile = PROFILES[name]
    planner = load("move_base.yaml", name)["DWAPlannerROS"]
    assert planner["max_vel_x"] == planner["max_vel_trans"] == profile.limits.max_speed
    assert planner["min_vel_x"] >= 0.0, "many scanners do not look back"
    # paths keep more distance than the controller needs
    for which, margin in (("global", 0.04), ("local", 0.0)):
        settings = costmap(which, name)
        assert settings["robot_radius"] == pytest.approx(profile.radius + margin)
        assert settings["inflation_layer"]["inflation_radius"] > profile.radius
        assert settings["obstacle_layer"]["scan"]["topic"] == profile.scanner.topic
        assert settings["robot_base_frame"] == profile.frames.base
    prefixed = navigation_parameters(profile, "robot1/")
    assert prefixed["local_costmap"]["global_frame"] == "robot1/odom"
    assert prefixed["global_costmap"]["robot_base_frame"] == f"robot1/{profile.frames.base}"


@pytest.mark.parametrize("name", ["global", "local"])
def test_borders_act_in_both_costmaps_below_inflation(name):
    settings = costmap(name)
    kinds = [plugin["type"].split("::")[1] for plugin in settings["plugins"]]
    # an obstacle layer above the static layers keeps their obstacles, as it takes the larger value
    assert kinds == ["StaticLayer", "StaticLayer", "ObstacleLayer", "InflationLayer"]
    static, keep_out = settings["static_layer"], settings["keep_out_layer"]
    assert static["map_topic"] == "/virtual_borders/map"
    assert keep_out["map_topic"] == "robot_driver/keep_out"
    assert keep_out["use_maximum"] is True, "it adds to the layer below"
    for layer in (static, keep_out):
        assert layer["trinary_costmap"] is layer["subscribe_to_updates"] is False
        assert layer["lethal_cost_threshold"] == 100


def test_plans_keep_to_borders():
    settings = load("move_base.yaml")
    assert settings["planner_frequency"] >= 1.0
    assert settings["make_plan_clear_costmap"] is settings["make_plan_add_unreachable_goal"] is False
    assert settings["NavfnROS"]["allow_unknown"] is False
    assert settings["NavfnROS"]["default_tolerance"] == 0.0
    # obstacle_layer.cpp uses the costmap's track_unknown_space, whose default makes unknown cells free
    assert costmap("global")["track_unknown_space"] is True
    assert costmap("global")["global_frame"] == "map"
    for name in ("conservative_reset", "aggressive_reset"):
        assert settings[name]["layer_names"] == ["obstacle_layer"]


def test_the_launch_file_gives_each_node_its_map():
    launch = ElementTree.parse(str(TOP / "launch" / "navigation.launch"))
    nodes = {node.get("name"): node for node in launch.iter("node")}
    amcl = {param.get("name"): param.get("value") for param in nodes["amcl"].iter("param")}
    assert amcl["use_map_topic"] == amcl["first_map_only"] == "true"
    # the corrected model takes them as variances; the defaults are for the other model, and would be half of each motion
    assert amcl["odom_model_type"] == "diff-corrected"
    assert all(float(amcl[f"odom_alpha{i}"]) <= 0.05 for i in (1, 2, 3, 4))
    assert ("map", "/map") in {(remap.get("from"), remap.get("to")) for remap in nodes["amcl"].iter("remap")}
    loaded = [(param.get("file").rsplit("/", 1)[1], param.get("ns")) for param in nodes["move_base"].iter("rosparam")]
    # the common file comes first, as parameters loaded later win
    for name in ("global", "local"):
        own = [file for file, namespace in loaded if namespace == f"{name}_costmap"]
        assert own == ["costmap_common.yaml", f"{name}_costmap.yaml"]
    text = (TOP / "launch" / "navigation.launch").read_text()
    assert not re.search(r'to="/?virtual_borders/map"', text), "AMCL must not be given the map with borders"
