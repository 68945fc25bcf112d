"""The dispatch policy, and the sightings of the spot."""

import itertools
import math

import numpy as np
import pytest
from actionlib_msgs.msg import GoalStatus

from vb_testing import assert_fields
from vb_core.interaction_tables import BORDER, DEFAULT, SEED
from vb_robot.dispatching.dispatch_policy import FAILED_MEMORY, DispatchPolicy, DispatchStatus, SentGoalState
from vb_robot.dispatching.viewpoint import Viewpoint
from vb_robot.ros.dispatched_robot import next_goal_state
from vb_robot.spot_sightings import Sighting, SpotSightings

NONE, SENT, ACTIVE, REACHED, FAILED, PREEMPTED = SentGoalState


def place(x, cost=None, **options):
    return Viewpoint((x, 0.0, 0.0), x if cost is None else cost, **options)


def is_at(*places):
    """Returns a function that tells whether an x [m] is one of these."""
    return places.__contains__


class Robot:
    """One robot of the bench: viewpoints on offer, the x where it sees the spot and has room, navigation's status."""

    def __init__(self, *offers, sees=is_at(), **changes):
        self.offers, self.sees, self.room, self.searches = offers, sees, lambda x: True, 0
        self.goal, self.pose, self.destination = NONE, (9.0, 9.0, 0.0), None
        self.is_busy, self.has_navigation, self.localized, self.has_map = False, True, True, True
        vars(self).update(changes)

    # as a ViewpointPlanner
    def is_suitable(self, pose):
        return self.sees(pose[0])

    def has_room_at(self, pose):
        return self.room(pose[0])

    def best_viewpoint(self, _robot, avoid):
        self.searches += 1
        free = [offer for offer in self.offers if all(math.dist(offer.pose[:2], (x, y)) >= r for x, y, r in avoid)]
        return free[0] if free else None


class Bench:
    """Steps a dispatch policy at 4 Hz; goals end when they are cancelled."""

    def __init__(self, outcome=ACTIVE, **robots):
        self.robots, self.policy = robots, DispatchPolicy(robots)
        self.now, self.robot_wanted, self.key, self.unseen_s = 100.0, True, ("a", 1), 0.0
        self.outcome = outcome  # the state of each goal once it was sent; a robot that has REACHED it is there
        self.sent = []  # time [s] and x [m] of each goal

    def step(self):
        """Returns the x to which a robot was sent, or None."""
        self.now += 0.25
        statuses = {}
        for name, robot in self.robots.items():
            pose = robot.pose if robot.localized else None
            statuses[name] = DispatchStatus(pose, robot.has_navigation, robot.goal, robot.is_busy)
        planners = {name: robot if robot.has_map else None for name, robot in self.robots.items()}
        task = self.key if self.robot_wanted else None
        goals = self.policy.step(self.now, task, self.unseen_s, statuses, planners)
        assert set(goals) == set(self.robots)
        assert sum(goal is not None for goal in goals.values()) <= 1
        sent_x = None
        for name, goal in goals.items():
            robot = self.robots[name]
            previous, robot.destination = robot.destination, goal
            if goal is not None and goal != previous:
                robot.goal, sent_x = self.outcome, goal.pose[0]
                robot.pose = goal.pose if self.outcome is REACHED else robot.pose
                self.sent.append((self.now, sent_x))
            elif goal is None and previous is not None and statuses[name].goal.is_running:
                robot.goal = NONE
        return sent_x

    def run(self, steps):
        """Returns every x to which robots were sent."""
        return [sent for sent in (self.step() for _ in range(steps)) if sent is not None]


@pytest.mark.parametrize("state", [dict(has_navigation=False), dict(has_map=False), dict(localized=False)])
def test_a_robot_that_is_not_ready_is_not_sent(state):
    assert not Bench(ada=Robot(place(1), **state)).run(10)


def phase(steps, sent=(), bench=(), **robot):
    """Makes a phase: changes of robot and bench, then so many steps, and each x to which the robot is sent in them."""
    return steps, list(sent), robot, dict(bench)


def flicker():
    """Returns a function that tells whether a robot at x [m] sees the spot: every second time, and never at 9 m."""
    answers = itertools.cycle([True, False])
    return lambda x: x != 9.0 and next(answers)


