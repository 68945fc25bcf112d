"""The dispatch policy, and what is known about the spot."""

import math

import numpy as np
import pytest
from actionlib_msgs.msg import GoalStatus

from vb_core.vocabulary import BORDER, DEFAULT, SEED
from vb_robot.dispatching.dispatch_policy import FAILED_MEMORY, PROGRESS_TIMEOUTS, Fleet, RobotStatus, SentGoalState
from vb_robot.dispatching.dispatched_robot import follow
from vb_robot.dispatching.viewpoint import Viewpoint
from vb_robot.spots import Sighting, Sightings


def place(x, y=0.0):
    return Viewpoint((x, y, 0.0), x)


class Robot:
    """One robot of the bench: what it can see and where it could go, and what navigation says."""

    def __init__(self, *costs, x0=0.0, candidates=None, seen=lambda pose: False):
        self.candidates = [Viewpoint((x0 + i, 0.0, 0.0), cost) for i, cost in enumerate(costs)]
        self.candidates = self.candidates if candidates is None else candidates
        self.goal, self.pose, self.sees, self.sent = SentGoalState.NONE, (x0 + 50.0, 50.0, 0.0), seen, []
        self.busy, self.server, self.localized, self.knows = False, True, True, True
        self.asked, self.given = 0, None
        self.room = lambda pose: True

    # as an ViewpointPlanner
    def shows_target(self, pose):
        return self.sees(pose)

    def has_room_at(self, pose):
        return self.room(pose)

    def best_viewpoint(self, robot, avoid):
        self.asked += 1
        free = [
            found
            for found in self.candidates
            if all(math.dist(found.pose[:2], entry[:2]) >= entry[2] for entry in avoid)
        ]
        return free[0] if free else None


class Fleets:
    """Steps a fleet at 4 Hz; goals that are given begin at once, and end when they are cancelled."""

    def __init__(self, **robots):
        self.robots, self.fleet = robots, Fleet(robots)
        self.now, self.wanted, self.key, self.silent = 100.0, True, ("a", 1), 0.0

    def step(self):
        """Returns what was sent to whom."""
        self.now += 0.25
        seeing = {}
        for name, robot in self.robots.items():
            status = RobotStatus(robot.pose if robot.localized else None, robot.server, robot.goal, robot.busy)
            seeing[name] = (status, robot if robot.knows else None)
        goals = self.fleet.step(self.now, self.key if self.wanted else None, self.silent, seeing)
        assert set(goals) == set(self.robots) and sum(goal is not None for goal in goals.values()) <= 1
        new = {name: goal for name, goal in goals.items() if goal is not self.robots[name].given}
        for name, goal in new.items():
            robot, (status, _) = self.robots[name], seeing[name]
            robot.given = goal
            if goal is not None:
                robot.sent.append(goal)
                robot.goal = SentGoalState.ACTIVE
            elif status.goal.under_way:
                robot.goal = SentGoalState.NONE
        return {name: goal for name, goal in new.items() if goal is not None}

    def run(self, steps):
        for _ in range(steps):
            self.step()
        return {name: len(robot.sent) for name, robot in self.robots.items()}

    def serve(self, name):
        """The robot's goal shows the spot."""
        robot = self.robots[name]
        robot.sees = lambda pose: bool(robot.sent) and pose == robot.sent[-1].pose


class Bench(Fleets):
    """A fleet of one; what was sent is a viewpoint, or None."""

    def __init__(self, candidates, seen=lambda pose: False):
        self.robot = Robot(candidates=candidates, seen=seen)
        self.robot.pose = (9.0, 9.0, 0.0)
        super().__init__(robot=self.robot)

    def __getattr__(self, name):
        return getattr(self.robot, name)

    def step(self, **changes):
        for name, value in changes.items():
            setattr(self.robot if hasattr(self.robot, name) else self, name, value)
        return super().step().get("robot")

    def run(self, steps, **changes):
        """Returns all that was sent."""
        return [sent for sent in (self.step(**changes) for _ in range(steps)) if sent]


@pytest.mark.parametrize("missing", [dict(wanted=False), dict(server=False), dict(knows=False), dict(localized=False)])
def test_sends_nothing_without(missing):
    assert not Bench([place(1)]).run(10, **missing)


