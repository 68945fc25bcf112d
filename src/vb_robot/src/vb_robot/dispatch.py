"""When a robot is sent to a new place: the policy, apart from maps, messages and actions."""
from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import Callable, Hashable, List, Optional, Sequence, Tuple

from vb_core.parameters import Parameters, param
from vb_robot.spots import LOST_AFTER
from vb_robot.viewpoint import Pose, Viewpoint


@dataclass(frozen=True)
class DispatchParams(Parameters):
    """How eager the policy is."""

    min_sightings: int = param(3, low=1, doc="spots before the first goal")
    min_interval: float = param(1.5, "s", low=0.0, doc="between two goals")
    retry_interval: float = param(0.5, "s", low=0.0, doc="after a failure")
    patience: float = param(0.6, "s", low=0.0, doc="how long the present goal must have been unfit to be replaced")
    lost_interval: float = param(0.5, "s", low=0.0, doc="between two goals while nobody sees the spot")
    min_spot_move: float = param(0.3, "m", low=0.0, doc="how far the spot must have gone since the goal was chosen")
    min_gain: float = param(0.25, "m", low=0.0, doc="a new place must differ by this from the present goal")
    failed_radius: float = param(0.3, "m", low=0.0, doc="round a place that failed nothing is tried ...")
    failed_memory: float = param(20.0, "s", low=0.0, doc="... for this long")
    blind_after: float = param(3.0, "s", low=0.5, doc="a robot that stands and sees nothing for so long goes elsewhere")
    blind_radius: float = param(0.5, "m", low=0.0, doc="by at least this")
    blind_tries: int = param(2, low=0, doc="so often, until somebody sees the spot again")
    max_failures: int = param(5, low=1, doc="in a row, then the pause below")
    failure_pause: float = param(8.0, "s", low=0.0)
    yield_pause: float = param(15.0, "s", low=0.0, doc="after somebody else took the robot")
    ack_timeout: float = param(4.0, "s", above=0.0, doc="for navigation to accept a goal")
    stuck_timeout: float = param(15.0, "s", above=0.0, doc="without progress, then the goal has failed")
    stuck_distance: float = param(0.10, "m", above=0.0, doc="less than this is no progress")
    switch_gain: float = param(1.0, "m", low=0.0, doc="so much better another robot must be placed to take over")


class GoalStatus(enum.Enum):
    """What became of the goal that was sent last."""

    NONE = "none"
    SENT = "sent"  # not acknowledged yet
    ACTIVE = "active"
    REACHED = "reached"
    FAILED = "failed"  # aborted, rejected or lost
    TAKEN = "taken"  # preempted although this policy did not cancel it


class Kind(enum.Enum):
    """What is to be done."""

    KEEP = "keep"
    SEND = "send"
    CANCEL = "cancel"


@dataclass(frozen=True)
class Decision:
    """What a robot is to do, and why."""

    kind: Kind
    reason: str
    viewpoint: Optional[Viewpoint] = None


@dataclass(frozen=True)
class Situation:
    """Everything that a decision rests on.

    Attributes:
        now: [s].
        wanted: Border or Seed, and a stationary camera saw the spot in this interaction.
        key: changes with interaction and state.
        spot: (x, y) [m] where the spot is, None if unknown.
        robot: (x, y, yaw), None if not localised.
        server: whether navigation is there.
        goal: what became of the last goal.
        silent: [s] for which no camera has seen the spot.
    """

    now: float
    wanted: bool
    key: Hashable
    spot: Optional[Tuple[float, float]]
    robot: Optional[Pose]
    server: bool
    goal: GoalStatus
    silent: float = 0.0


