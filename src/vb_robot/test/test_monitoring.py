"""What robot_monitor reads from a robot's navigation, which goals it refuses, and what it sets in a local planner."""

import itertools
import math
import threading
from dataclasses import replace

import numpy as np
import pytest
from dynamic_reconfigure.msg import Config, DoubleParameter
from dynamic_reconfigure.srv import ReconfigureResponse
from geometry_msgs.msg import Point
from scipy.ndimage import label
from scipy.spatial import cKDTree

from plain_rooms import room, with_border
from refusals import refused
from vb_testing import assert_fields, wait_until
from vb_core.grid_map import GridMap
from vb_core.node_graph import NodeGraph
from vb_msgs.msg import VirtualBorder, VirtualBorderArray
from vb_robot.monitoring.goal_checker import GoalChecker, KnownBorder, find_border_name, is_inside_border
from vb_robot.monitoring.navigation_connections import PLANNERS, NavigationWiring, find_wiring, resolve_name
from vb_robot.ros import planner_speed
from vb_robot.ros.subscriptions import keep_out_borders_for
from vb_robot.ros.watched_robot import WatchedRobot


def navigation_graph(maps, robot="", missing=(), heard=True):
    """Returns the node graph of a move_base with these maps; topics in `missing` have no publisher."""
    node, velocities = resolve_name(robot, "move_base"), resolve_name(robot, "cmd_vel")
    paths = [f"{node}/NavfnROS/plan", f"{node}/DWAPlannerROS/global_plan"]
    subscribed = {name: [node] for name in (resolve_name(robot, "move_base_simple/goal"), *maps)}
    published = {name: [node] for name in (*paths, velocities, resolve_name(robot, "move_base/status"))}
    published.update({topic: ["/server"] for topic in maps})
    for topic in missing:
        del published[topic]
    subscribed[velocities] = ["/base"] if heard else []
    kinds = {"nav_msgs/OccupancyGrid": maps, "nav_msgs/Path": paths, "geometry_msgs/Twist": [velocities]}
    types = {topic: kind for kind, topics in kinds.items() for topic in topics}
    services = {f"{node}/DWAPlannerROS/set_parameters": [node]}
    return NodeGraph(published.items(), subscribed.items(), services.items(), types)


ALL, MARGIN = "/virtual_borders/map", "/robot_driver/keep_out"
STATIC = {"plugins": [{"name": "static_layer", "type": "costmap_2d::StaticLayer"}]}
ROLLING = {"plugins": [{"name": "obstacle_layer", "type": "costmap_2d::ObstacleLayer"}]}


@pytest.mark.parametrize(
    "robot, maps, parameters, plans",
    [
        ("", [ALL], {}, True),
        ("", [ALL, MARGIN], {}, True),
        ("", ["/map"], {}, False),
        # only one costmap has the borders: it cuts corners
        ("", ["/map", ALL], {}, False),
        ("", [ALL], {"local_costmap": STATIC}, True),
        # a border that is drawn while it drives would not be noticed
        ("", [ALL], {"local_costmap": ROLLING}, False),
        ("", [ALL], {"local_costmap": ROLLING, "planner_frequency": 1.0}, True),
        ("", [], {}, False),
        # a named robot may plan on its own map or on the common one
        ("ada", ["/ada/virtual_borders/map"], {}, True),
        ("ada", [ALL], {}, True),
        ("ada", ["/bob/virtual_borders/map"], {}, False),
    ],
)
def test_a_robot_is_said_to_plan_round_borders_only_where_it_does(robot, maps, parameters, plans):
    node = resolve_name(robot, "move_base")
    navigation = {"path": f"{node}/NavfnROS/plan", "planner": "DWAPlannerROS", "plans_round_borders": plans}
    expected = NavigationWiring(node, tuple(sorted(maps)), **navigation)
    assert find_wiring(navigation_graph(maps, robot), robot, parameters) == expected
    assert find_wiring(navigation_graph(maps, robot), "bob", parameters) == NavigationWiring()


def test_a_move_base_that_waits_for_a_map_is_found():
    """Without a driver nobody publishes keep_out; then move_base has no action server, and only logs it at INFO."""
    wiring = find_wiring(navigation_graph([MARGIN, ALL], missing=[MARGIN, "/move_base/status"], heard=False), "", {})
    assert_fields(wiring, move_base="/move_base", missing_maps=(MARGIN,), unheard=("/cmd_vel",))


