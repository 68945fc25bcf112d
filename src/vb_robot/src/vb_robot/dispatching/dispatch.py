"""Decides which robot goes where, and when: the policy, apart from maps, messages and actions.

The idea: each robot that can offers the cheapest place from which it would see the target; its present place
costs nothing. The best offer wins: fewest failures first, then the shortest path. The robot that
serves is asked again only when its place has been unfit for a while, and its offer counts as SWITCH_GAIN cheaper,
so that two do not take turns. A place that failed is not offered for a while: so the next best is tried.
"""
from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import Dict, Hashable, List, Mapping, Optional, Tuple

from vb_robot.dispatching.view import pose_distance
from vb_robot.spots import LOST_AFTER
from vb_robot.dispatching.viewpoint import Outlook, Pose, Viewpoint

MIN_INTERVAL = 1.5  # [s] between two goals: each one costs navigation a new plan
LOST_INTERVAL = 0.5  # [s] while no camera sees the spot; then no goal waits for PATIENCE either
RETRY_AFTER = 0.5  # [s] after a failure
PATIENCE = 0.6  # [s] how long the present goal must have been unfit to be replaced
MIN_SPOT_MOVE = 0.3  # [m] how far the spot must have moved since the goal was chosen
MIN_GAIN = 0.25  # [m] how far a new place must be from the present goal
FAILED_RADIUS, FAILED_MEMORY = 0.3, 20.0  # [m, s] around a place that failed, nothing is tried for this long
# A place is a promise with a deadline at each stage [s]: navigation accepts it, the robot gets on (move_base itself
# needs 40 s to give up), and from there a camera sees the spot. What is not kept in time has failed.
WAITS = {"sent": 4.0, "active": 15.0, "seen": 3.0}
STUCK_DISTANCE = 0.10  # [m] less is no way
BLIND_RADIUS, BLIND_TRIES = 0.5, 2  # [m] apart, and so often until a camera sees it again: the laser may be off
MAX_FAILURES, FAILURE_PAUSE = 5, 8.0  # this many in a row, then a rest [s]
YIELD_PAUSE = 15.0  # [s] after another node sent the robot elsewhere
SWITCH_GAIN = 1.0  # [m] how much better placed another robot must be to take over
WAY_CHECK = 0.5  # [s] between two checks of the path to the present goal: the search costs up to 20 ms


class GoalStatus(enum.Enum):
    """What became of the goal that was sent last."""

    NONE = "none"
    SENT = "sent"  # not acknowledged yet
    ACTIVE = "active"
    REACHED = "reached"
    FAILED = "failed"  # aborted, rejected or lost
    TAKEN = "taken"  # preempted although this policy did not cancel it


class Kind(enum.Enum):
    """What to do."""

    KEEP = "keep"
    SEND = "send"
    CANCEL = "cancel"


@dataclass(frozen=True)
class Decision:
    """What a robot should do, and why."""

    kind: Kind
    reason: str
    viewpoint: Optional[Viewpoint] = None


@dataclass(frozen=True)
class Moment:
    """What holds for all robots: the time [s], whether one is wanted, what changes with interaction and state, and for
    how long [s] no camera has seen the spot."""

    now: float
    wanted: bool
    key: Hashable
    silent: float = 0.0


@dataclass(frozen=True)
class RobotStatus:
    """How a robot is now.

    Attributes:
        pose: (x, y, yaw) [m, m, rad], map frame; None if it is not localised.
        server: whether its navigation is there.
        goal: what became of the last goal that was sent to it.
        busy: whether it drives to another node's goal.
        goal_place: (x, y) [m] where it drives to, no matter who gave the goal.
    """

    pose: Optional[Pose]
    server: bool = True
    goal: GoalStatus = GoalStatus.NONE
    busy: bool = False
    goal_place: Optional[Tuple[float, float]] = None

    @property
    def running(self) -> bool:
        """Whether it is on its way to the goal that was sent last."""
        return self.goal in (GoalStatus.SENT, GoalStatus.ACTIVE)

    def places(self) -> List[Tuple[float, float]]:
        """[m] where it is and where it drives to: not a place for another robot."""
        return [place for place in (self.pose[:2] if self.pose else None, self.goal_place) if place is not None]


