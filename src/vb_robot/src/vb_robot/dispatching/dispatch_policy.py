"""Decides where each robot should go: the policy, apart from maps, messages and actions.

1. One robot serves. It stays where it is for as long as it sees the target from there.
2. If it has not seen the target for a while, or its position has failed, all robots bid: each offers the cheapest
   position from which it would see the target. Staying where it is costs a robot nothing.
3. Bids that see the spot come first, then those of robots with fewer failures, then those of idle robots, then the
   cheaper. The serving robot's bid counts as SWITCH_GAIN cheaper, so that two robots do not alternate.
4. A position has failed if navigation does not accept it, if the robot makes no progress towards it, or if no camera
   sees the spot from there in time. A failed position is not offered for a while.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, replace
from itertools import count
from typing import Dict, Hashable, List, Mapping, NamedTuple, Optional, Tuple

from vb_core.geometry import Pose, pose_distance
from vb_robot.dispatching.viewpoint import Circle, Viewpoint, ViewpointPlanner
from vb_robot.spot_sightings import LOST_TIMEOUT

MIN_INTERVAL = 1.5  # [s] between two goals, because navigation makes a new plan for each
LOST_INTERVAL = 0.5  # [s] between two goals while no camera sees the spot; UNFIT_TIMEOUT does not apply then
RETRY_AFTER = 0.5  # [s] pause after a failure, times the number of failures so far
UNFIT_TIMEOUT = 0.6  # [s] for which the present goal must have been unfit before it is replaced
# a new goal must differ from the present one by at least one of these
MIN_GAIN = 0.25  # [m]
MIN_TURN = math.radians(20.0)  # [rad]
FAILED_RADIUS = 0.5  # [m] around a failed position, in which no goal is tried
FAILED_MEMORY = 20.0  # [s] after which a failed position may be tried again
# [s] for which a robot may stand still, by the state of its goal; move_base itself gives up only after 40 s
STUCK_TIMEOUTS = {"sent": 4.0, "active": 15.0}
HIDDEN_TIMEOUT = 3.0  # [s] without the spot, after which something must hide it from a robot that should see it
STUCK_DISTANCE = 0.10  # [m] a shorter move still counts as standing still
HIDDEN_TRIES = 2  # positions that are tried for a lost spot; then the laser is probably off
PREEMPTION_PAUSE = 15.0  # [s] for which a robot is left alone after another node has sent it elsewhere
SWITCH_GAIN = 1.0  # [m] by which another robot's bid must be cheaper for it to take over

Planners = Mapping[str, Optional[ViewpointPlanner]]  # keys are robots' names; None until a planner can be made


class SentGoalState(enum.Enum):
    """State of the goal that was sent last."""

    NONE = "none"
    SENT = "sent"  # not acknowledged yet
    ACTIVE = "active"
    REACHED = "reached"
    FAILED = "failed"  # aborted, rejected or lost
    PREEMPTED = "preempted"  # by another node, as this policy did not cancel it

    @property
    def is_running(self) -> bool:
        """Whether the robot is on its way to the goal."""
        return self in (SentGoalState.SENT, SentGoalState.ACTIVE)


@dataclass(frozen=True)
class DispatchStatus:
    """A robot's current state."""

    pose: Optional[Pose]  # (x, y, yaw) [m, m, rad], map frame; None if the robot is not localised
    has_navigation: bool = True  # whether its navigation is running
    goal: SentGoalState = SentGoalState.NONE  # the state of the last goal that was sent to it
    is_busy: bool = False  # whether it drives to another node's goal

    @property
    def can_be_sent(self) -> bool:
        """Whether the robot can be sent to a goal."""
        return self.has_navigation and self.pose is not None


class PositionAssessment(enum.Enum):
    """An assessment of the serving robot's position: its goal's if it is on its way, else its own."""

    FIT = "fit"
    UNKNOWN = "unknown"  # the viewpoint planner is not known yet
    UNFIT = "unfit"  # the robot does not see the target from there, or has no room
    HIDDEN = "hidden"  # the robot should see the spot from where it stands, but no camera does
    FAILED = "failed"  # navigation gave up, or the robot makes no progress
    PREEMPTED = "preempted"  # another node sent the robot elsewhere


class EventWait(NamedTuple):
    """A robot's wait: the awaited event ("" for none), when it began [s], and the robot's pose, None before that."""

    event: str = ""
    since: float = 0.0
    pose: Optional[Pose] = None

    def continued(self, event: str, now: float, pose: Pose) -> EventWait:
        """Returns this wait. If the robot has moved or waits for another event, returns a wait that begins now."""
        stays = self.pose is not None and pose_distance(self.pose, pose) < STUCK_DISTANCE
        return self if event == self.event and stays else EventWait(event, now, pose)


