"""Which of several robots serves: placed best, free, not failed; two do not take turns."""
import math

import pytest

from vb_robot.dispatch import DispatchParams, GoalStatus, Kind, Situation
from vb_robot.fleet import Fleet, Member
from vb_robot.viewpoint import Viewpoint


class Robot:
    """One robot of the bench: candidates with their costs, and what navigation says."""

    def __init__(self, *costs, x0=0.0):
        self.candidates = [Viewpoint(x0 + i, 0.0, 0.0, cost, cost, (0.0, 0.0)) for i, cost in enumerate(costs)]
        self.goal = GoalStatus.NONE
        self.busy, self.server, self.localised = False, True, True
        self.sees = lambda pose: False
        self.pose = (x0 + 50.0, 50.0, 0.0)
        self.sent = []
        self.asked = 0


class Bench:
    def __init__(self, params=DispatchParams(), **robots):
        self.robots = robots
        self.fleet = Fleet(params, robots)
        self.now, self.wanted, self.key, self.spot = 100.0, True, ("a", 1), (0.0, 0.0)

    def step(self):
        self.now += 0.25
        members = []
        for name, robot in self.robots.items():
            def rank(robot=robot):
                robot.asked += 1
                return robot.candidates

            situation = Situation(self.now, self.wanted, self.key, self.spot,
                                  robot.pose if robot.localised else None, robot.server, robot.goal)
            members.append(Member(name, situation, robot.busy, robot.sees, rank, lambda viewpoint: True))
        decisions = self.fleet.step(members)
        assert set(decisions) == set(self.robots)
        running = [name for name, robot in self.robots.items() if robot.goal in (GoalStatus.SENT, GoalStatus.ACTIVE)]
        for name, decision in decisions.items():
            robot = self.robots[name]
            if decision.kind is Kind.SEND:
                robot.sent.append(decision.viewpoint)
                robot.goal = GoalStatus.ACTIVE
                others = [other for other in running if other != name]
                assert all(decisions[other].kind is Kind.CANCEL for other in others), "one goes at a time"
            elif decision.kind is Kind.CANCEL:
                robot.goal = GoalStatus.NONE
        return decisions

    def run(self, steps):
        for _ in range(steps):
            self.step()
        return {name: len(robot.sent) for name, robot in self.robots.items()}

    def serve(self, name):
        """The robot's goal shows the spot."""
        robot = self.robots[name]
        robot.sees = lambda pose: bool(robot.sent) and pose == robot.sent[-1].pose


def test_the_one_with_the_shorter_way_goes_and_keeps_going():
    bench = Bench(ada=Robot(5.0), bob=Robot(2.0), eve=Robot())
    bench.serve("bob")
    assert bench.run(40) == {"ada": 0, "bob": 1, "eve": 0}
    assert bench.robots["ada"].asked == 1, "nothing is worked out while the goal is fit"


def test_whoever_sees_the_spot_from_where_it_stands_need_not_be_sent():
    bench = Bench(ada=Robot(1.0), bob=Robot(2.0))
    bench.robots["bob"].sees = lambda pose: True
    assert bench.run(20) == {"ada": 0, "bob": 0}
    assert bench.fleet.serving == "bob"


def test_a_free_robot_comes_before_one_that_somebody_else_sent():
    bench = Bench(ada=Robot(1.0), bob=Robot(6.0))
    bench.robots["ada"].busy = True
    bench.serve("bob")
    assert bench.run(20) == {"ada": 0, "bob": 1}
    alone = Bench(ada=Robot(1.0))
    alone.robots["ada"].busy = True
    alone.serve("ada")
    assert alone.run(20) == {"ada": 1}, "if there is no other, the person comes first"


@pytest.mark.parametrize("fault", ["aborts", "navigation dies", "lost", "never accepts", "stuck", "taken"])
def test_another_takes_over_when_one_fails(fault):
    bench = Bench(ada=Robot(1.0, 1.5), bob=Robot(3.0, x0=20.0))
    bench.serve("ada")
    bench.serve("bob")
    bench.step()
    ada, bob = bench.robots["ada"], bench.robots["bob"]
    assert len(ada.sent) == 1 and not bob.sent
    if fault == "aborts":
        ada.goal = GoalStatus.FAILED
    elif fault == "navigation dies":
        ada.server = False
    elif fault == "lost":
        ada.localised = False
    elif fault == "never accepts":
        ada.goal = GoalStatus.SENT
    elif fault == "taken":
        ada.goal = GoalStatus.TAKEN
    limit = {"never accepts": DispatchParams().ack_timeout, "stuck": DispatchParams().stuck_timeout}.get(fault, 0.0)
    steps = 0
    while not bob.sent and steps < 400:
        bench.step()
        steps += 1
    assert bob.sent and 0.25 * steps <= limit + 1.0, "at once, or when the time is up"
    assert len(ada.sent) == 1
    assert bench.fleet.serving == "bob"


def test_goes_back_to_the_first_when_the_second_fails_too():
    bench = Bench(ada=Robot(1.0, 1.5, 2.0), bob=Robot(3.0, x0=20.0))
    order = []
    for _ in range(40):
        for name, decision in bench.step().items():
            if decision.kind is Kind.SEND:
                order.append((name, decision.viewpoint.x))
                bench.robots[name].goal = GoalStatus.FAILED
    assert order[:3] == [("ada", 0.0), ("bob", 20.0), ("ada", 1.0)], "each place is tried once"


def test_two_that_are_about_equally_near_do_not_take_turns():
    bench = Bench(ada=Robot(2.0), bob=Robot(2.2, x0=20.0))
    bench.step()
    ada, bob = bench.robots["ada"], bench.robots["bob"]
    for i in range(30):
        # the spot goes on, now this one is a little nearer, now that one
        bench.spot = (0.5 * i, 0.0)
        for robot, shift in ((ada, 0.3), (bob, -0.3)):
            cost = 2.0 + shift * (-1) ** i
            robot.candidates = [Viewpoint(robot.candidates[0].x + 0.5, 0.0, 0.0, 2.0, cost, bench.spot)]
        for _ in range(8):
            bench.step()
    assert len(ada.sent) > 10 and not bob.sent


def test_one_that_is_notably_nearer_takes_over_and_the_other_is_called_off():
    bench = Bench(ada=Robot(2.0), bob=Robot(5.0, x0=20.0))
    bench.step()
    bench.spot = (10.0, 0.0)
    bench.robots["ada"].candidates = [Viewpoint(9.0, 0.0, 0.0, 9.0, 9.0, bench.spot)]
    bench.robots["bob"].candidates = [Viewpoint(11.0, 0.0, 0.0, 1.0, 1.0, bench.spot)]
    bench.serve("bob")
    bench.run(20)
    assert len(bench.robots["bob"].sent) == 1 and bench.robots["ada"].goal is GoalStatus.NONE


def test_all_are_called_off_when_none_is_wanted():
    bench = Bench(ada=Robot(2.0), bob=Robot(5.0))
    bench.step()
    bench.wanted, bench.key = False, ("", 0)
    kinds = {name: decision.kind for name, decision in bench.step().items()}
    assert kinds == {"ada": Kind.CANCEL, "bob": Kind.KEEP} and bench.fleet.serving is None


def test_nobody_able_is_no_error():
    bench = Bench(ada=Robot(2.0), bob=Robot())
    bench.robots["ada"].server = False
    assert bench.run(40) == {"ada": 0, "bob": 0}
    bench.robots["ada"].server = True
    bench.serve("ada")
    assert bench.run(20) == {"ada": 1, "bob": 0}
    assert math.isfinite(bench.now)