class Record:
    """What is remembered of one robot: its goal, how that goes, and what failed."""

    def __init__(self) -> None:
        self.goal: Optional[Viewpoint] = None
        self._forget()

    def _forget(self) -> None:
        self._sent = self._quiet_until = -math.inf
        self._unfit_since: Optional[float] = None
        self._failed: List[Tuple[float, float, float, float]] = []  # when [s], x, y [m], radius [m]
        self._stage: Tuple[str, float, Optional[Pose]] = ("", 0.0, None)  # what is awaited, since when [s], from where
        self._blind_tries = self.failures = 0
        self.searched = 0.0  # [m] of the line ahead that it has looked at in vain, and looks beyond
        self._way_judged: Tuple[Optional[Viewpoint], float, bool] = (None, 0.0, True)
        self.endangered = False

    def observe(self, moment: Moment, before: Moment, status: RobotStatus) -> Optional[Decision]:
        """Records what happened; returns a decision if there is nothing to choose for this robot now."""
        now = moment.now
        if now < before.now - 1.0:
            self._forget()  # time jumped back: what was remembered is about another run
        if not moment.wanted:
            self.goal = None
            self._forget()
            return Decision(Kind.CANCEL if status.running else Kind.KEEP, "no robot is wanted now")
        if moment.silent <= LOST_AFTER and self._blind_tries:
            self._blind_tries, self.searched = 0, 0.0
            self._failed = [entry for entry in self._failed if entry[3] != BLIND_RADIUS]  # it may be seen from there
        if moment.key != before.key:
            if not status.running:
                self.goal = None  # it belonged to the state before
            self._failed, self.failures, self._unfit_since = [], 0, None
            self._quiet_until = min(self._quiet_until, now)
        if not status.server:
            self.goal = None
            return Decision(Kind.KEEP, "navigation is not there")
        if self.goal is not None:
            problem = self._follow_up(now, status)
            if problem:
                return Decision(Kind.CANCEL, problem)
        return None if status.pose is not None else Decision(Kind.KEEP, "the robot is not localised")

    def _follow_up(self, now: float, status: RobotStatus) -> str:
        """Records how the goal goes; returns why to cancel it, or nothing."""
        late = status.running and self._awaits(now, status.goal.value, status.pose) > WAITS[status.goal.value]
        if status.goal is GoalStatus.FAILED or late:
            self._fail(now)
        elif status.goal is GoalStatus.TAKEN:
            self.goal, self._quiet_until = None, now + YIELD_PAUSE
        elif status.goal is GoalStatus.REACHED:
            self.failures = 0
        return f"what should follow after '{status.goal.value}' did not come in time" if late else ""

    def _awaits(self, now: float, what: str, pose: Optional[Pose]) -> float:
        """[s] for which the same has been awaited without the robot getting anywhere."""
        before, since, start = self._stage
        if what != before or start is None or pose is None or pose_distance(start, pose) >= STUCK_DISTANCE:
            self._stage = (what, since if what == before and pose is None else now, pose)
        return now - self._stage[1]

    def _fail(self, now: float) -> None:
        assert self.goal is not None
        self._failed.append((now, self.goal.x, self.goal.y, FAILED_RADIUS))
        self.goal = self._unfit_since = None
        self.failures += 1
        self._quiet_until = now + (RETRY_AFTER if self.failures % MAX_FAILURES else FAILURE_PAUSE)

    def pausing(self, now: float) -> bool:
        """Whether it sends no goals for a while: after a failure, or because another node took the robot."""
        return now < self._quiet_until

    def failed(self, now: float) -> List[Tuple[float, float, float]]:
        """(x, y, radius) [m] of the places that failed lately."""
        self._failed = [entry for entry in self._failed if now - entry[0] < FAILED_MEMORY]
        return [entry[1:] for entry in self._failed]

    def take(self, now: float, viewpoint: Viewpoint, reason: str) -> Decision:
        """Makes a viewpoint the goal."""
        self.goal, self._sent, self._unfit_since, self._stage = viewpoint, now, None, ("", now, None)
        return Decision(Kind.SEND, reason, viewpoint)

    def release(self, status: RobotStatus) -> Decision:
        """Releases the robot, as another one serves; failed places stay known."""
        self.goal = self._unfit_since = None
        return Decision(Kind.CANCEL if status.running else Kind.KEEP, "another robot serves")

    def stay(self, now: float) -> Decision:
        """There is nowhere to go: asking again at once would give the same answer."""
        if self.endangered:
            self.goal = None
            return Decision(Kind.CANCEL, "the way would lead through what is being drawn")
        self._quiet_until = now + MIN_INTERVAL
        return Decision(Kind.KEEP, "no place from which the spot is seen can be reached without crossing the line")

    def settled(self, moment: Moment, status: RobotStatus, outlook: Outlook) -> str:
        """Why the robot that serves needs no new place now; nothing if it does."""
        now, robot = moment.now, status.pose
        assert robot is not None
        under_way = self.goal is not None and status.running
        if self.goal is not None and not under_way and math.dist(robot[:2], self.goal.pose[:2]) > MIN_GAIN:
            self.goal = None  # the robot was moved since
        goal, lost = self.goal, moment.silent > LOST_AFTER
        self.endangered = under_way and goal is not None and not self._way_is_safe(now, robot, goal, outlook)
        place = goal.pose if under_way and goal is not None else robot
        fits = outlook.fits(place) and not self.endangered and (not under_way or outlook.stands_free(place))
        fits = fits and all(math.dist(place[:2], (x, y)) >= radius for x, y, radius in self.failed(now))
        blind = not under_way and self._is_blind(moment, robot, fits)
        if fits and not blind:
            self._unfit_since = None
            return "the spot is in view there"
        if self.pausing(now):
            return "waiting after a failure or for somebody else"
        if blind:
            self.goal = None
            # first it looks farther along the line, then from elsewhere at where people hold still
            self.searched = 0.0 if self._blind_tries % 2 else outlook.searched(robot)
            self._blind_tries += 1
            self._failed.append((now, robot[0], robot[1], BLIND_RADIUS))
            return "nobody sees the spot from where it should be seen"
        elif goal is not None:
            self._unfit_since = now if self._unfit_since is None else self._unfit_since
            recent = now - self._sent < (LOST_INTERVAL if lost else MIN_INTERVAL) and not self.endangered
            if (now - self._unfit_since < PATIENCE and not lost) or recent:
                return "the goal has become unfit only just now"
            if under_way and not goal.sees_spot and not self.endangered and self.rests(outlook):
                return "on the way off the side to be restricted"
        return ""

    def keeps(self, now: float, status: RobotStatus, outlook: Outlook, offered: Viewpoint) -> bool:
        """Whether the best offer is where the robot already is or goes."""
        goal = self.goal
        if goal is None or math.dist((offered.x, offered.y), (goal.x, goal.y)) >= MIN_GAIN:
            return False
        turn = abs(math.remainder(offered.yaw - goal.yaw, 2.0 * math.pi))
        if turn >= math.radians(20.0) or not (status.running or self.rests(outlook)):
            return False
        self._unfit_since = now
        return True

    def rests(self, outlook: Outlook) -> bool:
        """Whether the target is still about where it was when the goal was chosen."""
        return self.goal is not None and math.dist(outlook.drawing.look_at, self.goal.spot) < MIN_SPOT_MOVE

    def _way_is_safe(self, now: float, robot: Pose, goal: Viewpoint, outlook: Outlook) -> bool:
        if goal.risky and not outlook.drawing.seeding:
            return True
        judged, at, safe = self._way_judged
        if goal is not judged or not 0.0 <= now - at < WAY_CHECK:
            safe = outlook.keeps_off(robot, goal.pose)
            self._way_judged = (goal, now, safe)
        return safe

    def _is_blind(self, moment: Moment, robot: Pose, fits: bool) -> bool:
        """Whether the robot has been long enough where it should see the spot, and no camera reports it.

        Then something hides it from there, or it is farther along the line than it is thought to be.
        """
        waited = self._awaits(moment.now, "seen" if fits else "", robot)
        return fits and self._blind_tries < BLIND_TRIES and min(moment.silent, waited) >= WAITS["seen"]


