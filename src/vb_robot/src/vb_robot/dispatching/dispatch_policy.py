"""Decides where each robot should go: the policy, apart from maps, messages and actions.

One robot serves, and stays where it is as long as it sees the target from there. If it has not seen the target for a
while, or its position has failed, the robots bid: each offers the cheapest position from which it would see the target
(its present position costs nothing). Bids rank by whether they see the spot, then by the robot's failures, whether it
is busy, and cost. A position fails if navigation does not accept it, the robot makes no progress, or no camera sees the
spot in time; it is then not offered again for a while. The bid of the serving robot counts as SWITCH_GAIN cheaper, so
that two robots do not alternate.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, replace
from typing import Dict, Hashable, List, Mapping, Optional, Tuple

from vb_core.geometry import Pose, pose_distance
from vb_robot.dispatching.viewpoint import Viewpoint, ViewpointPlanner
from vb_robot.spot_sightings import LOST_TIMEOUT

MIN_INTERVAL = 1.5  # [s] between two goals, because navigation makes a new plan for each
LOST_INTERVAL = 0.5  # [s] between two goals while no camera sees the spot; UNFIT_TIMEOUT does not apply then
RETRY_AFTER = 0.5  # [s] pause after a failure, times the number of failures so far
UNFIT_TIMEOUT = 0.6  # [s] for which the present goal must have been unfit before it is replaced
MIN_GAIN, MIN_TURN = 0.25, math.radians(20.0)  # [m, rad] minimum difference between a new goal and the present one
FAILED_RADIUS, FAILED_MEMORY = 0.5, 20.0  # [m, s] no goal is tried so near to a failed position, for so long
# [s] within which the robot must make progress; move_base itself gives up only after 40 s
PROGRESS_TIMEOUTS = {"sent": 4.0, "active": 15.0, "seen": 3.0}
STUCK_DISTANCE = 0.10  # [m] shortest move that counts as progress
BLIND_TRIES = 2  # positions that are tried for a lost spot, as the laser may be off
PREEMPTION_PAUSE = 15.0  # [s] after another node sent the robot elsewhere
SWITCH_GAIN = 1.0  # [m] by which another robot's bid must be cheaper for it to take over

Circle = Tuple[float, float, float]  # (x, y, radius) [m]


class SentGoalState(enum.Enum):
    """State of the goal that was sent last."""

    NONE = "none"
    SENT = "sent"  # not acknowledged yet
    ACTIVE = "active"
    REACHED = "reached"
    FAILED = "failed"  # aborted, rejected or lost
    PREEMPTED = "preempted"  # preempted although this policy did not cancel it

    @property
    def under_way(self) -> bool:
        """Whether the robot is on its way to the goal."""
        return self in (SentGoalState.SENT, SentGoalState.ACTIVE)


@dataclass(frozen=True)
class DispatchStatus:
    """A robot's current state.

    Attributes:
        pose: (x, y, yaw) [m, m, rad], map frame; None if it is not localised.
        server: whether its navigation is running.
        goal: the state of the last goal that was sent to it.
        busy: whether it drives to another node's goal.
    """

    pose: Optional[Pose]
    server: bool = True
    goal: SentGoalState = SentGoalState.NONE
    busy: bool = False


class DispatchPolicy:
    """Decides which robot serves, and where it goes.

    Attributes:
        serving: the name of the robot that serves, if any does.
        goal: the viewpoint to which it was sent; None if it sees the target from where it is.
    """

    def __init__(self, robots) -> None:
        self._names = tuple(robots)
        self._previous_step: Tuple[float, Hashable] = (-math.inf, None)  # time [s] and key
        self._forget()

    def _forget(self) -> None:
        """Resets what belongs to one interaction and state."""
        self._failed: List[Tuple[str, float, Circle]] = []  # robot, time [s], and position
        self._rests_until: Dict[str, float] = {}  # [s] by robot's name
        self.serving: Optional[str] = None
        self.goal: Optional[Viewpoint] = None
        self._sent = -math.inf
        self._unfit_since: Optional[float] = None
        self._awaited: Tuple[str, float, Optional[Pose]] = ("", 0.0, None)  # event, start [s] and pose of the wait
        self._blind: List[Circle] = []  # positions from which no camera saw the lost spot

    def step(
        self,
        now: float,
        key: Hashable,
        unseen: float,
        robots: Mapping[str, Tuple[DispatchStatus, Optional[ViewpointPlanner]]],
    ) -> Dict[str, Optional[Viewpoint]]:
        """Decides the goal of each robot, which it may have reached already; None if it has no goal.

        The caller sends a goal that differs from the previous one, and cancels the previous one if there is no new one.

        Args:
            now: [s]
            key: identifies interaction and state; None if no robot is wanted.
            unseen: [s] since a camera saw the spot.
            robots: each robot's status and its viewpoint planner, which is None until it can be made.
        """
        (previous_time, previous_key), self._previous_step = self._previous_step, (now, key)
        self._failed = [failure for failure in self._failed if now - failure[1] < FAILED_MEMORY]
        self._blind = self._blind if unseen > LOST_TIMEOUT else []
        if key is None or now < previous_time - 1.0:
            self._forget()  # also when time has jumped back, as the record then belongs to another run
        elif key != previous_key:
            present = self.serving, self.goal, self._sent, self._awaited
            running = self.serving is not None and self.goal is not None and robots[self.serving][0].goal.under_way
            self._forget()
            if running:  # a robot that is on its way goes on
                self.serving, self.goal, self._sent, self._awaited = present
        able = {
            name: (status, planner)
            for name, (status, planner) in robots.items()
            if key is not None and status.server and status.pose is not None
        }
        if self.serving not in able:
            self.serving = self.goal = None
        if self.serving is None or self._must_move(now, unseen, *able[self.serving]):
            self._choose(now, {name: entry for name, entry in able.items() if entry[1] is not None})
        return {name: self.goal if name == self.serving else None for name in self._names}

    def _must_move(
        self, now: float, unseen: float, status: DispatchStatus, planner: Optional[ViewpointPlanner]
    ) -> bool:
        """Records whether the serving robot's position has failed; returns whether to choose another one, or robot."""
        pose = status.pose
        if self.goal is not None:
            progress = status.goal.value
            is_stuck = status.goal.under_way and self._waiting_time(now, progress, pose) > PROGRESS_TIMEOUTS[progress]
            if status.goal is SentGoalState.FAILED or is_stuck:
                self._failed.append((self.serving, now, (*self.goal.pose[:2], FAILED_RADIUS)))
                self._rests_until[self.serving] = now + RETRY_AFTER * len(self._failures_of(self.serving))
                self.goal = None
                return True
            if status.goal is SentGoalState.PREEMPTED:
                self._rests_until[self.serving] = now + PREEMPTION_PAUSE
                self.goal = None
                return True
        if planner is None:
            return False
        under_way = self.goal if status.goal.under_way else None
        wanted = under_way.pose if under_way is not None else pose
        avoided = [*self._blind, *self._failures_of(self.serving)]
        fits = planner.shows_target(wanted) and (under_way is None or planner.has_room_at(wanted))
        fits = fits and all(math.dist(wanted[:2], (x, y)) >= radius for x, y, radius in avoided)
        # a robot that is leaving the seed's side goes on: the border would lock it in
        if fits or (under_way is not None and not under_way.sees_spot):
            self._unfit_since = None
            waited = 0.0 if under_way is not None else min(unseen, self._waiting_time(now, "seen", pose))
            if waited < PROGRESS_TIMEOUTS["seen"] or len(self._blind) >= BLIND_TRIES:
                return False
            self._blind.append((pose[0], pose[1], FAILED_RADIUS))  # something hides the spot from this position
            self.goal = None
        if under_way is None:
            self._waiting_time(now, "", pose)  # restarts the wait, which counts only where it should see the spot
        if self.goal is None:
            return True
        self._unfit_since = now if self._unfit_since is None else self._unfit_since
        if unseen > LOST_TIMEOUT:
            return now >= self._sent + LOST_INTERVAL
        return now >= self._sent + MIN_INTERVAL and now >= self._unfit_since + UNFIT_TIMEOUT

    def _failures_of(self, name: str) -> List[Circle]:
        return [position for robot, _, position in self._failed if robot == name]

    def _waiting_time(self, now: float, event: str, pose: Pose) -> float:
        """Returns for how long [s] the robot has waited for an event where it is; another event or move restarts it."""
        awaited, _, start = self._awaited
        if event != awaited or start is None or pose_distance(start, pose) >= STUCK_DISTANCE:
            self._awaited = (event, now, pose)
        return now - self._awaited[1]

    def _choose(self, now: float, able: Mapping[str, Tuple[DispatchStatus, ViewpointPlanner]]) -> None:
        """Accepts the best bid; changes nothing if there is none."""
        bids: Dict[str, Tuple[tuple, Optional[Viewpoint]]] = {}
        for name, (status, planner) in able.items():
            failures, serves = self._failures_of(name), name == self.serving
            if now < self._rests_until.get(name, -math.inf):
                continue
            if not serves and not status.busy and planner.shows_target(status.pose):
                bids[name] = (False, len(failures), False, 0.0), None
                continue
            viewpoint = planner.best_viewpoint(status.pose, [*self._blind, *failures])
            if viewpoint is None:
                self._rests_until[name] = now + MIN_INTERVAL  # the same search would fail again now
                continue
            cost = viewpoint.cost - (SWITCH_GAIN if serves else 0.0)
            bids[name] = (not viewpoint.sees_spot, len(failures), status.busy and not serves, cost), viewpoint
        if not bids:
            return
        best = min(bids, key=lambda name: bids[name][0])
        chosen, status = bids[best][1], able[best][0]
        if best == self.serving and self._is_near_goal(chosen, status):
            self._unfit_since = now
            return
        # copied, because the caller compares goals by identity: the same position again is another goal
        self.serving, self.goal = best, chosen and replace(chosen)
        self._sent, self._unfit_since, self._awaited = now, None, ("", now, None)

    def _is_near_goal(self, chosen: Optional[Viewpoint], status: DispatchStatus) -> bool:
        """Returns whether a viewpoint is close to where the robot already is or is going."""
        goal = self.goal
        if chosen is None or goal is None or math.dist(chosen.pose[:2], goal.pose[:2]) >= MIN_GAIN:
            return False
        turn = abs(math.remainder(chosen.pose[2] - goal.pose[2], 2.0 * math.pi))
        return turn < MIN_TURN and (status.goal.under_way or math.dist(status.pose[:2], goal.pose[:2]) <= MIN_GAIN)