def test_next_candidate_after_failure_and_longer_pauses_after_many():
    bench = Bench([place(i) for i in range(1, 20)])
    tried = []
    for _ in range(40):
        goal = bench.step()
        if goal:
            tried.append((bench.now, goal.pose[0]))
            bench.robot.goal = SentGoalState.FAILED
    assert [x for _, x in tried[:5]] == [1, 2, 3, 4, 5]
    assert tried[1][0] - tried[0][0] < 1.5, "the person does not wait for a retry"
    pauses = np.diff([when for when, _ in tried])
    assert (np.diff(pauses) >= 0.0).all() and pauses[-1] > 2.0, "and navigation is not asked for ever more plans"


def test_a_place_that_failed_is_tried_again_after_a_while():
    bench = Bench([place(1)], seen=lambda pose: pose[0] == 1)
    bench.step()
    failed, bench.robot.goal = bench.now, SentGoalState.FAILED
    assert not bench.run(int(4 * (FAILED_MEMORY - 1.0)))
    assert bench.run(20) == [place(1)] and bench.now > failed + FAILED_MEMORY


def test_goal_is_replaced_only_after_patience_and_for_another_place():
    bench = Bench([place(1)], seen=lambda pose: pose[0] == 1)
    bench.step()
    bench.robot.candidates, bench.robot.sees = [place(1.1), place(1)], lambda pose: False
    assert not bench.run(20), "0.1 m away is not another place"
    bench.robot.candidates = [place(3)]
    assert bench.run(20) == [place(3)]


def test_a_robot_that_has_arrived_is_not_sent_to_about_the_same_place_again():
    bench = Bench([place(1)], seen=lambda pose: pose[0] == 1)
    bench.step()
    bench.robot.goal, bench.robot.pose = SentGoalState.REACHED, (1.0, 0.0, 0.0)
    bench.robot.candidates, bench.robot.sees = [place(1.1)], lambda pose: False
    assert not bench.run(20)
    bench.robot.candidates = [place(1.3)]
    assert bench.run(20)


def test_a_goal_that_a_new_border_takes_is_replaced():
    bench = Bench([place(1), place(3)], seen=lambda pose: pose[0] in (1, 3))
    bench.step()
    bench.robot.room, bench.robot.candidates = lambda pose: pose[0] != 1, [place(3)]
    assert bench.run(12) == [place(3)]


def test_flicker_at_the_edge_does_not_change_the_goal():
    flicker = iter([True, False] * 100)
    bench = Bench([place(1)], seen=lambda pose: pose[0] != 9.0 and next(flicker))
    bench.step()
    bench.robot.candidates = [place(5)]
    assert not bench.run(60)


@pytest.mark.parametrize("seen", [True, False])
def test_progress_keeps_the_goal_whether_the_spot_is_seen_or_not(seen):
    bench = Bench([place(1), place(2)], seen=lambda pose: pose[0] in (1, 2))
    bench.step()
    for i in range(200):
        assert not bench.step(pose=(9.0 - 0.02 * i, 9.0, 0.0), silent=0.0 if seen else 0.25 * i)
        assert bench.robot.goal is SentGoalState.ACTIVE


def test_leaves_the_robot_to_the_node_that_preempted_the_goal():
    bench = Bench([place(1)])
    bench.step()
    bench.robot.goal = SentGoalState.PREEMPTED
    assert not bench.run(int(4 * 14))
    assert bench.run(20)


def test_time_that_jumps_back_does_not_silence_it():
    bench = Bench([place(1)])
    bench.step()
    bench.robot.goal = SentGoalState.PREEMPTED
    bench.step()
    bench.now, bench.robot.goal = 5.0, SentGoalState.NONE
    assert bench.run(10)


def test_what_navigation_says_of_a_goal_ends_it_or_keeps_it_on_its_way():
    for before in (SentGoalState.SENT, SentGoalState.ACTIVE):
        said = [follow(before, getattr(GoalStatus, name)).name for name in "ACTIVE SUCCEEDED PREEMPTED ABORTED".split()]
        assert said == ["ACTIVE", "REACHED", "PREEMPTED", "FAILED"]
    assert follow(SentGoalState.SENT, None) is SentGoalState.SENT, "it has not arrived yet"
    assert follow(SentGoalState.ACTIVE, None) is SentGoalState.FAILED, "navigation was started again"
    assert follow(SentGoalState.REACHED, GoalStatus.ABORTED) is SentGoalState.REACHED