class DispatchPolicy:
    """Decides, step by step, whether to send the robot, leave it alone or call it off.

    A goal is kept as long as its pose shows the spot. It is replaced only if it has been unfit for a while, the
    spot has moved on, and there is a place that is really another one. A place that failed is left out for a
    while and the next best is tried; so is one from which the spot should be in view and is not reported. If somebody
    else takes the robot, it is left to them for a while.
    """

    def __init__(self, params: DispatchParams) -> None:
        self.params = params
        self.goal: Optional[Viewpoint] = None
        self._key: Hashable = None
        self._now = -math.inf
        self._sent = -math.inf
        self._quiet_until = -math.inf
        self._unfit_since: Optional[float] = None
        self._failed: List[Tuple[float, float, float, float]] = []  # when [s], x, y [m], radius [m]
        self._blind_since: Optional[Tuple[float, Pose]] = None  # since when it stands where it should see the spot
        self._blind_tries = 0
        self._failures = 0
        self._progress: Optional[Tuple[float, Pose]] = None

    def step(
        self,
        situation: Situation,
        fit: Callable[[Pose], bool],
        rank: Callable[[], List[Viewpoint]],
        safe: Callable[[Viewpoint], bool] = lambda viewpoint: True,
    ) -> Decision:
        """The decision for now.

        Args:
            fit: whether a robot at a pose would see the spot well enough.
            rank: makes the candidates, the best first; asked only when a new goal is due.
            safe: whether the way to the present goal still keeps off what is being drawn; asked on the way only.
        """
        return self.observe(situation) or self.choose(situation, fit, rank, safe)

    @property
    def failures(self) -> int:
        """Goals in a row that failed."""
        return self._failures

    def pausing(self, now: float) -> bool:
        """Whether it gives no goals for a while: after a failure, or because somebody else took the robot."""
        return now < self._quiet_until

    def usable(self, candidates: Sequence[Viewpoint]) -> List[Viewpoint]:
        """Those that lie off the places that failed lately."""
        self._failed = [entry for entry in self._failed if self._now - entry[0] < self.params.failed_memory]
        return [
            candidate for candidate in candidates
            if all(math.dist((candidate.x, candidate.y), (x, y)) >= radius for _, x, y, radius in self._failed)
        ]

    def take(self, viewpoint: Viewpoint, reason: str) -> Decision:
        """Makes a viewpoint the goal."""
        self.goal = viewpoint
        self._sent = self._now
        self._unfit_since = None
        self._progress = None
        return Decision(Kind.SEND, reason, viewpoint)

    def release(self, situation: Situation, reason: str) -> Decision:
        """Gives the robot free, for another one goes; what failed is remembered."""
        self.goal = None
        self._unfit_since = self._progress = None
        running = situation.goal in (GoalStatus.SENT, GoalStatus.ACTIVE)
        return Decision(Kind.CANCEL if running else Kind.KEEP, reason)

    def observe(self, situation: Situation) -> Optional[Decision]:
        """Takes note of what happened; gives a decision if there is nothing to choose now."""
        now = situation.now
        if now < self._now - 1.0:  # time jumped back: what was remembered is about another run
            self._restart(forget_goal=False)
        self._now = now
        if not situation.wanted:
            running = situation.goal in (GoalStatus.SENT, GoalStatus.ACTIVE)
            self._restart(forget_goal=True)
            self._key = situation.key
            return Decision(Kind.CANCEL, "no robot is wanted now") if running else Decision(Kind.KEEP, "not wanted")
        if situation.key != self._key:
            self._key = situation.key
            self._failed.clear()
            self._failures = 0
            self._unfit_since = None
            self._quiet_until = min(self._quiet_until, now)
            if situation.goal not in (GoalStatus.SENT, GoalStatus.ACTIVE):
                self.goal = None  # it belonged to the state before
        if not situation.server:
            self.goal = None
            return Decision(Kind.KEEP, "navigation is not there")
        called_off = self._follow_up(situation)
        if called_off is not None:
            return called_off
        if situation.spot is None:
            return Decision(Kind.KEEP, "no spot yet")
        if situation.robot is None:
            return Decision(Kind.KEEP, "the robot is not localised")
        return None

    def _restart(self, forget_goal: bool) -> None:
        if forget_goal:
            self.goal = None
        self._sent = self._quiet_until = -math.inf
        self._unfit_since = None
        self._failed.clear()
        self._failures = self._blind_tries = 0
        self._progress = self._blind_since = None

    def _follow_up(self, situation: Situation) -> Optional[Decision]:
        """Takes note of how the goal goes."""
        now, params = situation.now, self.params
        if self.goal is None:
            return None
        if situation.goal is GoalStatus.SENT and now - self._sent > params.ack_timeout:
            self._fail(now)
            return Decision(Kind.CANCEL, "navigation did not accept the goal in time")
        if situation.goal is GoalStatus.FAILED:
            self._fail(now)
        elif situation.goal is GoalStatus.TAKEN:
            self.goal = None
            self._quiet_until = now + params.yield_pause
        elif situation.goal is GoalStatus.REACHED:
            self._failures = 0
        elif situation.goal is GoalStatus.ACTIVE and situation.robot is not None:
            if self._progress is None or _moved(self._progress[1], situation.robot) >= params.stuck_distance:
                self._progress = (now, situation.robot)
            elif now - self._progress[0] > params.stuck_timeout:
                self._fail(now)
                return Decision(Kind.CANCEL, "the robot got stuck on its way")
        return None

    def _fail(self, now: float) -> None:
        if self.goal is not None:
            self._failed.append((now, self.goal.x, self.goal.y, self.params.failed_radius))
        self.goal = None
        self._progress = None
        self._unfit_since = None
        self._failures += 1
        self._quiet_until = now + self.params.retry_interval
        if self._failures >= self.params.max_failures:
            self._failures = 0
            self._quiet_until = now + self.params.failure_pause

    def choose(
        self,
        situation: Situation,
        fit: Callable[[Pose], bool],
        rank: Callable[[], List[Viewpoint]],
        safe: Callable[[Viewpoint], bool],
    ) -> Decision:
        """The decision after `observe` gave none; the arguments are those of `step`."""
        now, params, goal = situation.now, self.params, self.goal
        assert situation.spot is not None and situation.robot is not None
        under_way = goal is not None and situation.goal in (GoalStatus.SENT, GoalStatus.ACTIVE)
        if goal is not None and not under_way and math.dist(situation.robot[:2], goal.pose[:2]) > params.min_gain:
            goal = self.goal = None  # somebody has moved the robot since
        place = goal.pose if under_way and goal is not None else situation.robot
        endangered = under_way and goal is not None and not safe(goal)
        lost = situation.silent > LOST_AFTER
        fits = fit(place) and not endangered
        blind = self._is_blind(situation, fits and not under_way)
        if fits and not blind:
            self._unfit_since = None
            return Decision(Kind.KEEP, "the spot is in view there")
        if now < self._quiet_until:
            return Decision(Kind.KEEP, "waiting after a failure or for somebody else")
        if blind:
            goal = self.goal = None
            self._blind_tries += 1
            self._failed.append((now, *situation.robot[:2], params.blind_radius))
        if goal is not None:
            if self._unfit_since is None:
                self._unfit_since = now
            recent = now - self._sent < (params.lost_interval if lost else params.min_interval) and not endangered
            if (now - self._unfit_since < params.patience and not lost) or recent:
                return Decision(Kind.KEEP, "the goal has become unfit only just now")
            resting = math.dist(situation.spot, goal.spot) < params.min_spot_move
            if under_way and resting and not goal.sees_spot and not endangered:
                return Decision(Kind.KEEP, "on the way off the side to be restricted")
        for candidate in self.usable(rank()):
            if goal is not None and _same(candidate, goal, params.min_gain):
                # what is best is where the robot goes or stands already
                if under_way or math.dist(situation.spot, goal.spot) < params.min_spot_move:
                    self._unfit_since = now
                    return Decision(Kind.KEEP, "there is no better place")
            whence = "where it should be in view" if blind else "where the robot is or goes"
            return self.take(candidate, f"the spot is not seen from {whence}")
        if endangered:
            self.goal = None
            return Decision(Kind.CANCEL, "the way would lead through what is being drawn")
        # asking again at once would give the same answer
        self._quiet_until = now + params.min_interval
        return Decision(Kind.KEEP, "no place from which the spot is seen can be reached without crossing the line")

    def _is_blind(self, situation: Situation, stands: bool) -> bool:
        """Whether the robot has stood long enough where it should see the spot, and nobody reports it.

        Then something hides it from there, or it is not where it is thought to be.

        Args:
            stands: whether it stands where it should see it, and does not drive to such a place.
        """
        now, params, robot = situation.now, self.params, situation.robot
        assert robot is not None
        if situation.silent <= LOST_AFTER:
            self._blind_tries = 0
        before = self._blind_since
        if not stands or before is None or _moved(before[1], robot) > params.stuck_distance:
            self._blind_since = before = (now, robot) if stands else None
        if before is None or self._blind_tries >= params.blind_tries:
            return False
        return min(situation.silent, now - before[0]) >= params.blind_after


def _moved(a: Pose, b: Pose) -> float:
    """[m] between two poses; a turn counts as what a point 0.2 m off the axis moves."""
    turn = abs(math.remainder(a[2] - b[2], 2.0 * math.pi))
    return math.dist(a[:2], b[:2]) + 0.2 * turn


def _same(a: Viewpoint, b: Viewpoint, distance: float) -> bool:
    turn = abs(math.remainder(a.yaw - b.yaw, 2.0 * math.pi))
    return math.dist((a.x, a.y), (b.x, b.y)) < distance and turn < math.radians(20.0)