@pytest.mark.parametrize(
    "costmap, radius",
    [
        ({"robot_radius": 0.22}, 0.22),
        ({"footprint": [[0.3, 0.2], [0.3, -0.2], [-0.3, -0.2], [-0.3, 0.2]]}, 0.2),
        ({"footprint": "[[0.3, 0.2], [0.3, -0.2], [-0.1, -0.2], [-0.1, 0.2]]"}, 0.1),
        ({"footprint": "[]", "robot_radius": 0.4}, 0.4),
        ({"footprint": "nonsense: ["}, None),
        ({}, None),
    ],
)
def test_the_robots_size_is_that_of_its_costmap(costmap, radius):
    assert find_wiring(navigation_graph(["/map"]), "", {"global_costmap": costmap}).radius == pytest.approx(radius)


# ------------------------------------------------------------ goals
def known_border(name, x0, y0, x1, y1):
    corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    return KnownBorder(name, corners, corners.mean(axis=0), True)


def make_checker(areas, radius=0.2, physical=None):
    """Returns a checker with borders that restrict rectangles (x0, y0, x1, y1) [m], by name."""
    physical = physical or room(8.0, 4.0)
    with_borders = physical
    for area in areas.values():
        with_borders = with_border(with_borders, *area)
    return GoalChecker(with_borders, physical, radius, [known_border(name, *area) for name, area in areas.items()])


RUG, HALL, DOOR = {"rug": (2.0, 1.0, 3.0, 2.0)}, {"hall": (3.0, 0.0, 3.3, 4.0)}, {"door": (5.0, 0.0, 5.3, 4.0)}
START, FAR = (0.5, 0.5), (7.0, 2.0)


@pytest.mark.parametrize(
    "areas, start, goal, why",
    [
        (RUG, START, (2.5, 1.5), ("goal_in_border", "rug")),
        (RUG, START, (1.9, 1.5), ("goal_in_border", "rug")),  # the robot's edge would be inside
        (RUG, START, (5.0, 1.5), None),
        (RUG, START, (1.7, 1.5), None),
        (RUG, START, (0.03, 2.0), ("goal_in_obstacle", "")),
        (RUG, START, (9.0, 2.0), ("goal_off_map", "")),
        # of several borders that cut off a goal, the first one on the way is named
        ({**HALL, **DOOR}, START, FAR, ("goal_behind_border", "hall")),
        ({**HALL, **DOOR}, FAR, (0.5, 2.0), ("goal_behind_border", "door")),
        ({**HALL, **DOOR}, START, (1.5, 3.0), None),
        ({**RUG, **DOOR}, (0.5, 1.5), (7.0, 1.5), ("goal_behind_border", "door")),  # the rug can be bypassed
        (RUG, (2.5, 1.5), (5.0, 1.5), ("goal_behind_border", "rug")),  # the robot is inside
        # nothing is said about the way of a robot whose position is not known
        (HALL, None, FAR, None),
        (HALL, None, (3.1, 2.0), ("goal_in_border", "hall")),
    ],
)
def test_a_goal_is_refused_with_the_reason_and_the_borders_name(areas, start, goal, why):
    assert make_checker(areas).check(start, np.array(goal)) == why


def test_a_start_beside_a_map_without_walls_counts_as_on_it():
    checker = make_checker(HALL, physical=GridMap(np.zeros((80, 160), np.int8), 0.05))
    assert checker.check((-0.2, 2.0), np.array(FAR)) == ("goal_behind_border", "hall")


def test_no_border_is_blamed_for_what_a_wall_cuts_off():
    walled = with_border(room(8.0, 4.0), 4.0, 0.0, 4.1, 4.0)
    assert make_checker(RUG, physical=walled).check(START, np.array(FAR)) == ("goal_out_of_reach", "")


def test_a_polygon_that_encloses_a_place_is_named_before_a_curve():
    borders = [known_border("carpet", 0.5, 0.5, 1.5, 1.5), known_border("mat", 1.5, 0.5, 2.5, 1.5)]
    borders.append(KnownBorder("left part", np.array([[1.0, 0.0], [1.0, 4.9]]), np.array([0.2, 2.0]), False))
    for place, name in (((1.0, 1.0), "carpet"), ((2.0, 1.0), "mat"), ((0.5, 4.0), "left part")):
        assert find_border_name(borders, place) == name
    assert find_border_name([], (1.0, 1.0)) == ""


def test_the_nearest_curve_is_named_though_its_corners_are_far():
    curves = {"long": [(0.0, 0.0), (10.0, 0.0)], "short": [(5.0, 2.0), (5.5, 2.0)]}
    borders = [KnownBorder(name, np.array(points), np.array([5.0, 4.0]), False) for name, points in curves.items()]
    assert find_border_name(borders, (5.0, 0.1)) == "long"