# ------------------------------------------------------------------ sightings
def seen(stamp, x, y=0.0, camera="red", mobile=False):
    return Sighting(stamp, (x, y), camera, mobile)


def drawing_since(stamp):
    """The record of somebody who has begun to draw at a time [s]."""
    known = Sightings()
    known.set_state(BORDER, "1", stamp)
    return known


def test_target_follows_and_a_false_spot_does_not_move_it():
    known = drawing_since(10.0)
    known.add(seen(10.0, 0.0))
    assert known.target() is None
    for i in range(50):
        known.add(seen(10.0 + 0.04 * i, 0.01 * i))
    known.add(seen(11.97, 7.0, 3.0))
    assert np.linalg.norm(known.target() - (0.47, 0.0)) < 0.06
    assert known.velocity() == pytest.approx((0.25, 0.0), abs=0.03)


def test_what_is_remembered_for_how_long():
    known = Sightings(mobile_cameras=["robot"])
    known.add(seen(1.0, 0.0))
    assert known.newest() is None and not known.stationary_seen, "Default ignores spots"
    known.set_state(BORDER, "1", 10.0)
    known.add(seen(9.0, 0.0))
    assert known.newest() is None, "from before the state"
    known.add_contributors("1", ["robot"])
    assert not known.stationary_seen
    known.add(seen(11.0, 0.0, camera="robot", mobile=True))
    assert known.first_mobile == 11.0 and not known.stationary_seen
    known.add_contributors("other", ["green"])
    assert not known.stationary_seen
    known.add_contributors("1", ["robot", "green"])
    assert known.stationary_seen
    known.set_state(SEED, "1", 12.0)
    assert known.stationary_seen and known.newest() is None
    known.set_state(DEFAULT, "", 13.0)
    known.set_state(BORDER, "2", 14.0)
    assert not known.stationary_seen and known.first_mobile is None


def test_who_watches_the_spot():
    known = drawing_since(0.0)
    known.add(seen(1.0, 0.0))
    known.add(seen(2.5, 0.0, camera="robot", mobile=True))
    assert not known.seen_by_stationary(2.5), "only the robot sees it"
    known.add(seen(2.6, 0.0))
    assert known.seen_by_stationary(2.6) and known.seen_by_stationary(3.2), "cameras miss some images"
    assert not known.seen_by_stationary(3.5)
    known.set_state(SEED, "1", 3.0)
    assert not known.seen_by_stationary(3.0)
    known.add(seen(3.1, 0.0))
    assert known.seen_by_stationary(9.0), "the seed stays where it was seen"


def test_how_long_nobody_has_seen_the_spot():
    known = drawing_since(0.0)
    assert known.time_since_seen(5.0) == 0.0, "nobody has begun to draw"
    known.add(seen(1.0, 0.0))
    assert known.time_since_seen(1.2) == pytest.approx(0.2)
    known.set_state(SEED, "1", 9.0)
    known.add(seen(9.5, 0.0))
    assert known.time_since_seen(12.0) == 0.0, "the seed does not move"


def test_a_line_goes_on_as_its_last_piece_does_however_quick_the_hand():
    for speed in (0.25, 0.5, 1.5):  # [m/s] along x, then along y
        known, straight = drawing_since(0.0), {}
        for i in range(200):
            way = 0.04 * speed * i
            known.add(seen(1.0 + 0.04 * i, min(way, 0.6), max(way - 0.6, 0.0)))
            if known.velocity() is not None:
                straight[round(way, 2)] = known.velocity() / np.linalg.norm(known.velocity())
        before = [v for way, v in straight.items() if way <= 0.6]
        after = [v for way, v in straight.items() if way > 0.6 + max(0.3, 0.04 * speed * 6)]
        assert len(before) and np.allclose(before, (1.0, 0.0), atol=0.1)
        assert len(after) and np.allclose(after, (0.0, 1.0), atol=0.4)


