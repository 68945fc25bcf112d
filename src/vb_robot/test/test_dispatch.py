"""The dispatch policy and what it knows about the spot."""
import numpy as np
import pytest

from vb_core.errors import ParameterError
from vb_robot.dispatch import DispatchParams, DispatchPolicy, GoalStatus, Kind, Situation
from vb_robot.spots import BORDER, DEFAULT, SEED, Sighting, Sightings
from vb_robot.viewpoint import Viewpoint


def place(x, y=0.0, spot=(0.0, 0.0)):
    return Viewpoint(x, y, 0.0, 1.0, x, spot)


class Bench:
    """Steps a policy at 4 Hz; `seen` tells from which poses the spot is seen."""

    def __init__(self, candidates, seen=lambda pose: False):
        self.policy = DispatchPolicy(DispatchParams())
        self.candidates, self.seen = candidates, seen
        self.now, self.goal, self.asked = 100.0, GoalStatus.NONE, 0
        self.safe = True
        self.situation = dict(wanted=True, key=("1", 1), spot=(0.0, 0.0), robot=(9.0, 9.0, 0.0), server=True)

    def step(self, **changes):
        self.situation.update(changes)
        self.now += 0.25

        def rank():
            self.asked += 1
            return self.candidates

        situation = Situation(now=self.now, goal=self.goal, **self.situation)
        decision = self.policy.step(situation, self.seen, rank, lambda viewpoint: self.safe)
        if decision.kind is Kind.SEND:
            self.goal = GoalStatus.ACTIVE
        elif decision.kind is Kind.CANCEL:
            self.goal = GoalStatus.NONE
        return decision

    def run(self, steps, **changes):
        return [self.step(**changes) for _ in range(steps)]


def sent(decisions):
    return [decision.viewpoint for decision in decisions if decision.kind is Kind.SEND]


def test_sends_the_best_once_and_keeps_it_while_it_is_fit():
    bench = Bench([place(1), place(2)], seen=lambda pose: pose[0] == 1)
    assert sent(bench.run(40)) == [place(1)]
    assert bench.asked == 1, "nothing is worked out while the goal is fit"


def test_sends_nothing_when_the_robot_sees_the_spot_already():
    assert not sent(Bench([place(1)], seen=lambda pose: True).run(10))


@pytest.mark.parametrize("missing", [dict(wanted=False), dict(server=False), dict(spot=None), dict(robot=None)])
def test_sends_nothing_without(missing):
    assert not sent(Bench([place(1)]).run(10, **missing))


def test_cancels_at_once_when_no_longer_wanted():
    bench = Bench([place(1)], seen=lambda pose: pose[0] == 1)
    bench.step()
    assert bench.step(wanted=False, key=("", 0)).kind is Kind.CANCEL
    assert bench.step().kind is Kind.KEEP


def test_next_candidate_after_failure_and_pause_after_many():
    bench = Bench([place(i) for i in range(1, 20)])
    tried = []
    for _ in range(40):
        decision = bench.step()
        if decision.kind is Kind.SEND:
            tried.append((bench.now, decision.viewpoint.x))
            bench.goal = GoalStatus.FAILED
    assert [x for _, x in tried[:5]] == [1, 2, 3, 4, 5]
    assert tried[1][0] - tried[0][0] < 1.5, "the person does not wait for a retry"
    assert len(tried) == 5 or tried[5][0] - tried[4][0] >= DispatchParams().failure_pause


def test_goal_is_replaced_only_after_patience_and_for_another_place():
    bench = Bench([place(1)], seen=lambda pose: pose[0] == 1)
    bench.step()
    bench.candidates, bench.seen = [place(1.1), place(1)], lambda pose: False
    assert not sent(bench.run(20, spot=(1.0, 0.0))), "0.1 m away is not another place"
    bench.candidates = [place(3, spot=(1.0, 0.0))]
    decisions = bench.run(20)
    assert sent(decisions) == [place(3, spot=(1.0, 0.0))]


def test_flicker_at_the_edge_does_not_change_the_goal():
    flicker = iter([True, False] * 100)
    bench = Bench([place(1)], seen=lambda pose: pose[0] != 9.0 and next(flicker))
    bench.step()
    bench.candidates = [place(5)]
    assert not sent(bench.run(60))


def test_stuck_or_unacknowledged_goal_is_given_up():
    bench = Bench([place(1), place(2)], seen=lambda pose: pose[0] in (1, 2))
    bench.step()
    decisions = bench.run(70)
    assert [d.kind for d in decisions].count(Kind.CANCEL) == 1 and sent(decisions)[0] == place(2)
    bench = Bench([place(1), place(2)], seen=lambda pose: pose[0] in (1, 2))
    bench.step()
    bench.goal = GoalStatus.SENT
    assert any(d.kind is Kind.CANCEL for d in bench.run(20))