class Fleet:
    """Holds all robots and which one serves."""

    def __init__(self, robots) -> None:
        self.records: Dict[str, Record] = {name: Record() for name in robots}
        self.serving: Optional[str] = None
        self._before = Moment(-math.inf, False, None)

    @property
    def searched(self) -> float:
        """[m] of the line ahead that robots have looked at in vain, beyond where the spot was seen last."""
        return max(record.searched for record in self.records.values())

    def step(
        self, moment: Moment, robots: Mapping[str, Tuple[RobotStatus, Optional[Outlook]]]
    ) -> Dict[str, Decision]:
        """Decides what each robot should do now.

        Args:
            robots: how each one is, and what it can see; None before anything is known of that.
        """
        decisions: Dict[str, Decision] = {}
        able: Dict[str, Tuple[RobotStatus, Outlook]] = {}
        for name, (status, outlook) in robots.items():
            decision = self.records[name].observe(moment, self._before, status)
            if decision is None and outlook is not None:
                able[name] = (status, outlook)
            else:
                decisions[name] = decision or Decision(Kind.KEEP, "there is nothing to look at yet")
        if self.serving is not None and (moment.key != self._before.key or not moment.wanted) \
                and self.records[self.serving].goal is None:
            self.serving = None  # a robot that is on its way goes on
        self._before = moment
        if able:
            decisions.update(self._choose(moment, robots, able))
        return decisions

    def _choose(self, moment: Moment, robots, able: Mapping[str, Tuple[RobotStatus, Outlook]]) -> Dict[str, Decision]:
        """What those that are able do; the one that takes over also cancels one that is not able."""
        now, serving = moment.now, self.serving if self.serving in able else None
        stays = self.records[serving].settled(moment, *able[serving]) if serving is not None else ""
        decisions = {name: self.records[name].release(status) for name, (status, _) in able.items() if name != serving}
        if serving is not None and stays:
            decisions[serving] = Decision(Kind.KEEP, stays)
            if not self.records[serving].pausing(now):
                return decisions
        offers = [offer for name in able for offer in self._offers(now, name, *able[name])]
        if not offers:
            if serving is not None and not stays:
                decisions[serving] = self.records[serving].stay(now)
            return decisions
        _, chosen, viewpoint = min(offers, key=lambda offer: offer[0])
        record, (status, outlook) = self.records[chosen], able[chosen]
        if chosen != self.serving:
            self.serving = chosen
            decisions = {name: self.records[name].release(other) for name, (other, _) in robots.items()}
        if viewpoint is None:
            decisions[chosen] = Decision(Kind.KEEP, "the spot is in view from where the robot is")
        elif record.keeps(now, status, outlook, viewpoint):
            decisions[chosen] = Decision(Kind.KEEP, "there is no better place")
        else:
            decisions[chosen] = record.take(now, viewpoint, "it is the best place for that")
        return decisions

    def _offers(self, now: float, name: str, status: RobotStatus, outlook: Outlook):
        """What a robot could do, at most one: ((order, cost), its name, where it would go; None: stay)."""
        record, serves = self.records[name], name == self.serving
        assert status.pose is not None
        if record.pausing(now):
            return []
        if not serves and not status.busy and outlook.fits(status.pose):
            return [(((False, record.failures, False, False), 0.0), name, None)]
        found = outlook.best(status.pose, record.failed(now))
        if found is None:
            return []
        order = (not found.sees_spot, record.failures, status.busy and not serves, found.risky)
        return [((order, found.cost - (SWITCH_GAIN if serves else 0.0)), name, found)]
