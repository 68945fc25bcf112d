"""Decides where each robot should be going: the policy, apart from maps, messages and actions.

The idea: robots offer places, and a place that fails is not offered again for a while. Each robot offers the cheapest
place from which it would see the target; its present place costs nothing. The best offer wins: that of the robot with the
fewest failures; among equals, the cheapest. A place fails if navigation does not accept it, the robot makes no
progress, or no camera sees the spot from there in time; then the next best place is tried. A new place is chosen only
when the active robot's place has been unsuitable for a while; that robot's offer counts as SWITCH_GAIN cheaper, so that
two robots do not alternate.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, replace
from typing import Dict, Hashable, List, Mapping, Optional, Tuple

from vb_core.poses import Pose, pose_distance
from vb_robot.dispatching.viewpoint import Viewpoint, ViewpointPlanner
from vb_robot.spots import LOST_TIMEOUT

MIN_INTERVAL = 1.5  # [s] between two goals: each one costs navigation a new plan
LOST_INTERVAL = 0.5  # [s] while no camera sees the spot; then no goal waits for UNFIT_TIMEOUT either
RETRY_AFTER = 0.5  # [s] after a failure, and as much more after each further one
UNFIT_TIMEOUT = 0.6  # [s] how long the present goal must have been unfit to be replaced
MIN_SPOT_MOVE = 0.3  # [m] how far the spot must have moved since the goal was chosen
MIN_GAIN, MIN_TURN = 0.25, math.radians(20.0)  # [m, rad] how far a new place must be from the present goal
FAILED_RADIUS, FAILED_MEMORY = 0.5, 20.0  # [m, s] around a place that failed, nothing is tried for this long
# What a place promises, and within which time [s]: move_base itself needs 40 s to give up.
PROGRESS_TIMEOUTS = {"sent": 4.0, "active": 15.0, "seen": 3.0}
STUCK_DISTANCE = 0.10  # [m] less is no progress
BLIND_TRIES = 2  # so often, until a camera sees the spot again: the laser may be off
PREEMPTION_PAUSE = 15.0  # [s] after another node sent the robot elsewhere
SWITCH_GAIN = 1.0  # [m] how much better placed another robot must be to take over


class Review(enum.Enum):
    """What is to be done about the place of the robot that serves."""

    KEEP = "keep"
    REPLACE = "replace"
    FAILED = "failed"  # the robot waits where it should see the spot, and no camera does


class SentGoalState(enum.Enum):
    """State of the goal that was sent last."""

    NONE = "none"
    SENT = "sent"  # not acknowledged yet
    ACTIVE = "active"
    REACHED = "reached"
    FAILED = "failed"  # aborted, rejected or lost
    PREEMPTED = "preempted"  # preempted although this policy did not cancel it


@dataclass(frozen=True)
class DispatchInputs:
    """Inputs that are the same for all robots.

    Attributes:
        now: [s].
        wanted: whether a robot is wanted.
        key: changes with interaction and state.
        time_since_seen: [s] since a camera saw the spot.
    """

    now: float
    wanted: bool
    key: Hashable
    time_since_seen: float = 0.0

    @property
    def lost(self) -> bool:
        """Returns whether no camera sees the spot."""
        return self.time_since_seen > LOST_TIMEOUT


@dataclass(frozen=True)
class RobotStatus:
    """A robot's current state.

    Attributes:
        pose: (x, y, yaw) [m, m, rad], map frame; None if it is not localised.
        server: whether its navigation is there.
        goal: what became of the last goal that was sent to it.
        busy: whether it drives to another node's goal.
        goal_place: (x, y) [m] where it drives to, no matter who gave the goal.
    """

    pose: Optional[Pose]
    server: bool = True
    goal: SentGoalState = SentGoalState.NONE
    busy: bool = False
    goal_place: Optional[Tuple[float, float]] = None

    @property
    def running(self) -> bool:
        """Returns whether it is on its way to the goal that was sent last."""
        return self.goal in (SentGoalState.SENT, SentGoalState.ACTIVE)

    def places(self) -> List[Tuple[float, float]]:
        """Returns where it is and where it drives to, (x, y) [m]: not places for another robot."""
        return [place for place in (self.pose[:2] if self.pose else None, self.goal_place) if place is not None]


@dataclass(frozen=True)
class Failure:
    """A place (x, y) [m] that failed, and when [s]; `blind`: no camera saw the spot from there."""

    stamp: float
    x: float
    y: float
    blind: bool


@dataclass(frozen=True)
class Offer:
    """Pose that a robot offers (None: it sees the target from where it is), and its cost."""

    order: Tuple[bool, int, bool, bool, float]
    place: Optional[Viewpoint]


class RobotRecord:
    """Record of one robot: its goal, the goal's progress, and what failed."""

    def __init__(self) -> None:
        self.goal: Optional[Viewpoint] = None
        self._forget()

    def _forget(self) -> None:
        self._sent = self._rests_until = -math.inf
        self._unfit_since: Optional[float] = None
        self._failed: List[Failure] = []
        self._stage: Tuple[str, float, Optional[Pose]] = ("", 0.0, None)  # what is awaited, since when [s], from where
        self._endangered = False  # the path to the goal would lead through what is being drawn
        self.searched_length = 0.0  # [m] of the line ahead that it has looked at in vain, and looks beyond

    def observe(self, inputs: DispatchInputs, before: DispatchInputs, status: RobotStatus) -> bool:
        """Records what happened; returns whether the robot can be chosen now."""
        now = inputs.now
        if now < before.now - 1.0 or not inputs.wanted:
            self._forget()  # also when time has jumped back: what was remembered is about another run
        if inputs.key != before.key:
            self._failed, self._unfit_since, self._rests_until = [], None, -math.inf
        if not inputs.wanted or not status.server or (inputs.key != before.key and not status.running):
            self.goal = None  # it belonged to the state before
        self._failed = [
            failure
            for failure in self._failed
            if (inputs.lost if failure.blind else now - failure.stamp < FAILED_MEMORY)
        ]
        self.searched_length = self.searched_length if inputs.lost else 0.0
        if self.goal is not None:
            what = status.goal.value
            late = status.running and self._awaits(now, what, status.pose) > PROGRESS_TIMEOUTS[what]
            if status.goal is SentGoalState.FAILED or late:
                self._fail(now, self.goal.pose)
            elif status.goal is SentGoalState.PREEMPTED:
                self.goal, self._rests_until = None, now + PREEMPTION_PAUSE
        return inputs.wanted and status.server and status.pose is not None

    def _awaits(self, now: float, what: str, pose: Optional[Pose]) -> float:
        """Measures for how long [s] the same has been awaited without the robot getting anywhere."""
        before, since, start = self._stage
        if what != before or start is None or pose is None or pose_distance(start, pose) >= STUCK_DISTANCE:
            self._stage = (what, since if what == before and pose is None else now, pose)
        return now - self._stage[1]

    def _fail(self, now: float, pose: Pose, blind: bool = False) -> None:
        self._failed.append(Failure(now, pose[0], pose[1], blind))
        self.goal = self._unfit_since = None
        self._rests_until = now + RETRY_AFTER * self._failures()

    def _failures(self, blind: bool = False) -> int:
        return sum(failure.blind is blind for failure in self._failed)

    def _avoided(self) -> List[Tuple[float, float, float]]:
        return [(failure.x, failure.y, FAILED_RADIUS) for failure in self._failed]

    def review_goal(self, inputs: DispatchInputs, status: RobotStatus, planner: ViewpointPlanner) -> Review:
        """Reviews the goal of the robot that serves, or where it waits."""
        now, robot, goal = inputs.now, status.pose, self.goal
        assert robot is not None
        under_way = goal if status.running else None
        place = under_way.pose if under_way is not None else robot
        self._endangered = (
            under_way is not None
            and (planner.drawing.seeding or not under_way.risky)
            and not planner.avoids_drawing(robot, under_way.pose)
        )
        fits = (
            not self._endangered
            and planner.shows_target(place)
            and (under_way is None or planner.has_room_at(place))
            and all(math.dist(place[:2], (x, y)) >= radius for x, y, radius in self._avoided())
        )
        if fits:
            self._unfit_since = None
            if under_way is None and self._failures(blind=True) < BLIND_TRIES:
                waited = min(inputs.time_since_seen, self._awaits(now, "seen", robot))
                return Review.FAILED if waited >= PROGRESS_TIMEOUTS["seen"] else Review.KEEP
            return Review.KEEP
        if under_way is None:
            self._awaits(now, "", robot)  # it waits for the spot only where it should see it
        if goal is None:
            return Review.REPLACE
        self._unfit_since = now if self._unfit_since is None else self._unfit_since
        interval = 0.0 if self._endangered else LOST_INTERVAL if inputs.lost else MIN_INTERVAL
        if now < self._sent + interval or (not inputs.lost and now < self._unfit_since + UNFIT_TIMEOUT):
            return Review.KEEP
        # on its way off the seed's side it goes on: the border would lock it in
        leaves = under_way is not None and not goal.sees_spot and self._target_rests(goal, planner)
        return Review.KEEP if leaves and not self._endangered else Review.REPLACE

    def search_elsewhere(self, now: float, pose: Pose, planner: ViewpointPlanner) -> None:
        """Records that no camera sees the spot from a pose: something hides it, or it is farther along the line."""
        self.searched_length = 0.0 if self._failures(blind=True) else planner.visible_length(pose)
        self._fail(now, pose, blind=True)

    def _target_rests(self, goal: Viewpoint, planner: ViewpointPlanner) -> bool:
        """Returns whether the target is still about where it was when the goal was chosen."""
        return math.dist(planner.drawing.look_at, goal.spot) < MIN_SPOT_MOVE

    def make_offer(self, now: float, status: RobotStatus, planner: ViewpointPlanner, serves: bool) -> Optional[Offer]:
        """Makes the robot's offer; None if there is no place for it."""
        assert status.pose is not None
        if now < self._rests_until and not self._endangered:
            return None
        if not serves and not status.busy and planner.shows_target(status.pose):
            return Offer((False, self._failures(), False, False, 0.0), None)
        found = planner.best_viewpoint(status.pose, self._avoided())
        if found is None:
            self._rests_until = now + MIN_INTERVAL  # asking again at once would give the same answer
            if self._endangered:
                self.goal = None  # rather nowhere than through what is being drawn
            return None
        cost = found.cost - (SWITCH_GAIN if serves else 0.0)
        return Offer((not found.sees_spot, self._failures(), status.busy and not serves, found.risky, cost), found)

    def update_goal(
        self, now: float, status: RobotStatus, planner: ViewpointPlanner, place: Optional[Viewpoint]
    ) -> None:
        """Makes a place the goal, unless it is where the robot already is or goes."""
        goal, pose = self.goal, status.pose
        if place is None:
            return
        if goal is not None and pose is not None and math.dist(place.pose[:2], goal.pose[:2]) < MIN_GAIN:
            there = math.dist(pose[:2], goal.pose[:2]) <= MIN_GAIN and self._target_rests(goal, planner)
            if abs(math.remainder(place.pose[2] - goal.pose[2], 2.0 * math.pi)) < MIN_TURN and (
                status.running or there
            ):
                self._unfit_since = now
                return
        # a copy: to be sent to the same place again is another goal
        self.goal, self._sent, self._unfit_since, self._stage = replace(place), now, None, ("", now, None)