def test_progress_keeps_the_goal():
    bench = Bench([place(1), place(2)], seen=lambda pose: pose[0] in (1, 2))
    bench.step()
    for i in range(200):
        assert bench.step(robot=(9.0 - 0.02 * i, 9.0, 0.0)).kind is Kind.KEEP


def test_leaves_the_robot_to_whoever_took_it():
    bench = Bench([place(1)])
    bench.step()
    bench.goal = GoalStatus.TAKEN
    assert not sent(bench.run(int(4 * 14)))
    assert sent(bench.run(20))


def test_server_that_dies_and_comes_back():
    bench = Bench([place(1)], seen=lambda pose: pose[0] == 1)
    bench.step()
    bench.run(5, server=False)
    bench.goal = GoalStatus.FAILED
    assert sent(bench.run(10, server=True)) == [place(1)]


def test_time_that_jumps_back_does_not_silence_it():
    bench = Bench([place(1)])
    bench.step()
    bench.goal = GoalStatus.TAKEN
    bench.step()
    bench.now, bench.goal = 5.0, GoalStatus.NONE
    assert sent(bench.run(10))


def test_goal_whose_way_has_become_a_crossing_is_replaced_or_called_off():
    bench = Bench([place(1), place(3)], seen=lambda pose: pose[0] in (1, 3))
    bench.step()
    assert not sent(bench.run(10))
    bench.safe, bench.candidates = False, [place(3)]
    assert place(3) in sent(bench.run(4))
    bench.candidates = []
    kinds = [decision.kind for decision in bench.run(4)]
    assert Kind.CANCEL in kinds and bench.goal is GoalStatus.NONE
    assert not sent(bench.run(20)), "it stays where it is"


def test_bad_parameters():
    with pytest.raises(ParameterError, match="max_failures"):
        DispatchParams(max_failures=0)
    with pytest.raises(ParameterError, match="unknown"):
        DispatchParams.from_mapping({"pateince": 1.0})


# ------------------------------------------------------------------ sightings
def seen(stamp, x, y=0.0, camera="red", mobile=False):
    return Sighting(stamp, (x, y), camera, mobile)


def test_target_follows_and_a_false_spot_does_not_move_it():
    known = Sightings()
    known.set_state(BORDER, "1", 10.0)
    known.add(seen(10.0, 0.0))
    assert known.target() is None
    for i in range(50):
        known.add(seen(10.0 + 0.04 * i, 0.01 * i))
    known.add(seen(11.97, 7.0, 3.0))
    assert np.linalg.norm(known.target() - (0.47, 0.0)) < 0.06
    assert known.direction() == pytest.approx((1.0, 0.0), abs=0.1)


def test_spot_that_rests_has_no_direction():
    known = Sightings()
    known.set_state(BORDER, "1", 0.0)
    rng = np.random.default_rng(0)
    for i in range(40):
        known.add(seen(1.0 + 0.04 * i, *(rng.normal(0.0, 0.005, 2))))
    assert known.direction() is None


def test_what_is_remembered_for_how_long():
    known = Sightings(mobile_cameras=["robot"])
    known.add(seen(1.0, 0.0))
    assert known.newest() is None and not known.stationary_seen, "Default ignores spots"
    known.set_state(BORDER, "1", 10.0)
    known.add(seen(9.0, 0.0))
    assert known.newest() is None, "from before the state"
    known.contributed(["robot"])
    assert not known.stationary_seen
    known.add(seen(11.0, 0.0, camera="robot", mobile=True))
    assert known.first_mobile == 11.0 and not known.stationary_seen
    known.contributed(["robot", "green"])
    assert known.stationary_seen
    known.set_state(SEED, "1", 12.0)
    assert known.stationary_seen and known.newest() is None
    known.set_state(DEFAULT, "", 13.0)
    known.set_state(BORDER, "2", 14.0)
    assert not known.stationary_seen and known.first_mobile is None


def test_who_watches_the_spot():
    known = Sightings()
    known.set_state(BORDER, "1", 0.0)
    known.add(seen(1.0, 0.0))
    known.add(seen(2.5, 0.0, camera="robot", mobile=True))
    assert not known.watched(2.5), "only the robot sees it"
    known.add(seen(2.6, 0.0))
    assert known.watched(2.6) and known.watched(3.2), "cameras miss some images"
    assert not known.watched(3.5)
    known.set_state(SEED, "1", 3.0)
    assert not known.watched(3.0)
    known.add(seen(3.1, 0.0))
    assert known.watched(9.0), "the seed stays where it was seen"