def test_a_robot_is_inside_where_only_a_border_forbids_it():
    plain = room(8.0, 4.0)
    map_with_borders = with_border(with_border(plain, 2.0, 1.0, 3.0, 2.0), 2.0, 2.5, 3.0, 3.0, 75)
    physical = with_border(plain, 0.0, 1.5, 8.0, 2.0, -1)
    places = {(2.5, 1.2): True, (2.5, 1.8): True, (2.5, 2.7): False, (1.9, 1.2): False, (50.0, 1.0): False}
    assert {place: is_inside_border(map_with_borders, physical, place) for place in places} == places
    assert not is_inside_border(map_with_borders, physical, (0.03, 2.0)), "a wall is not a border"


@pytest.mark.parametrize("order", list(itertools.permutations(["physical", "borders", "keep_out"])))
def test_a_robot_inside_is_reported_in_any_order_of_the_maps(order):
    robot = WatchedRobot("", "base_link", None, None)
    robot.wiring = NavigationWiring(move_base="/move_base", maps=("/robot_driver/keep_out",), radius=0.2)
    robot.pose = (2.5, 1.5, 0.0)
    checker = make_checker(RUG)
    maps = {"physical": checker.physical, "borders": checker.map_with_borders, "keep_out": checker.map_with_borders}
    for count, layer in enumerate(order, 1):
        robot.set_map(layer, maps[layer])
        is_complete = {"physical", "borders"} <= set(order[:count])
        assert [notice.code for notice in robot.notices(0.0)] == ["robot_caught_in_border"] * is_complete
    old_checker = robot.goal_checker()
    robot.wiring = replace(robot.wiring, radius=0.3)
    assert robot.goal_checker() is not old_checker
    assert robot.goal_checker() is robot.goal_checker()


def test_only_what_forbids_a_place_lends_its_name():
    fields = ("name", "zone", "occupancy", "robots")
    rows = [("soft", 0, 0.5, []), ("detour", 1, 0.75, []), ("slow", 2, 1.0, []), ("ada's", 0, 1.0, ["ada"])]
    rows.append(("rug", 0, 1.0, []))
    borders = [VirtualBorder(in_force=True, points=[Point()], **dict(zip(fields, row))) for row in rows]
    keep_out = keep_out_borders_for("bob", VirtualBorderArray(borders=borders))
    assert [border.name for border in keep_out] == ["rug"]


@pytest.mark.parametrize("seed", range(40))
def test_a_goal_is_refused_exactly_where_a_search_finds_no_path(seed):
    """The oracle is independent: connected components of cells far enough from every blocked one, by a k-d tree."""
    areas = {}
    rng = np.random.default_rng(seed)
    for name in "abc":
        x, y = rng.uniform(0.3, 6.5), rng.uniform(0.0, 3.0)
        areas[name] = (x, y, min(x + rng.uniform(0.1, 1.0), 7.9), min(y + rng.uniform(0.5, 4.0), 3.95))
    checker = make_checker(areas, radius=0.15)
    grid = checker.map_with_borders
    distances, _ = cKDTree(np.argwhere(grid.data >= 99)).query(np.indices(grid.shape).reshape(2, -1).T)
    fits = distances.reshape(grid.shape) * 0.05 >= 0.15
    floors = label(fits)[0]
    start, goal = np.argwhere(fits)[rng.integers(0, fits.sum(), 2)]
    places = grid.cell_to_world(np.array([start, goal]))
    # the check is generous by one cell, so that it never refuses a goal that can be reached
    why = checker.check(*places)
    if floors[tuple(start)] == floors[tuple(goal)]:
        assert why is None
    else:
        why_for_a_wider_robot = make_checker(areas, radius=0.25).check(*places)
        assert why or why_for_a_wider_robot


# ------------------------------------------------------------ slow zones
@pytest.mark.parametrize("limit", [0.2, 0.1, 0.05, 0.02])
def test_teb_keeps_a_speed_that_it_may_drive_under_every_limit(limit):
    """It subtracts penalty_epsilon from its highest speeds; if nothing is left, its behaviour is undefined."""
    usual = {"max_vel_x": 0.4, "max_vel_x_backwards": 0.2, "penalty_epsilon": 0.05, "max_vel_theta": 0.3}
    values = planner_speed.cap_speeds({name: usual[name] for name in PLANNERS["TebLocalPlannerROS"]}, limit)
    assert 0.0 < values["max_vel_x"] - values["penalty_epsilon"] < limit
    assert 0.0 < values["max_vel_x_backwards"] - values["penalty_epsilon"] < limit