class Fleet:
    """Holds all robots and which one serves."""

    def __init__(self, robots) -> None:
        self.records: Dict[str, RobotRecord] = {name: RobotRecord() for name in robots}
        self.serving: Optional[str] = None
        self._before = DispatchInputs(-math.inf, False, None)

    @property
    def searched_length(self) -> float:
        """Length [m] of the line ahead, beyond the last sighting, that robots have searched in vain."""
        return max(record.searched_length for record in self.records.values())

    def step(
        self, inputs: DispatchInputs, robots: Mapping[str, Tuple[RobotStatus, Optional[ViewpointPlanner]]]
    ) -> Dict[str, Optional[Viewpoint]]:
        """Decides where each robot should be going now, or where it went last; None: nowhere.

        A goal that differs from the one before is to be sent; when there is none any more the last is to be cancelled.

        Args:
            robots: how each one is, and what it can see; None before anything is known of that.
        """
        able: Dict[str, Tuple[RobotStatus, ViewpointPlanner]] = {}
        for name, (status, planner) in robots.items():
            if self.records[name].observe(inputs, self._before, status) and planner is not None:
                able[name] = (status, planner)
        if self.serving is not None and inputs.key != self._before.key and self.records[self.serving].goal is None:
            self.serving = None  # a robot that is on its way goes on
        self._before, before = inputs, self.serving
        self._choose(inputs, able)
        for name, record in self.records.items():
            # the one that takes over also cancels one that is not able
            if name != self.serving and (name in able or self.serving != before):
                record.goal = None
        return {name: record.goal for name, record in self.records.items()}

    def _choose(self, inputs: DispatchInputs, able: Mapping[str, Tuple[RobotStatus, ViewpointPlanner]]) -> None:
        serving = self.serving if self.serving in able else None
        if serving is not None:
            (status, planner), record = able[serving], self.records[serving]
            review = record.review_goal(inputs, status, planner)
            if review is Review.FAILED and status.pose is not None:
                record.search_elsewhere(inputs.now, status.pose, planner)
            if review is not Review.REPLACE:
                return
        offers = {name: self.records[name].make_offer(inputs.now, *able[name], name == serving) for name in able}
        made = {name: offer for name, offer in offers.items() if offer is not None}
        if made:
            self.serving = min(made, key=lambda name: made[name].order)
            self.records[self.serving].update_goal(inputs.now, *able[self.serving], made[self.serving].place)
