"""Which of several robots goes to the spot: the best placed free one, and another when it fails.

One robot serves at a time. It keeps doing so until it fails, or until a new place is due and another robot is
notably better placed: two that are equally near do not take turns. Robots that failed less come first, then those
that nobody else has given a goal, then those with the shorter way.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Dict, Hashable, Iterable, List, Optional, Sequence, Tuple

from vb_robot.dispatch import Decision, DispatchParams, DispatchPolicy, Kind, Situation
from vb_robot.viewpoint import Pose, Viewpoint


@dataclass(frozen=True)
class Member:
    """One robot as the fleet sees it in one step.

    Attributes:
        situation: what its policy decides upon.
        busy: whether it drives to a goal that somebody else gave it.
        fit, rank, safe: see `DispatchPolicy.step`.
    """

    name: str
    situation: Situation
    busy: bool
    fit: Callable[[Pose], bool]
    rank: Callable[[], List[Viewpoint]]
    safe: Callable[[Viewpoint], bool]


@dataclass(frozen=True)
class _Offer:
    """What a robot could do: go to a viewpoint, or stay where it sees the spot already (None)."""

    member: Member
    viewpoint: Optional[Viewpoint]
    order: Tuple[int, bool, bool]  # failures, busy, risky
    cost: float  # [m]


class Fleet:
    """The policies of all robots, and who serves."""

    def __init__(self, params: DispatchParams, robots: Iterable[str]) -> None:
        self.params = params
        self.policies: Dict[str, DispatchPolicy] = {name: DispatchPolicy(params) for name in robots}
        self.serving: Optional[str] = None
        self._key: Hashable = None

    def step(self, members: Sequence[Member]) -> Dict[str, Decision]:
        """What each robot is to do now."""
        decisions: Dict[str, Decision] = {}
        able: List[Member] = []
        for member in members:
            decision = self.policies[member.name].observe(member.situation)
            if decision is None:
                able.append(member)
            else:
                decisions[member.name] = decision
        key = members[0].situation.key if members else None
        if key != self._key or not any(member.situation.wanted for member in members):
            self._key = key
            if self.serving is not None and self.policies[self.serving].goal is None:
                self.serving = None  # whoever was under way goes on
        if not able:
            return decisions
        serving = next((member for member in able if member.name == self.serving), None)
        if serving is None or self._pausing(serving):
            best = self._best(able)
            if best is not None:
                return self._hand_over(members, best)
        if serving is not None:
            own, better = self._go_on(serving, able)
            if better is not None:
                return self._hand_over(members, better)
            decisions[serving.name] = own
        for member in able:
            if member.name not in decisions:
                decisions[member.name] = self.policies[member.name].release(member.situation, "another robot serves")
        return decisions

    def _pausing(self, member: Member) -> bool:
        return self.policies[member.name].pausing(member.situation.now)

    def _go_on(self, serving: Member, able: Sequence[Member]) -> Tuple[Decision, Optional[_Offer]]:
        """The serving robot's own choice, and the better one of another robot, if a new place is due."""
        policy = self.policies[serving.name]
        better: List[_Offer] = []

        def rank() -> List[Viewpoint]:
            found = serving.rank()
            rivals = [member for member in able if member is not serving]
            best = self._best(rivals) if rivals else None
            own = self._offer(serving, policy.usable(found))
            if best is not None and (own is None or _beats(best, own, self.params.switch_gain)):
                better.append(best)
                return []
            return found

        decision = policy.choose(serving.situation, serving.fit, rank, serving.safe)
        return decision, better[0] if better else None

    def _hand_over(self, members: Sequence[Member], best: _Offer) -> Dict[str, Decision]:
        """The robot of an offer serves, all others are called off, also one that is lost or does not answer."""
        self.serving = best.member.name
        decisions = {
            member.name: self.policies[member.name].release(member.situation, "another robot serves")
            for member in members if member is not best.member
        }
        if best.viewpoint is None:
            decisions[self.serving] = Decision(Kind.KEEP, "the spot is in view from where the robot is")
        else:
            decisions[self.serving] = self.policies[self.serving].take(best.viewpoint, "it is the best placed robot")
        return decisions

    def _best(self, members: Iterable[Member]) -> Optional[_Offer]:
        offers = []
        for member in members:
            if self._pausing(member):
                continue
            robot = member.situation.robot
            if robot is not None and not member.busy and member.fit(robot):
                offers.append(_Offer(member, None, (self.policies[member.name].failures, False, False), 0.0))
                continue
            offer = self._offer(member, self.policies[member.name].usable(member.rank()))
            if offer is not None:
                offers.append(offer)
        return min(offers, key=lambda offer: (offer.order, offer.cost)) if offers else None

    def _offer(self, member: Member, found: Sequence[Viewpoint]) -> Optional[_Offer]:
        if not found or not found[0].sees_spot:
            return None
        order = (self.policies[member.name].failures, member.busy, found[0].risky)
        return _Offer(member, found[0], order, found[0].cost)


def _beats(offer: _Offer, other: _Offer, gain: float) -> bool:
    if offer.order != other.order:
        return offer.order < other.order
    return offer.cost < other.cost - gain
