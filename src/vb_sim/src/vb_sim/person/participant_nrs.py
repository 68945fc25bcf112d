"""A person who draws with the network robot system: ceiling cameras, and a robot that comes on its own."""

from __future__ import annotations

from typing import Generator, Optional

from vb_sim.person.hand import Stroke
from vb_sim.person.participant import FEEDBACK_GAP, ParticipantScript, Step
from vb_sim.person.participant_robot_only import RobotOnlyScript

GO_BACK = 0.08  # [m] a missed part is drawn again from this far before the point where feedback ended


class NetworkRobotSystemScript(ParticipantScript):
    """Walks to the border, says "define border", draws, shows the seed, says "save".

    Where no camera sees the spot, the person holds still while the robot is on its way, and then draws the missed part
    again. If no camera sees the spot at either end of the border, the person guides the robot there, as without any
    ceiling camera (paper, Sect. 4.2, Guide).
    """

    _without_cameras: Optional[RobotOnlyScript] = None

    def prepare(self) -> Step:
        """Walks to where the border can be drawn from, and asks to draw it."""
        person = self.person
        self._without_cameras = None
        person.doing = "walks"
        person.walker.go(person.scenario.stand)
        yield from person.arrive()
        yield from person.react()
        yield from person.repeat_command("define_border", self.source)
        yield from person.react()

    def draw(self) -> Step:
        """Draws the border, and redraws the parts that were not seen."""
        person = self.person
        person.doing = "draws"
        stroke = yield from self._seen_start()
        if person.unseen_for() > person.model.patience / 2.0:
            self._without_cameras = RobotOnlyScript(person)
            yield from self._without_cameras.prepare()
            yield from self._without_cameras.draw()
            return
        first_seen = yield from self._draw_along(stroke, stroke.start, stroke.length)
        if first_seen - stroke.start > 2.0 * GO_BACK:
            # the beginning was drawn unseen; by now the robot is near
            yield from self._draw_along(stroke, min(first_seen + GO_BACK, stroke.length), stroke.start)
        yield from person.hold_until_seen(0.2, 1.0)
        person.spot = None

    def _draw_along(self, stroke: Stroke, begin: float, end: float) -> Generator[None, None, float]:
        """Draws from one arc length [m] to another, either way; returns that at which the spot was first seen."""
        person = self.person
        sign = 1.0 if end >= begin else -1.0
        arc = seen_at = begin
        first_seen: Optional[float] = None
        missed = 0
        person.spot = stroke.at(arc)
        # like any other point, the end counts only once it was seen
        while (end - arc) * sign > 0.0 or (missed <= person.model.retries and person.unseen_for() >= FEEDBACK_GAP):
            if person.unseen_for() < FEEDBACK_GAP:
                seen_at = arc
                first_seen = arc if first_seen is None else first_seen
            elif missed <= person.model.retries and person.unseen_for() > FEEDBACK_GAP + person.model.notice_time:
                missed += 1
                yield from self._hold(stroke)
                arc = max((seen_at - GO_BACK * sign) * sign, begin * sign) * sign
                person.doing = "draws"
                yield from person.move_spot(stroke.at(arc), person.drawing_speed)
                # this point counts as seen: what follows is assessed anew
                yield from person.hold_until_seen(0.1, 2.0)
                seen_at = arc
            yield from person.maybe_make_slip(stroke, arc, person.drawing_speed)
            arc += sign * min(person.drawing_speed * stroke.pace(arc) * person.dt, abs(end - arc))
            person.spot = stroke.at(arc)
            person.walk_within_reach(person.spot, stroke.points)
            yield
        return begin if first_seen is None else first_seen

    def _seen_start(self) -> Generator[None, None, Stroke]:
        """Returns a stroke that begins where a camera sees the spot, if there is such an end."""
        person = self.person
        border = person.scenario.border
        for order in (border, border) if person.scenario.closed else (border, border[::-1], border):
            stroke = person.new_stroke(order)
            person.spot = stroke.at(stroke.start)
            person.walk_within_reach(person.spot, stroke.points)
            yield from person.hold_until_seen(0.1, person.model.patience / 2.0)
            if person.unseen_for() < FEEDBACK_GAP:
                break
            person.step_aside(person.spot, stroke.points)
        return stroke

    def _hold(self, stroke: Stroke) -> Step:
        """Holds still where no camera sees the spot, until one does or patience runs out."""
        person = self.person
        person.doing = "waits for the robot"
        began = person.percept.now
        aside = False
        while person.unseen_for() > FEEDBACK_GAP and person.percept.now - began < person.model.patience:
            told = person.percept.now - person.percept.hold_requested < person.model.patience
            if not aside and not told and person.percept.now - began > 2.0 and person.spot is not None:
                # perhaps the person's body is in the way; one who was told to wait for the robot knows better
                aside = True
                person.step_aside(person.spot, stroke.points)
            yield

    def show_seed(self) -> Step:
        """Walks to within reach, and points at the area to be restricted."""
        person = self.person
        if self._without_cameras is not None:
            yield from self._without_cameras.show_seed()
            return
        person.doing = "walks"
        person.walk_within_reach(person.seed, person.scenario.border)
        yield from person.react()
        yield from person.repeat_command("define_seed", self.source)
        yield from person.arrive()
        yield from person.react()
        person.doing = "shows the seed"
        person.spot = person.seed.copy()
        for _ in range(2):
            yield from person.hold_until_seen(person.model.seed_time, person.model.patience)
            if person.percept.has_seed:
                break
            person.step_aside(person.spot, person.scenario.border)
        yield from person.wait_for_seed(2.0)
