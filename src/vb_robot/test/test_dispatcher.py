"""The whole dispatcher, without ROS: lines that leave the ceiling camera's view, robots that see nothing."""

import math

import numpy as np
import pytest
from shapely.geometry import Point, Polygon

from plain_rooms import VIEW, room
from vb_core.grid_map import GridMap
from vb_core.geometry import map_to_base
from vb_core.interaction_tables import BORDER, DEFAULT, SEED
from vb_robot.dispatching.dispatch_policy import SentGoalState
from vb_robot.dispatching.dispatcher import Dispatcher, DispatchStatus, RobotMap
from vb_robot.dispatching.viewpoint import DrawingState
from vb_robot.spot_sightings import Sighting

PERIOD = 0.25
EDGE = 5.0  # [m] the ceiling camera sees x < EDGE


class Lab:
    """A room of 8 m x 5 m, a ceiling camera that sees x < 5 m, a spot moving along y = 2.5 m, a robot that jumps."""

    def __init__(self, robot=(7.0, 1.0, 0.0)):
        grid = room()
        self.dispatcher = Dispatcher({"": 0.18})
        self.dispatcher.maps[""].update(VIEW, grid, grid)
        self.dispatcher.sightings.set_state(BORDER, "a", 100.0)
        self.now, self.robot, self.goal, self.sent = 100.0, robot, SentGoalState.NONE, []
        self.spot, self.last_goal = np.array([3.0, 2.5]), None

    def see(self, camera, position, mobile=False):
        self.dispatcher.sightings.add(Sighting(self.now, tuple(position), camera, mobile))

    def step(self, speed=0.0, robot_sees=True):
        """Runs a quarter of a second, in which the spot moves along x at `speed` [m/s]."""
        for _ in range(5):
            self.now += PERIOD / 5
            self.spot = self.spot + (speed * PERIOD / 5, 0.0)
            if self.spot[0] < EDGE:
                self.see("red", self.spot)
            if robot_sees and self.robot_views(self.spot):
                self.see("robot", self.spot, mobile=True)
        goal = self.dispatcher.decide(self.now, {"": DispatchStatus(self.robot, True, self.goal)})[""]
        if goal is not None and goal != self.last_goal:
            self.robot, self.goal = goal.pose, SentGoalState.REACHED
            self.sent.append((self.now, self.robot))
        self.last_goal = goal

    def wait(self, steps, **options):
        for _ in range(steps):
            self.step(**options)

    def robot_views(self, place):
        return bool(VIEW.sees(map_to_base(np.asarray(place)[None], self.robot))[0])

    def draw_until(self, x, speed=0.4, **options):
        while self.spot[0] < x:
            self.step(speed, **options)


def test_the_robot_sees_the_spot_when_ceiling_cameras_lose_it():
    lab = Lab()
    lab.draw_until(EDGE - 0.1)
    for x in np.arange(EDGE - 0.1, EDGE + 0.6, 0.1):
        lab.draw_until(x)
        assert lab.robot_views(lab.spot), f"from {lab.robot}"


def test_the_robot_looks_where_people_notice_that_the_spot_is_lost():
    lab = Lab()
    lab.draw_until(EDGE - 0.05, speed=0.5, robot_sees=False)
    lab.robot = (7.0, 0.5, 0.0)  # somebody has moved it
    lab.draw_until(EDGE + 0.3, robot_sees=False)
    lab.wait(8)
    for beyond in (0.0, 0.15, 0.3):
        assert lab.robot_views((EDGE + beyond, 2.5))


def test_a_restarted_dispatcher_sends_a_robot_to_a_blind_corner():
    lab = Lab()
    # after its restart it learns the state and the contributing cameras, but gets no spots
    lab.spot = np.array([EDGE + 0.5, 2.5])
    assert not lab.dispatcher.sightings.should_dispatch()
    points = np.array([[EDGE - 0.1, 2.5], [EDGE + 0.2, 2.5]])
    lab.dispatcher.set_progress("a", DrawingState(points[-1]), ["red"])
    assert lab.dispatcher.sightings.should_dispatch()
    lab.wait(8, robot_sees=False)
    assert lab.sent
    assert lab.robot_views((EDGE + 0.2, 2.5)), "it comes to where the line was seen last"


def test_a_notice_says_that_a_robot_looks_for_the_spot():
    lab = Lab()
    lab.draw_until(EDGE - 0.4)
    assert lab.dispatcher.notice is None
    lab.draw_until(EDGE + 0.2, robot_sees=False)
    lab.wait(4, robot_sees=False)
    assert lab.dispatcher.notice.code == "spot_not_seen_robot_looks"
    place = lab.robot
    lab.wait(16, robot_sees=False)
    assert math.dist(lab.robot[:2], place[:2]) >= 0.5
    assert lab.robot_views(lab.spot), "it looks from elsewhere, too"
    lab.goal = SentGoalState.NONE
    for _ in range(40):
        lab.see("red", lab.spot)
        lab.step()
    assert lab.dispatcher.notice is None, "seen again"
    lab.dispatcher.sightings.set_state(DEFAULT, "", lab.now)
    lab.step()
    assert lab.dispatcher.notice is None