def test_a_spot_that_rests_has_no_direction_and_cameras_that_differ_are_no_motion():
    known, rng = drawing_since(0.0), np.random.default_rng(0)
    for i in range(40):
        known.add(seen(1.0 + 0.04 * i, *rng.normal(0.0, 0.005, 2)))
    assert known.velocity() is None
    for i in range(40, 52):
        known.add(seen(1.0 + 0.04 * i, 0.0))
        known.add(seen(1.02 + 0.04 * i, 0.06, camera="robot", mobile=True))
        assert known.velocity() is None, "the robot sees it 6 cm off"


# ------------------------------------------------------------------ a robot that stands and sees nothing
def blind_bench():
    """A robot that has come to where it should see the spot, and whose camera reports nothing."""
    bench = Bench([place(1), place(1.2), place(2), place(3)], seen=lambda pose: pose[0] in (1, 2, 3))
    bench.step(silent=0.0)
    bench.robot.goal = SentGoalState.REACHED
    bench.robot.pose = (1.0, 0.0, 0.0)
    return bench


def stand(bench, steps):
    """Steps while the spot stays unseen; a robot that is sent arrives at once. Gives (time since, place) of goals."""
    goals, began = [], bench.now
    for _ in range(steps):
        goal = bench.step(silent=bench.now + 0.25 - began)
        if goal:
            goals.append((bench.now - began, goal))
            bench.robot.goal, bench.robot.pose = SentGoalState.REACHED, goal.pose
    return goals


def test_robot_that_sees_the_spot_stays_and_may_try_again_when_it_is_lost_again():
    bench = blind_bench()
    assert not bench.run(60, silent=0.0)
    assert len(stand(bench, 60)) == 2
    bench.run(4, silent=0.0)
    bench.now += FAILED_MEMORY
    assert stand(bench, 20), "the tries count again"


def test_lost_spot_is_not_a_matter_of_patience():
    bench = Bench([place(1)], seen=lambda pose: pose[0] == 1)
    bench.step()
    bench.run(4)
    bench.robot.candidates, bench.robot.sees = [place(3)], lambda pose: pose[0] == 3
    assert bench.step(silent=1.0)


def test_next_interaction_begins_from_scratch_even_if_no_decision_fell_between():
    bench = Bench([place(1)], seen=lambda pose: pose[0] == 1)
    bench.step()
    bench.robot.goal = SentGoalState.NONE  # cancelled with the state
    assert bench.step(key=("b", 1))


def test_robot_that_was_carried_away_comes_back():
    bench = Bench([place(1)], seen=lambda pose: pose[0] == 1)
    bench.step()
    bench.robot.goal = SentGoalState.REACHED
    assert not bench.run(10, pose=(1.0, 0.0, 0.0))
    assert bench.run(10, pose=(5.0, 0.0, 0.0)) == [place(1)]


# ------------------------------------------------------------------ several robots
def test_the_one_with_the_shorter_path_goes_and_keeps_going():
    bench = Fleets(ada=Robot(5.0), bob=Robot(2.0), eve=Robot())
    bench.serve("bob")
    assert bench.run(40) == {"ada": 0, "bob": 1, "eve": 0}
    assert bench.robots["ada"].asked == 1, "nothing is worked out while the goal is fit"


def test_a_robot_that_sees_the_spot_from_where_it_is_need_not_be_sent():
    bench = Fleets(ada=Robot(1.0), bob=Robot(2.0))
    bench.robots["bob"].sees = lambda pose: True
    assert bench.run(20) == {"ada": 0, "bob": 0}
    assert bench.fleet.serving == "bob"


def test_a_free_robot_comes_before_one_that_somebody_else_sent():
    bench = Fleets(ada=Robot(1.0), bob=Robot(6.0))
    bench.robots["ada"].busy = True
    bench.serve("bob")
    assert bench.run(20) == {"ada": 0, "bob": 1}
    alone = Fleets(ada=Robot(1.0))
    alone.robots["ada"].busy = True
    alone.serve("ada")
    assert alone.run(20) == {"ada": 1}, "if there is no other, the person comes first"