THERE = dict(goal=REACHED, pose=(1.0, 0.0, 0.0))
# What becomes of a robot on its way to x = 1 m, from where it would see the spot.
AFTERWARDS = {
    "another goal is another place, and it comes after some patience": [
        phase(steps=20, offers=[place(1.1), place(1)], sees=is_at()),
        phase(steps=1, sent=[3], offers=[place(3)]),
        phase(steps=5, offers=[place(5)]),
        phase(steps=1, sent=[5]),
    ],
    "one that has arrived is not sent to about the same place again": [
        phase(steps=20, **THERE, offers=[place(1.1)], sees=is_at()),
        phase(steps=20, sent=[1.3], offers=[place(1.3)]),
    ],
    "a goal in a border is replaced": [phase(steps=12, sent=[3], room=is_at(3), offers=[place(3)], sees=is_at(1, 3))],
    "flicker at the edge does not change the goal": [phase(steps=60, offers=[place(5)], sees=flicker())],
    "a spot that is lost is no matter of patience": [
        phase(steps=4),
        phase(steps=1, sent=[3], offers=[place(3)], sees=is_at(3), bench=dict(unseen_s=1.0)),
        phase(steps=1, offers=[place(5)], sees=is_at(5)),
        phase(steps=1, sent=[5]),
    ],
    "the robot goes on into the interaction's next state": [phase(steps=20, bench=dict(key=("a", 2)))],
    "the next interaction begins from scratch at once": [phase(steps=1, sent=[1], goal=NONE, bench=dict(key=("b", 1)))],
    "one that was carried away comes back": [phase(steps=10, **THERE), phase(steps=10, sent=[1], pose=(5.0, 0.0, 0.0))],
    "a place that failed is tried later": [phase(steps=int(4 * FAILED_MEMORY), goal=FAILED), phase(steps=8, sent=[1])],
    "a goal's preemptor has the robot for a while": [phase(steps=4 * 15, goal=PREEMPTED), phase(steps=2, sent=[1])],
    "time that jumps back does not silence the policy": [
        phase(steps=1, goal=PREEMPTED),
        phase(steps=1, sent=[1], goal=NONE, bench=dict(now=5.0)),
    ],
}


@pytest.mark.parametrize("phases", AFTERWARDS.values(), ids=AFTERWARDS)
def test_a_robot_is_sent_again_once_what_kept_it_is_over(phases):
    ada = Robot(place(1), sees=is_at(1))
    bench = Bench(ada=ada)
    assert bench.step() == 1
    for steps, sent, robot_changes, bench_changes in phases:
        vars(ada).update(robot_changes)
        vars(bench).update(bench_changes)
        assert bench.run(steps) == sent


def test_each_failure_tries_the_next_place_after_a_longer_pause():
    bench = Bench(ada=Robot(*map(place, range(1, 20))), outcome=FAILED)
    assert bench.run(40)[:5] == [1, 2, 3, 4, 5]
    pauses = np.diff([time for time, _ in bench.sent])
    assert pauses[0] < 1.5, "the person does not wait for a retry"
    assert (np.diff(pauses) >= 0.0).all()
    assert pauses[-1] > 2.0, "and navigation is not asked for ever more plans"


@pytest.mark.parametrize("seen", [True, False])
def test_a_robot_that_makes_progress_keeps_its_goal(seen):
    ada = Robot(place(1), place(2), sees=is_at(1, 2))
    bench = Bench(ada=ada)
    bench.step()
    for i in range(200):
        ada.pose = (9.0 - 0.02 * i, 9.0, 0.0)
        bench.unseen_s = 0.0 if seen else 0.25 * i
        assert not bench.step()
        assert ada.goal is ACTIVE


def test_a_goals_state_follows_navigations_status():
    statuses = GoalStatus.ACTIVE, GoalStatus.SUCCEEDED, GoalStatus.PREEMPTED, GoalStatus.ABORTED
    for before in (SENT, ACTIVE):
        assert [next_goal_state(before, status) for status in statuses] == [ACTIVE, REACHED, PREEMPTED, FAILED]
    assert next_goal_state(SENT, None) is SENT, "it has not arrived yet"
    assert next_goal_state(ACTIVE, None) is FAILED, "navigation was started again"
    assert next_goal_state(REACHED, GoalStatus.ABORTED) is REACHED


def test_a_robot_that_sees_the_spot_stays_until_it_is_lost():
    bench = Bench(ada=Robot(*map(place, (1, 1.2, 2, 3, 4)), sees=is_at(1, 2, 3, 4)), outcome=REACHED)

    def run_unseen(steps):
        """Runs while no camera sees the spot. Returns every x to which the robot was sent."""
        sent = []
        for _ in range(steps):
            bench.unseen_s += 0.25
            sent += bench.run(1)
        return sent

    assert bench.run(61) == [1]
    assert run_unseen(16) == [2], "half a metre away"
    assert run_unseen(44) == [3], "and not forever: the laser may be off"
    bench.unseen_s = 0.0
    bench.run(4)
    bench.now += FAILED_MEMORY
    assert run_unseen(20), "the tries count again"


