"""The policy that decides each robot's goal, without maps, messages and actions.

One robot serves: it keeps its position while it sees the target from there. If it loses the target for a while, or the
position fails, each robot bids the cheapest position from which it would see the target (its present position costs
nothing). Bids rank by whether they see the spot, the robot's failures, whether it is busy, and cost. A position fails
if navigation does not accept it, the robot makes no progress, or no camera sees the spot in time; it is then not bid
again for a while. The serving robot's bid counts as SWITCH_GAIN cheaper, so that two robots do not alternate.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, replace
from typing import Dict, Hashable, List, Mapping, Optional, Tuple

from vb_core.geometry import Pose, pose_distance
from vb_robot.dispatching.viewpoint import Viewpoint, ViewpointPlanner
from vb_robot.spot_sightings import LOST_TIMEOUT

MIN_INTERVAL = 1.5  # [s] between two goals, since navigation makes a new plan for each
LOST_INTERVAL = 0.5  # [s] between two goals while no camera sees the spot; UNFIT_TIMEOUT does not apply then
RETRY_AFTER = 0.5  # [s] pause after a failure, multiplied by the number of failures so far
UNFIT_TIMEOUT = 0.6  # [s] for which the present goal must be unsuitable before it is replaced
MIN_GAIN, MIN_TURN = 0.25, math.radians(20.0)  # [m, rad] least distance of a new goal from the present one
FAILED_RADIUS, FAILED_MEMORY = 0.5, 20.0  # [m, s] positions this near to a failed one are avoided for this long
# [s] within which a robot must make progress: move_base itself needs 40 s to give up
PROGRESS_TIMEOUTS = {"sent": 4.0, "active": 15.0, "seen": 3.0}
STUCK_DISTANCE = 0.10  # [m] a shorter move is not progress
BLIND_TRIES = 2  # positions tried while no camera sees the spot: the laser may be off
PREEMPTION_PAUSE = 15.0  # [s] after another node sent the robot elsewhere
SWITCH_GAIN = 1.0  # [m] advantage that another robot must have to take over

Circle = Tuple[float, float, float]  # (x, y, radius) [m]


class SentGoalState(enum.Enum):
    """State of the newest goal."""

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
        server: whether its navigation runs.
        goal: the state of the newest goal that was sent to it.
        busy: whether it drives to another node's goal.
    """

    pose: Optional[Pose]
    server: bool = True
    goal: SentGoalState = SentGoalState.NONE
    busy: bool = False