class Failure(NamedTuple):
    """A robot's failure at a position: its name, the time [s], and the circle that it then avoids for a while."""

    robot: str
    time: float
    circle: Circle


class BidRank(NamedTuple):
    """The rank of a bid. The smallest is the best, field by field; `cost` is in metres of path."""

    misses_spot: bool
    failures: int
    is_busy: bool
    cost: float


class DispatchPolicy:
    """Decides which robot serves, and where it goes.

    Attributes:
        serving: the name of the robot that serves, if any does.
        goal: the viewpoint to which it was sent; None if it sees the target from where it is.
    """

    def __init__(self, robots) -> None:
        self._names = tuple(robots)
        self._previous_time = -math.inf  # [s]
        self._previous_task: Hashable = None
        self._goal_numbers = count(1)
        self._forget_goal()
        self._forget_failures()

    def _forget_goal(self) -> None:
        self.serving: Optional[str] = None
        self.goal: Optional[Viewpoint] = None
        self._sent_at = -math.inf  # [s]
        self._wait = EventWait()

    def _forget_failures(self) -> None:
        self._failures: List[Failure] = []
        self._hidden: List[Circle] = []  # around positions from which no camera saw the lost spot
        self._rests_until: Dict[str, float] = {}  # [s] by robot's name
        self._unfit_since: Optional[float] = None  # [s]; None while the goal is fit

    def step(
        self, now: float, task: Hashable, unseen_s: float, robots: Mapping[str, DispatchStatus], planners: Planners
    ) -> Dict[str, Optional[Viewpoint]]:
        """Decides each robot's goal, by name. A robot may already have reached its goal. None is no goal.

        The caller sends a goal that differs from the previous one, and cancels the previous one if there is no new one.

        Args:
            now: [s]
            task: identifies interaction and state; None if no robot is wanted.
            unseen_s: [s] since a camera saw the spot.
        """
        is_another_run = now < self._previous_time - 1.0  # time has jumped back
        must_restart = task is None or is_another_run
        if must_restart or task != self._previous_task:
            # a new state of the same interaction does not stop a robot that is on its way
            is_on_way = self.goal is not None and robots[self.serving].goal.is_running
            if must_restart or not is_on_way:
                self._forget_goal()
            self._forget_failures()
        self._previous_time = now
        self._previous_task = task
        self._failures = [failure for failure in self._failures if now - failure.time < FAILED_MEMORY]
        if unseen_s <= LOST_TIMEOUT:
            self._hidden = []
        wanted = robots if task is not None else {}
        candidates = {name: status for name, status in wanted.items() if status.can_be_sent}
        if self.serving not in candidates:
            self.serving = self.goal = None
        must_choose = True
        if self.serving is not None:
            assessment = self._assess(now, unseen_s, robots[self.serving], planners[self.serving])
            self._record(now, assessment, robots[self.serving])
            must_choose = self._must_choose(now, unseen_s, assessment)
        if must_choose:
            self._choose(now, candidates, planners)
        return {name: self.goal if name == self.serving else None for name in self._names}

    def _assess(
        self, now: float, unseen_s: float, status: DispatchStatus, planner: Optional[ViewpointPlanner]
    ) -> PositionAssessment:
        """Assesses the position of the serving robot, and changes nothing."""
        goal = self.goal
        on_way = goal is not None and status.goal.is_running
        if goal is not None and status.goal in (SentGoalState.FAILED, SentGoalState.PREEMPTED):
            return PositionAssessment(status.goal.value)
        if on_way:
            wait = self._wait.continued(status.goal.value, now, status.pose)
            if now - wait.since > STUCK_TIMEOUTS[wait.event]:
                return PositionAssessment.FAILED
        if planner is None:
            return PositionAssessment.UNKNOWN
        pose = goal.pose if on_way else status.pose
        avoided = [*self._hidden, *self._circles_of(self.serving)]
        fits = planner.is_suitable(pose) and (not on_way or planner.has_room_at(pose))
        is_avoided = any(math.dist(pose[:2], (x, y)) < radius for x, y, radius in avoided)
        fits = fits and not is_avoided
        if on_way:
            # a robot that is leaving the seed's side goes on, because the border would lock it in there
            must_leave = not goal.sees_spot
            return PositionAssessment.FIT if fits or must_leave else PositionAssessment.UNFIT
        if not fits:
            return PositionAssessment.UNFIT
        waited = now - self._wait.continued("seen", now, status.pose).since
        is_hidden = min(unseen_s, waited) >= HIDDEN_TIMEOUT and len(self._hidden) < HIDDEN_TRIES
        return PositionAssessment.HIDDEN if is_hidden else PositionAssessment.FIT

    def _record(self, now: float, assessment: PositionAssessment, status: DispatchStatus) -> None:
        """Records the assessment of the serving robot's position, and drops a goal that led nowhere."""
        if assessment is PositionAssessment.FAILED:
            self._failures.append(Failure(self.serving, now, (*self.goal.pose[:2], FAILED_RADIUS)))
            self._rests_until[self.serving] = now + RETRY_AFTER * len(self._circles_of(self.serving))
        elif assessment is PositionAssessment.PREEMPTED:
            self._rests_until[self.serving] = now + PREEMPTION_PAUSE
        elif assessment is PositionAssessment.HIDDEN:
            self._hidden.append((*status.pose[:2], FAILED_RADIUS))
        elif self.goal is not None and status.goal.is_running:
            self._wait = self._wait.continued(status.goal.value, now, status.pose)
        elif assessment is not PositionAssessment.UNKNOWN:
            # something may hide the spot only while the robot waits where it should see it
            event = "seen" if assessment is PositionAssessment.FIT else ""
            self._wait = self._wait.continued(event, now, status.pose)
        if assessment in (PositionAssessment.FAILED, PositionAssessment.PREEMPTED, PositionAssessment.HIDDEN):
            self.goal = None
            self._wait = EventWait()
        if assessment in (PositionAssessment.FIT, PositionAssessment.HIDDEN):
            self._unfit_since = None
        elif assessment is PositionAssessment.UNFIT and self.goal is not None and self._unfit_since is None:
            self._unfit_since = now

    def _must_choose(self, now: float, unseen_s: float, assessment: PositionAssessment) -> bool:
        """Returns whether to choose another position or robot, with patience while the present goal may fit again."""
        if assessment in (PositionAssessment.FIT, PositionAssessment.UNKNOWN):
            return False
        if self.goal is None:
            return True
        if unseen_s > LOST_TIMEOUT:
            return now >= self._sent_at + LOST_INTERVAL
        return now >= self._sent_at + MIN_INTERVAL and now >= self._unfit_since + UNFIT_TIMEOUT

    def _circles_of(self, robot: str) -> List[Circle]:
        """Returns the circles around the positions at which a robot failed."""
        return [failure.circle for failure in self._failures if failure.robot == robot]

    def _choose(self, now: float, candidates: Mapping[str, DispatchStatus], planners: Planners) -> None:
        """Accepts the best bid. Changes nothing if there is none."""
        bids: Dict[str, Tuple[BidRank, Optional[Viewpoint]]] = {}
        for name, status in candidates.items():
            planner = planners[name]
            circles = self._circles_of(name)
            failures = len(circles)
            serves = name == self.serving
            is_idle = not serves and not status.is_busy
            if planner is None or now < self._rests_until.get(name, -math.inf):
                continue
            if is_idle and planner.is_suitable(status.pose):
                stay_rank = BidRank(misses_spot=False, failures=failures, is_busy=False, cost=0.0)
                bids[name] = (stay_rank, None)
                continue
            viewpoint = planner.best_viewpoint(status.pose, [*self._hidden, *circles])
            if viewpoint is None:
                self._rests_until[name] = now + MIN_INTERVAL  # the same search would fail again now
                continue
            cost = viewpoint.cost - SWITCH_GAIN if serves else viewpoint.cost
            is_busy = status.is_busy and not serves
            bids[name] = (BidRank(not viewpoint.sees_spot, failures, is_busy, cost), viewpoint)
        if not bids:
            return
        best = min(bids, key=lambda name: bids[name][0])
        chosen = bids[best][1]
        if best == self.serving and self._is_near_goal(chosen, candidates[best]):
            self._unfit_since = now
            return
        self.serving = best
        # the number makes the same position another goal if it is chosen again, so that the caller sends it again
        self.goal = None if chosen is None else replace(chosen, number=next(self._goal_numbers))
        self._sent_at = now
        self._unfit_since = None
        self._wait = EventWait()

    def _is_near_goal(self, chosen: Optional[Viewpoint], status: DispatchStatus) -> bool:
        """Returns whether a viewpoint is close to the robot's goal, and the robot is there or on its way."""
        goal = self.goal
        if chosen is None or goal is None:
            return False
        distance = math.dist(chosen.pose[:2], goal.pose[:2])
        turn = abs(math.remainder(chosen.pose[2] - goal.pose[2], 2.0 * math.pi))
        has_arrived = math.dist(status.pose[:2], goal.pose[:2]) <= MIN_GAIN
        return distance < MIN_GAIN and turn < MIN_TURN and (status.goal.is_running or has_arrived)