# ------------------------------------------------------------------ sightings
def sighting(stamp, x, y=0.0, camera="red", mobile=False):
    return Sighting(stamp, (x, y), camera, mobile)


def sightings_since(stamp):
    """Returns the sightings of a drawing that began at a time [s]."""
    sightings = SpotSightings()
    sightings.set_state(BORDER, "1", stamp)
    return sightings


def test_a_false_spot_does_not_move_the_target():
    sightings = sightings_since(10.0)
    sightings.add(sighting(10.0, 0.0))
    assert sightings.target() is None
    for i in range(50):
        sightings.add(sighting(10.0 + 0.04 * i, 0.01 * i))
    sightings.add(sighting(11.97, 7.0, 3.0))
    assert np.linalg.norm(sightings.target() - (0.47, 0.0)) < 0.06
    assert sightings.velocity() == pytest.approx((0.25, 0.0), abs=0.03)


def test_a_new_state_or_interaction_resets_the_sightings():
    sightings = SpotSightings(mobile_cameras=["robot"])
    sightings.add(sighting(1.0, 0.0))
    assert sightings.newest() is None
    assert not sightings.has_stationary_sighting, "Default ignores spots"
    sightings.set_state(BORDER, "1", 10.0)
    sightings.add(sighting(9.0, 0.0))
    assert sightings.newest() is None, "from before the state"
    sightings.add_contributors("1", ["robot"])
    assert not sightings.has_stationary_sighting
    sightings.add(sighting(11.0, 0.0, camera="robot", mobile=True))
    assert_fields(sightings, first_mobile_stamp=11.0, has_stationary_sighting=False)
    sightings.add_contributors("other", ["green"])
    assert not sightings.has_stationary_sighting
    sightings.add_contributors("1", ["robot", "green"])
    assert sightings.has_stationary_sighting
    sightings.set_state(SEED, "1", 12.0)
    assert sightings.has_stationary_sighting
    assert sightings.newest() is None
    sightings.set_state(DEFAULT, "", 13.0)
    sightings.set_state(BORDER, "2", 14.0)
    assert_fields(sightings, first_mobile_stamp=None, has_stationary_sighting=False)


def test_a_stationary_camera_watches_a_spot_that_it_saw_lately():
    sightings = sightings_since(0.0)
    sightings.add(sighting(1.0, 0.0))
    sightings.add(sighting(2.5, 0.0, camera="robot", mobile=True))
    assert not sightings.seen_by_stationary(2.5), "only the robot sees it"
    sightings.add(sighting(2.6, 0.0))
    assert all(map(sightings.seen_by_stationary, (2.6, 3.2))), "cameras miss some images"
    assert not sightings.seen_by_stationary(3.5)
    sightings.set_state(SEED, "1", 3.0)
    assert not sightings.seen_by_stationary(3.0)
    sightings.add(sighting(3.1, 0.0))
    assert sightings.seen_by_stationary(9.0), "the seed stays where it was seen"


def test_the_time_since_the_spot_was_seen_counts_while_drawing():
    sightings = sightings_since(0.0)
    assert sightings.time_since_seen(5.0) == 0.0, "nobody has begun to draw"
    sightings.add(sighting(1.0, 0.0))
    assert sightings.time_since_seen(1.2) == pytest.approx(0.2)
    sightings.set_state(SEED, "1", 9.0)
    sightings.add(sighting(9.5, 0.0))
    assert sightings.time_since_seen(12.0) == 0.0, "the seed does not move"


@pytest.mark.parametrize("speed", [0.25, 0.5, 1.5])  # [m/s] along x, then along y
def test_a_spots_velocity_points_along_the_end_of_its_line(speed):
    straight = {}
    sightings = sightings_since(0.0)
    for i in range(200):
        distance = 0.04 * speed * i
        sightings.add(sighting(1.0 + 0.04 * i, min(distance, 0.6), max(distance - 0.6, 0.0)))
        if sightings.velocity() is not None:
            straight[round(distance, 2)] = sightings.velocity() / np.linalg.norm(sightings.velocity())
    on_x = [v for distance, v in straight.items() if distance <= 0.6]
    on_y = [v for distance, v in straight.items() if distance > 0.6 + max(0.3, 0.04 * speed * 6)]
    assert np.abs(np.subtract(on_x, (1.0, 0.0))).max() <= 0.1
    assert np.abs(np.subtract(on_y, (0.0, 1.0))).max() <= 0.4