class Fleet:
    """Decides which robot serves, and its goal.

    Attributes:
        serving: the name of the robot that serves; None if no robot does.
        goal: the viewpoint to which it was sent; None if it sees the target from its present position.
    """

    def __init__(self, robots) -> None:
        self._names = tuple(robots)
        self._previous_step: Tuple[float, Hashable] = (-math.inf, None)
        self._reset()

    def _reset(self) -> None:
        self._failed: List[Tuple[str, float, Circle]] = []  # robot, time [s] and position of each failure
        self._resting_until: Dict[str, float] = {}  # [s] by robot's name
        self.serving: Optional[str] = None
        self.goal: Optional[Viewpoint] = None
        self._sent = -math.inf
        self._unfit_since: Optional[float] = None
        self._pending_event: Tuple[str, float, Optional[Pose]] = ("", 0.0, None)  # event, start [s], start pose
        self._blind: List[Circle] = []  # positions from which no camera saw the lost spot

    def step(
        self,
        now: float,
        key: Hashable,
        unseen: float,
        robots: Mapping[str, Tuple[DispatchStatus, Optional[ViewpointPlanner]]],
    ) -> Dict[str, Optional[Viewpoint]]:
        """Decides the goal of each robot, which it may have reached already; None for no goal.

        The caller sends a goal that differs from the previous one, and cancels the previous one if there is no new one.

        Args:
            now: [s]; key: changes with interaction and state; None if no robot is wanted.
            unseen: [s] since a camera last saw the spot.
            robots: each robot's status and viewpoint planner, None until the planner can be constructed.
        """
        previous, self._previous_step = self._previous_step, (now, key)
        self._failed = [failure for failure in self._failed if now - failure[1] < FAILED_MEMORY]
        self._blind = self._blind if unseen > LOST_TIMEOUT else []
        if key is None or now < previous[0] - 1.0:
            self._reset()  # also if time has jumped back, because the memory is then from another run
        elif key != previous[1]:
            unfinished = self.serving, self.goal, self._sent, self._pending_event
            under_way = self.serving is not None and self.goal is not None and robots[self.serving][0].goal.under_way
            self._reset()
            if under_way:  # a robot that is on its way continues
                self.serving, self.goal, self._sent, self._pending_event = unfinished
        available = {
            name: (status, planner)
            for name, (status, planner) in robots.items()
            if key is not None and status.server and status.pose is not None
        }
        if self.serving not in available:
            self.serving = self.goal = None
        if self.serving is None or self._must_move(now, unseen, *available[self.serving]):
            self._choose(now, {name: candidate for name, candidate in available.items() if candidate[1] is not None})
        return {name: self.goal if name == self.serving else None for name in self._names}

    def _must_move(
        self, now: float, unseen: float, status: DispatchStatus, planner: Optional[ViewpointPlanner]
    ) -> bool:
        """Returns whether to choose another position for the serving robot, or another robot."""
        pose = status.pose
        if self.goal is not None:
            state = status.goal.value
            stalled = status.goal.under_way and self._measure_wait(now, state, pose) > PROGRESS_TIMEOUTS[state]
            if status.goal is SentGoalState.FAILED or stalled:
                self._failed.append((self.serving, now, (*self.goal.pose[:2], FAILED_RADIUS)))
                self._resting_until[self.serving] = now + RETRY_AFTER * len(self._failed_circles(self.serving))
                self.goal = None
                return True
            if status.goal is SentGoalState.PREEMPTED:
                self._resting_until[self.serving] = now + PREEMPTION_PAUSE
                self.goal = None
                return True
        if planner is None:
            return False
        under_way = self.goal if status.goal.under_way else None
        target_pose = under_way.pose if under_way is not None else pose
        avoided_circles = [*self._blind, *self._failed_circles(self.serving)]
        suitable = planner.shows_target(target_pose) and (under_way is None or planner.has_room_at(target_pose))
        suitable = suitable and all(math.dist(target_pose[:2], (x, y)) >= radius for x, y, radius in avoided_circles)
        # a robot that is leaving the seed's side continues, because the border would lock it in
        if suitable or (under_way is not None and not under_way.sees_spot):
            self._unfit_since = None
            waiting_time = 0.0 if under_way is not None else min(unseen, self._measure_wait(now, "seen", pose))
            if waiting_time < PROGRESS_TIMEOUTS["seen"] or len(self._blind) >= BLIND_TRIES:
                return False
            self._blind.append((pose[0], pose[1], FAILED_RADIUS))  # something hides the spot from there
            self.goal = None
        if under_way is None:
            self._measure_wait(now, "", pose)  # waiting for the spot counts only where the robot should see it
        if self.goal is None:
            return True
        self._unfit_since = now if self._unfit_since is None else self._unfit_since
        if unseen > LOST_TIMEOUT:
            return now >= self._sent + LOST_INTERVAL
        return now >= self._sent + MIN_INTERVAL and now >= self._unfit_since + UNFIT_TIMEOUT

    def _failed_circles(self, name: str) -> List[Circle]:
        return [circle for robot, _, circle in self._failed if robot == name]

    def _measure_wait(self, now: float, event: str, pose: Pose) -> float:
        """Measures for how long [s] an event has been pending while the robot hardly moved."""
        previous_event, _, start_pose = self._pending_event
        if event != previous_event or start_pose is None or pose_distance(start_pose, pose) >= STUCK_DISTANCE:
            self._pending_event = (event, now, pose)
        return now - self._pending_event[1]

    def _choose(self, now: float, available: Mapping[str, Tuple[DispatchStatus, ViewpointPlanner]]) -> None:
        """Accepts the best bid; without any bid, nothing changes."""
        bids: Dict[str, Tuple[tuple, Optional[Viewpoint]]] = {}
        for name, (status, planner) in available.items():
            failures, serves = self._failed_circles(name), name == self.serving
            if now < self._resting_until.get(name, -math.inf):
                continue
            if not serves and not status.busy and planner.shows_target(status.pose):
                bids[name] = (False, len(failures), False, 0.0), None
                continue
            viewpoint = planner.best_viewpoint(status.pose, [*self._blind, *failures])
            if viewpoint is None:
                self._resting_until[name] = now + MIN_INTERVAL  # planning again at once would give the same result
                continue
            cost = viewpoint.cost - (SWITCH_GAIN if serves else 0.0)
            bids[name] = (not viewpoint.sees_spot, len(failures), status.busy and not serves, cost), viewpoint
        if not bids:
            return
        winner = min(bids, key=lambda name: bids[name][0])
        goal, status = bids[winner][1], available[winner][0]
        if winner == self.serving and self._is_near_goal(goal, status):
            self._unfit_since = now
            return
        # a copy, because a second goal at the same position is another goal
        self.serving, self.goal = winner, goal and replace(goal)
        self._sent, self._unfit_since, self._pending_event = now, None, ("", now, None)

    def _is_near_goal(self, viewpoint: Optional[Viewpoint], status: DispatchStatus) -> bool:
        """Returns whether a viewpoint is close to the robot's goal, reached or not."""
        goal = self.goal
        if viewpoint is None or goal is None or math.dist(viewpoint.pose[:2], goal.pose[:2]) >= MIN_GAIN:
            return False
        turn = abs(math.remainder(viewpoint.pose[2] - goal.pose[2], 2.0 * math.pi))
        return turn < MIN_TURN and (status.goal.under_way or math.dist(status.pose[:2], goal.pose[:2]) <= MIN_GAIN)