class Planner:
    """A local planner with dynamic_reconfigure, and the parameter server; it may refuse lower speeds."""

    def __init__(self, monkeypatch):
        self.values = {"max_vel_trans": 0.5, "max_vel_x": 0.5, "min_vel_trans": 0.1}
        self.usual = dict(self.values)
        self.asked, self.refuses, self.kept, self.heard_by = 0, False, {}, []
        self.answers = threading.Event()
        self.answers.set()
        monkeypatch.setattr(planner_speed.services, "call", self.call)
        monkeypatch.setattr(planner_speed.rospy, "Subscriber", lambda *args, **_: self.heard_by.append(args[2]))
        monkeypatch.setattr(planner_speed.rospy, "get_param", lambda name, default: self.kept.get(name, default))
        monkeypatch.setattr(planner_speed.rospy, "set_param", self.kept.__setitem__)
        monkeypatch.setattr(planner_speed.rospy, "delete_param", self.kept.__delitem__)

    def call(self, _name, _service, request, *_rest):
        self.asked += 1
        self.answers.wait()
        if not self.refuses:
            self.values.update({entry.name: entry.value for entry in request.config.doubles})
        doubles = [DoubleParameter(name, value) for name, value in self.values.items()]
        return ReconfigureResponse(Config(doubles=[*doubles, DoubleParameter("sim_time", 2.0)]))

    def set(self, **values):
        """Sets values and announces them, as after a person's change or a restart."""
        self.values.update(values)
        for hear in self.heard_by:
            hear(Config(doubles=[DoubleParameter(name, value) for name, value in self.values.items()]))

    def speed(self):
        return planner_speed.PlannerSpeed("/move_base/DWAPlannerROS", PLANNERS["DWAPlannerROS"])


@pytest.fixture
def planner(monkeypatch):
    return Planner(monkeypatch)


@pytest.mark.parametrize("restarted", [False, True])
def test_the_usual_speed_returns_after_a_slow_zone(planner, restarted):
    speed = planner.speed()
    speed.apply(math.inf)
    for _ in range(3):
        speed.apply(0.2)
    assert_fields(planner, values={"max_vel_trans": 0.2, "max_vel_x": 0.2, "min_vel_trans": 0.1}, asked=3)
    speed = planner.speed() if restarted else speed
    speed.apply(0.1)
    assert planner.values["min_vel_trans"] == 0.05, "the lowest speed lies below the highest"
    speed.apply(math.inf)
    assert_fields(planner, values=planner.usual, kept={})


def test_a_speed_set_between_zones_is_the_usual_one_from_then_on(planner):
    speed = planner.speed()
    for limit in (0.2, math.inf):
        speed.apply(limit)
    planner.set(max_vel_x=0.4)
    for limit in (0.2, math.inf):
        speed.apply(limit)
    assert planner.values["max_vel_x"] == 0.4


def test_a_planner_that_keeps_its_speed_is_asked_again(planner):
    planner.refuses = True
    speed = planner.speed()
    for _ in range(2):
        with refused("planner_refused"):
            speed.apply(0.2)
    planner.refuses = False
    speed.apply(0.2)
    assert planner.values["max_vel_x"] == 0.2


def test_a_higher_speed_set_in_a_slow_zone_is_limited_again(planner):
    """So is a planner that was restarted in the zone: it announces its values at start."""
    speed = planner.speed()
    speed.apply(0.2)
    asked = planner.asked
    planner.set(max_vel_trans=0.15, sim_time=3.0)
    speed.apply(0.2)
    assert planner.asked == asked
    planner.set(**planner.usual)
    speed.apply(0.2)
    assert planner.values["max_vel_trans"] == planner.values["max_vel_x"] == 0.2
    speed.apply(math.inf)
    assert {name: planner.values[name] for name in planner.usual} == planner.usual


def test_a_planner_that_hangs_blocks_nobody_and_does_not_obey(planner):
    planner.answers.clear()
    speed = planner.speed()
    speed.request_limit(0.2)
    wait_until(lambda: planner.asked == 1, "the planner to be asked")
    speed.request_limit(0.1)  # returns while the planner hangs
    assert not speed.obeys
    assert planner.values["max_vel_x"] == 0.5
    planner.answers.set()
    wait_until(lambda: planner.values["max_vel_x"] == 0.1 and speed.obeys, "the newest limit")