def test_a_resting_spot_has_no_velocity_even_if_cameras_disagree():
    sightings, rng = sightings_since(0.0), np.random.default_rng(0)
    for i in range(40):
        sightings.add(sighting(1.0 + 0.04 * i, *rng.normal(0.0, 0.005, 2)))
    assert sightings.velocity() is None
    for i in range(40, 52):
        sightings.add(sighting(1.0 + 0.04 * i, 0.0))
        sightings.add(sighting(1.02 + 0.04 * i, 0.06, camera="robot", mobile=True))
        assert sightings.velocity() is None, "the robot sees it 6 cm off"


# ------------------------------------------------------------------ several robots: ada's places are below 20 m
def test_the_robot_with_the_shorter_path_goes_and_keeps_going():
    ada = Robot(place(5))
    assert Bench(ada=ada, bob=Robot(place(20, 2.0), sees=is_at(20)), eve=Robot()).run(40) == [20]
    assert ada.searches == 1, "nothing is worked out while the goal is fit"


def test_a_robot_that_already_sees_the_spot_is_not_sent():
    bench = Bench(ada=Robot(place(1)), bob=Robot(place(20, 2.0), sees=is_at(9)))
    assert not bench.run(20)
    assert bench.policy.serving == "bob"


def test_a_free_robot_is_sent_before_a_busy_one():
    busy = Robot(place(1), sees=is_at(1), is_busy=True)
    assert Bench(ada=busy, bob=Robot(place(20, 6.0), sees=is_at(20))).run(20) == [20]
    assert Bench(ada=busy).run(20) == [1], "if there is no other, the person comes first"


@pytest.mark.parametrize(
    "fault, limit",
    [
        ({"goal": FAILED}, 0.0),
        ({"goal": PREEMPTED}, 0.0),
        ({"has_navigation": False}, 0.0),
        ({"localized": False}, 0.0),
        ({"goal": SENT}, 4.0),  # its navigation never accepts the goal
        ({}, 15.0),  # it is stuck
    ],
)
def test_another_robot_takes_over_when_one_fails(fault, limit):
    ada = Robot(place(1), place(2), sees=is_at(1, 2))
    bench = Bench(ada=ada, bob=Robot(place(20, 3.0), sees=is_at(20)))
    assert bench.step() == 1
    vars(ada).update(fault)
    assert not bench.run(int(4 * limit) - 1)
    assert bench.run(5) == [20]
    assert bench.policy.serving == "bob", "at once, or when the time is up"


def test_a_robot_that_failed_comes_after_one_that_did_not():
    ada, bob = Robot(place(1), place(2)), Robot(place(20, 3.0))
    bench = Bench(ada=ada, bob=bob)
    bench.step()
    ada.goal = FAILED
    for has_map, steps in ((False, 20), (True, 1)):  # until ada's pause after the failure is over
        ada.has_map = bob.has_map = has_map
        bench.run(steps)
    assert bench.policy.serving == "bob"


def test_two_robots_about_equally_near_do_not_take_turns():
    ada, bob = Robot(), Robot()
    bench = Bench(ada=ada, bob=bob)
    sent = []
    for i in range(30):
        # the spot moves on, and each robot is a little nearer in turn
        shift = 0.3 * (-1) ** i
        ada.offers, bob.offers = [place(1 + 0.5 * i, 2.0 - shift)], [place(20 + 0.5 * i, 2.0 + shift)]
        sent += bench.run(8)
    assert len(sent) > 10
    assert max(sent) < 20


def test_a_notably_nearer_robot_takes_over_from_another():
    ada, bob = Robot(place(2)), Robot(place(20, 5.0), sees=is_at(20))
    bench = Bench(ada=ada, bob=bob)
    assert bench.step() == 2
    ada.offers, bob.offers = [place(9, 2.2)], [place(20, 1.0)]
    assert bench.run(20) == [20]
    assert ada.goal is NONE


def test_a_robot_leaving_the_seeds_side_is_not_replaced():
    ada, bob = Robot(place(1, sees_spot=False)), Robot()
    bench = Bench(ada=ada, bob=bob)
    assert bench.run(4) == [1]
    bob.offers = [place(20, 1.0)]
    assert not bench.run(40)
    ada.goal = REACHED
    assert bench.run(8) == [20], "until it is off"


def test_robots_are_sent_only_while_one_is_wanted():
    ada = Robot(place(2))
    bench = Bench(ada=ada, bob=Robot(place(20)))
    for robot_wanted, sent, goal in ((False, [], NONE), (True, [2], ACTIVE), (False, [], NONE)):
        bench.robot_wanted = robot_wanted
        assert bench.run(10) == sent
        assert ada.goal is goal
        assert (bench.policy.serving is None) is not robot_wanted