@pytest.mark.parametrize(
    "fault, limit",
    [
        ({"goal": SentGoalState.FAILED}, 0.0),
        ({"goal": SentGoalState.PREEMPTED}, 0.0),
        ({"server": False}, 0.0),
        ({"localized": False}, 0.0),
        ({"goal": SentGoalState.SENT}, PROGRESS_TIMEOUTS["sent"]),  # its navigation never accepts it
        ({}, PROGRESS_TIMEOUTS["active"]),  # it is stuck
    ],
)
def test_another_takes_over_when_one_fails(fault, limit):
    bench = Fleets(ada=Robot(1.0, 1.5), bob=Robot(3.0, x0=20.0))
    bench.serve("ada")
    bench.serve("bob")
    bench.step()
    ada, bob = bench.robots["ada"], bench.robots["bob"]
    assert len(ada.sent) == 1 and not bob.sent
    vars(ada).update(fault)
    steps = 0
    while not bob.sent and steps < 400:
        bench.step()
        steps += 1
    assert bob.sent and 0.25 * steps <= limit + 1.0, "at once, or when the time is up"
    assert len(ada.sent) == 1 and bench.fleet.serving == "bob"


def test_goes_back_to_the_first_when_the_second_fails_too():
    bench = Fleets(ada=Robot(1.0, 1.5, 2.0), bob=Robot(3.0, x0=20.0))
    order = []
    for _ in range(40):
        for name, goal in bench.step().items():
            order.append((name, goal.pose[0]))
            bench.robots[name].goal = SentGoalState.FAILED
    assert order[:3] == [("ada", 0.0), ("bob", 20.0), ("ada", 1.0)], "each place is tried once"


def test_one_that_has_failed_comes_after_one_that_has_not():
    bench = Fleets(ada=Robot(1.0, 1.5), bob=Robot(3.0, x0=20.0))
    bench.step()
    bench.robots["ada"].goal = SentGoalState.FAILED
    for knows, steps in ((False, 20), (True, 1)):  # until ada need not rest any more
        for robot in bench.robots.values():
            robot.knows = knows
        bench.run(steps)
    assert bench.fleet.serving == "bob"


def test_two_that_are_about_equally_near_do_not_take_turns():
    bench = Fleets(ada=Robot(2.0), bob=Robot(2.2, x0=20.0))
    bench.step()
    ada, bob = bench.robots["ada"], bench.robots["bob"]
    for i in range(30):
        # the spot goes on, now this one is a little nearer, now that one
        for robot, shift in ((ada, 0.3), (bob, -0.3)):
            cost = 2.0 + shift * (-1) ** i
            robot.candidates = [Viewpoint((robot.candidates[0].pose[0] + 0.5, 0.0, 0.0), cost)]
        for _ in range(8):
            bench.step()
    assert len(ada.sent) > 10 and not bob.sent


def test_one_that_is_notably_nearer_takes_over_and_the_other_is_cancelled():
    bench = Fleets(ada=Robot(2.0), bob=Robot(5.0, x0=20.0))
    bench.step()
    bench.robots["ada"].candidates = [Viewpoint((9.0, 0.0, 0.0), 9.0)]
    bench.robots["bob"].candidates = [Viewpoint((11.0, 0.0, 0.0), 1.0)]
    bench.serve("bob")
    bench.run(20)
    assert len(bench.robots["bob"].sent) == 1 and bench.robots["ada"].goal is SentGoalState.NONE


def test_a_robot_on_its_way_off_the_seeds_side_goes_on_although_another_would_see_the_spot():
    bench = Fleets(ada=Robot(candidates=[Viewpoint((1.0, 0.0, 0.0), 1.0, sees_spot=False)]), bob=Robot())
    bench.run(4)
    bench.robots["bob"].candidates = [Viewpoint((2.0, 0.0, 0.0), 1.0)]
    assert bench.run(40) == {"ada": 1, "bob": 0} and bench.fleet.serving == "ada"
    bench.robots["ada"].goal = SentGoalState.REACHED
    assert bench.run(8)["bob"] == 1, "until it is off"


def test_all_are_cancelled_when_none_is_wanted():
    bench = Fleets(ada=Robot(2.0), bob=Robot(5.0))
    bench.step()
    bench.wanted, bench.key = False, ("", 0)
    assert not bench.step() and bench.robots["ada"].goal is SentGoalState.NONE and bench.fleet.serving is None