def test_how_long_nobody_has_seen_the_spot():
    known = Sightings()
    known.set_state(BORDER, "1", 0.0)
    assert known.silent(5.0) == 0.0, "nobody has begun to draw"
    known.add(seen(1.0, 0.0))
    assert known.silent(1.2) == pytest.approx(0.2)
    known.set_state(SEED, "1", 9.0)
    known.add(seen(9.5, 0.0))
    assert known.silent(12.0) == 0.0, "the seed does not move"


def test_spot_that_turns_has_no_direction_and_cameras_that_differ_make_none():
    known = Sightings()
    known.set_state(BORDER, "1", 0.0)
    corner = [(0.02 * min(i, 12), 0.02 * max(i - 12, 0)) for i in range(25)]
    for i, (x, y) in enumerate(corner):
        known.add(seen(1.0 + 0.04 * i, x, y))
    assert known.direction() is None
    for i in range(25):
        known.add(seen(2.0 + 0.04 * i, corner[-1][0], corner[-1][1] + 0.02 * i))
    assert known.direction() == pytest.approx((0.0, 1.0), abs=0.1)
    known = Sightings()
    known.set_state(BORDER, "1", 0.0)
    for i in range(25):
        known.add(seen(1.0 + 0.04 * i, 0.0))
        if i > 12:
            known.add(seen(1.02 + 0.04 * i, 0.06, camera="robot", mobile=True))
    assert known.direction() is None, "it rests, and the robot sees it 6 cm off"


# ------------------------------------------------------------------ a robot that stands and sees nothing
def blind_bench(**changes):
    """A robot that has come to where it should see the spot, and whose camera reports nothing."""
    bench = Bench([place(1), place(1.2), place(2), place(3)], seen=lambda pose: pose[0] in (1, 2, 3))
    bench.step(silent=0.0)
    bench.goal = GoalStatus.REACHED
    bench.situation.update(robot=(1.0, 0.0, 0.0), **changes)
    return bench


def stand(bench, steps):
    """Steps while the spot stays unseen; a robot that is sent arrives at once. Gives (time since, place) of goals."""
    goals, began = [], bench.now
    for _ in range(steps):
        decision = bench.step(silent=bench.now + 0.25 - began)
        if decision.kind is Kind.SEND:
            goals.append((bench.now - began, decision.viewpoint))
            bench.goal = GoalStatus.REACHED
            bench.situation["robot"] = decision.viewpoint.pose
    return goals


def test_place_where_the_camera_reports_nothing_has_failed_and_the_next_is_taken():
    params = DispatchParams()
    bench = blind_bench()
    goals = stand(bench, 60)
    assert [viewpoint.x for _, viewpoint in goals] == [2, 3], "not the one 0.2 m beside, and not for ever"
    assert goals[0][0] == pytest.approx(params.blind_after, abs=0.5), "the person does not wait long"
    assert goals[1][0] - goals[0][0] == pytest.approx(params.blind_after, abs=0.5)


def test_robot_that_sees_the_spot_stays_and_may_try_anew_when_it_is_lost_again():
    bench = blind_bench()
    assert not sent(bench.run(60, silent=0.0))
    assert len(stand(bench, 60)) == 2
    bench.run(4, silent=0.0)
    bench.now += DispatchParams().failed_memory
    assert stand(bench, 20), "the tries count anew"


def test_robot_that_still_drives_is_not_blind():
    bench = blind_bench()
    bench.goal = GoalStatus.ACTIVE
    began = bench.now
    for i in range(40):
        assert bench.step(silent=bench.now + 0.25 - began, robot=(5.0 - 0.1 * i, 0.0, 0.0)).kind is Kind.KEEP


def test_lost_spot_is_not_a_matter_of_patience():
    bench = Bench([place(1)], seen=lambda pose: pose[0] == 1)
    bench.step()
    bench.run(4)
    bench.candidates, bench.seen = [place(3, spot=(1.0, 0.0))], lambda pose: pose[0] == 3
    assert bench.step(spot=(1.0, 0.0), silent=1.0).kind is Kind.SEND


def test_next_interaction_begins_afresh_even_if_no_decision_fell_between():
    bench = Bench([place(1)], seen=lambda pose: pose[0] == 1)
    bench.step()
    bench.goal = GoalStatus.NONE  # called off with the state
    assert bench.step(key=("b", 1)).kind is Kind.SEND


def test_robot_that_was_carried_away_comes_back():
    bench = Bench([place(1)], seen=lambda pose: pose[0] == 1)
    bench.step()
    bench.goal = GoalStatus.REACHED
    assert not sent(bench.run(10, robot=(1.0, 0.0, 0.0)))
    assert sent(bench.run(10, robot=(5.0, 0.0, 0.0))) == [place(1)]