def test_a_notice_says_after_a_while_that_no_robot_comes():
    lab = Lab()
    lab.dispatcher.maps[""].update(None, room(), room())  # a robot whose camera is not known is not sent
    lab.draw_until(EDGE + 0.05, robot_sees=False)
    lost_at = lab.now
    while lab.dispatcher.notice is None and lab.now < lost_at + 10.0:
        lab.step(robot_sees=False)
    assert 2.0 <= lab.now - lost_at <= 3.5
    assert lab.dispatcher.notice.code == "spot_not_seen_no_robot"
    assert not lab.sent


@pytest.mark.parametrize("start", [(6.0, 2.3, 0.0), (5.4, 2.0, 2.0), (6.5, 3.0, -1.0)])
def test_a_robot_within_a_closed_line_leaves_before_it_hides_the_seed(start):
    lab = Lab(robot=start)
    carpet = np.array([[5.0, 1.7], [7.0, 1.7], [7.0, 3.2], [5.0, 3.2]])
    lab.see("red", (4.9, 1.7))  # while the line was drawn
    lab.dispatcher.sightings.set_state(SEED, "a", lab.now)
    lab.dispatcher.set_progress("a", DrawingState(carpet[0] - 0.02, carpet, closed=True), ["red"])
    lab.spot = np.array([10.0, 2.5])  # where nobody sees it
    lab.wait(20)
    assert Polygon(carpet).distance(Point(lab.robot[:2])) >= 0.18
    assert lab.robot_views(carpet.mean(axis=0))


def test_a_bright_spot_after_the_seed_does_not_replace_it():
    lab = Lab(robot=(6.5, 3.6, 2.4))
    line, seed = np.array([[6.0, 4.95], [6.0, 3.4], [6.8, 3.4]]), np.array([5.3, 3.0])
    lab.dispatcher.sightings.set_state(SEED, "a", lab.now)
    lab.dispatcher.set_progress("a", DrawingState(line[-1], line, seed=seed), ["red"])
    lab.spot = np.array([10.0, 2.5])
    for bright in (seed, (6.6, 4.3)):
        for _ in range(20):
            lab.see("red" if bright is seed else "robot", bright, mobile=bright is not seed)
            lab.step()
    assert (np.array(lab.robot[:2]) >= (6.2, 3.6)).all(), "off the seed's side"


def planner_of(cells, drawing, robot):
    """Returns the planner of a robot in an empty square of so many cells of 5 cm, with (0, 0) in its middle."""
    grid = GridMap(np.zeros((cells, cells), np.int8), 0.05, (-0.025 * cells, -0.025 * cells, 0.0))
    robot_map = RobotMap(0.18)
    robot_map.update(VIEW, grid, None)
    return robot_map.make_planner(drawing, DispatchStatus(robot), [])


def test_choosing_a_place_costs_the_same_in_a_hotel():
    """The searched window does not grow with the map, and the result is the same."""
    drawing, answers = DrawingState(np.array([0.5, 0.3]), np.array([[0.0, 0.3], [0.5, 0.3]])), []
    for cells in (200, 2000):
        planner = planner_of(cells, drawing, (-2.0, 0.0, 0.0))
        assert max(planner.clearance_map.grid.shape) * 0.05 <= 12.0
        answers.append(planner.best_viewpoint((-2.0, 0.0, 0.0)).pose)
    assert answers[0] == pytest.approx(answers[1])


def test_a_robot_from_far_away_comes_in_over_the_windows_edge():
    robot = (-25.0, 0.0, 0.0)
    planner = planner_of(1200, DrawingState(np.array([0.5, 0.3])), robot)
    grid = planner.clearance_map.grid
    assert not grid.contains_cells(grid.world_to_cell(np.array([robot[:2]])))[0]
    best = planner.best_viewpoint(robot)
    length = planner.clearance_map.path_lengths(robot[:2], np.array([best.pose[:2]]))[0]
    assert best.pose[0] < 0.5
    assert length == pytest.approx(math.dist(robot[:2], best.pose[:2]), rel=0.1)


def test_the_small_robot_goes_where_the_large_one_does_not_fit():
    parted = room()
    parted.data[:, 80] = 100
    parted.data[45:53, 80] = 0  # a gap of 0.4 m
    dispatcher = Dispatcher({"large": 0.18, "small": 0.10})
    for robot_map in dispatcher.maps.values():
        robot_map.update(VIEW, parted, None)
    dispatcher.sightings.set_state(BORDER, "a", 100.0)
    for i in range(10):
        dispatcher.sightings.add(Sighting(100.0 + 0.1 * i, (2.0, 2.5), "red", False, 0.9))
    robots = {"large": DispatchStatus((5.0, 1.0, 1.5)), "small": DispatchStatus((7.0, 1.0, 3.1))}
    decisions = dispatcher.decide(101.0, robots)
    assert [name for name, goal in decisions.items() if goal is not None] == ["small"]
