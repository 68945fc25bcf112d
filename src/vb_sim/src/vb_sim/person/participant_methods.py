"""How a person draws: with the robot alone, or with ceiling cameras and a robot that drives to the parts they miss."""

from __future__ import annotations

import math
from typing import Callable, Dict, Generator, List, Optional, Type

import numpy as np
from shapely.geometry import Point, Polygon

from vb_core import geometry
from vb_sim.model_params import ParticipantModel
from vb_sim.person.hand import Stroke
from vb_sim.person.participant_script import ParticipantScript
from vb_sim.person.person import FEEDBACK_GAP, Person, Step
from vb_sim.person.walking import distance_to_chain
from vb_sim.world import Scenario, World

LOST = 1.5  # [s] without feedback after which the robot has lost the spot
EDGE_BEARING = math.radians(24.0)  # bearing at which the spot is about to leave the image of the robot's camera
RETURN_SPEED = 0.6  # [m/s] of the spot on its way back to the robot
FOLLOWING_DISTANCE = 1.0  # [m] from the spot, at which the robot stops
STEP = 0.05  # [m] between the points of a simulated spot
GO_BACK = 0.08  # [m] before the point where feedback ended, from which a missed part is drawn again


def simulate_follower(spots: np.ndarray, robot: np.ndarray) -> np.ndarray:
    """Computes the distances (N,) [m] between spots (N, 2) [m] and a robot that starts at (2,) [m] and follows them."""
    position = np.asarray(robot, dtype=float)
    distances = []
    for spot in spots:
        to_spot = spot - position
        distance = float(np.linalg.norm(to_spot))
        if distance > FOLLOWING_DISTANCE:
            position = position + to_spot / distance * (distance - FOLLOWING_DISTANCE)
        distances.append(min(distance, FOLLOWING_DISTANCE))
    return np.array(distances)


def choose_order(border: np.ndarray, closed: bool, robot: np.ndarray) -> np.ndarray:
    """Chooses the order (N, 2) [m] that best keeps the spot before the robot; of equals, that which begins nearest.

    A border may be drawn from either end, and a closed one from any corner, either way round. A robot follows only
    forwards and does not see the floor close to it, so the spot should not move towards it.

    Args:
        robot: (2,) [m] the robot's position before it is led to the border's beginning.
    """
    border = np.asarray(border, dtype=float)
    orders = [border, border[::-1]]
    if closed:
        orders = [np.roll(border, -shift, axis=0) for shift in range(len(border))]
        orders += [np.vstack([order[:1], order[:0:-1]]) for order in orders]

    def order_cost(order: np.ndarray) -> float:
        chain = np.vstack([order, order[:1]]) if closed else order
        approach = geometry.resample_chain(np.vstack([robot, order[0]]), STEP)
        drawn = geometry.resample_chain(chain, STEP)
        distances = simulate_follower(np.vstack([approach, drawn]), robot)[len(approach) :]
        nearness = np.maximum(0.8 - distances, 0.0).sum() * STEP
        return float(20.0 * nearness + np.linalg.norm(order[0] - robot))

    return min(orders, key=order_cost)


class RobotOnlyScript(ParticipantScript):
    """The paper's baseline: the person guides the robot to the border, draws while it follows, leads it to the seed."""

    source = "buttons"
    _stroke: Stroke
    _next_check = 0.0
    _last_near_robot = 0.0

    # ------------------------------------------------------------ the course
    def prepare(self) -> Step:
        """Leads the robot to the beginning of the border, and gives the command to draw."""
        person = self.person
        person.doing = "walks"
        while person.perception.robot is None:
            yield
        # the buttons are on the robot
        person.walker.go_to_point_at(self._point_ahead(), np.zeros((0, 2)))
        yield from person.arrive()
        yield from person.react()
        yield from person.repeat_command("guide_robot", self.source)
        person.spot = self._point_ahead()
        guide = person.scenario.guide
        robot = guide[-1] if len(guide) else person.walker.robot
        self._stroke = person.new_stroke(choose_order(person.scenario.border, person.scenario.closed, robot))
        yield from self._lead([*guide, self._stroke.at(self._stroke.start)])
        yield from person.repeat_command("define_border", self.source)
        yield from person.react()

    def trace_border(self) -> Step:
        """Traces the border in front of the following robot, and leads the robot back to each part that it missed."""
        person = self.person
        stroke = self._stroke
        arc = last_seen = stroke.start
        missed = 0
        person.doing = "draws"
        yield from person.move_spot(stroke.at(arc), person.model.robot_drawing_speed)
        while arc < stroke.length:
            unseen = person.spot_lost_time(by_robot=True)
            yield from person.slip_at_random(stroke, arc, person.model.robot_drawing_speed)
            if unseen < FEEDBACK_GAP:
                last_seen = arc
                speed = self._choose_pace() * person.model.robot_drawing_speed * min(stroke.pace(arc), 1.0)
                arc = min(arc + speed * person.dt, stroke.length)
                person.spot = stroke.at(arc)
            elif unseen > person.model.patience / 2.0 and missed < person.model.retries + 2:
                missed += 1
                yield from self._lead_back(stroke, last_seen)
                arc = max(last_seen - 0.05, stroke.start)
            elif unseen > person.model.patience:
                # after enough attempts, people continue to draw
                arc = min(arc + person.model.robot_drawing_speed * person.dt, stroke.length)
                person.spot = stroke.at(arc)
            self._follow(stroke.points)
            yield
        yield from person.hold_until_seen(0.3, 2.0, by_robot=True)

    def _lead_back(self, stroke: Stroke, arc: float) -> Step:
        """Leads the robot back to the point where it lost the spot, in the state Guide, in which nothing is drawn."""
        person = self.person
        person.spot = None
        yield from person.repeat_command("guide_robot", self.source)
        person.spot = self._point_ahead()
        yield from self._lead([stroke.at(arc)])
        yield from person.repeat_command("define_border", self.source)
        person.doing = "draws"

    def show_seed(self) -> Step:
        """Leads the robot to the area to restrict, and points at it."""
        person = self.person
        end = person.spot
        person.spot = None
        yield from person.repeat_command("define_seed", self.source)
        yield from person.react()
        person.spot = end.copy() if end is not None else self._point_ahead()
        yield from self._lead([person.seed], "shows the seed", self._is_on_seed_side)
        person.doing = "shows the seed"
        # holds longer than anywhere on the way, as the seed is the point at which the spot rests
        yield from person.hold_until_seen(person.model.seed_time + 1.0, person.model.patience, by_robot=True)
        yield from person.wait_for_seed(3.0)

    # ------------------------------------------------------------ leading
    def _is_on_seed_side(self, position: np.ndarray) -> bool:
        """Returns whether a point (2,) [m] is clearly on the same side of the border as the seed."""
        person = self.person
        region = Polygon(person.scenario.region)
        border = person.scenario.border
        chain = np.vstack([border, border[:1]]) if person.scenario.closed else border
        same_side = region.contains(Point(position)) == region.contains(Point(person.seed))
        return bool(same_side and distance_to_chain(np.asarray(position), chain) > 0.2)

    def _lead(
        self,
        waypoints: List[np.ndarray],
        activity: str = "leads the robot",
        good_enough: Optional[Callable[[np.ndarray], bool]] = None,
    ) -> Step:
        """Moves the spot along waypoints (2,) [m], no faster than the robot follows.

        Args:
            good_enough: called with the spot's position whenever the robot has found the spot again after losing it
                more than twice. If it returns True, the spot stays there.
        """
        person = self.person
        person.doing = activity
        for waypoint in waypoints:
            lost = 0
            while np.linalg.norm(waypoint - person.spot) > 1e-6:
                unseen = person.spot_lost_time(by_robot=True)
                if unseen < FEEDBACK_GAP + person.model.notice_time:
                    person.step_spot(waypoint, self._choose_pace() * person.model.leading_speed * person.dt)
                elif unseen > LOST:
                    lost += 1
                    yield from self._pick_up(waypoint, lost)
                    if lost > 2 and good_enough is not None and good_enough(person.spot):
                        return
                self._follow(np.zeros((0, 2)))
                yield
        yield from person.hold_until_seen(0.5, person.model.patience, by_robot=True)

    def _pick_up(self, waypoint: np.ndarray, lost: int) -> Step:
        """Moves the spot into the robot's view, and waits until the robot sees it.

        Each time that the spot is lost, it moves slightly farther to the side to which the robot should drive, because
        the robot may be unable to drive straight ahead.
        """
        person = self.person
        activity = person.doing
        person.doing = "waits for the robot"
        x, y, yaw = person.perception.robot
        side = geometry.wrap_angle(math.atan2(waypoint[1] - y, waypoint[0] - x) - yaw)
        angle = min(abs(side), math.radians(6.0) * (lost - 1), EDGE_BEARING * 0.7)
        share = 1.0 - 0.08 * min(lost - 1, 3)
        yield from person.move_spot(self._point_ahead(math.copysign(angle, side), share), RETURN_SPEED)
        yield from person.hold_until_seen(0.1, person.model.patience / 2.0, by_robot=True)
        person.doing = activity

    def _point_ahead(self, turn: float = 0.0, share: float = 1.0) -> np.ndarray:
        """Finds a point (2,) [m] on the floor ahead of the robot, at a share of the leading distance if possible."""
        person = self.person
        x, y, yaw = person.perception.robot
        direction = np.array([math.cos(yaw + turn), math.sin(yaw + turn)])
        distance = person.model.leading_distance * share
        for length in np.linspace(distance, 0.5, 9):
            point = np.array([x, y]) + length * direction
            if person.is_floor(point)[0]:
                return point
        return np.array([x, y]) + distance * direction

    def _choose_pace(self) -> float:
        """Chooses the spot's share of full speed: less if the robot may lose it, and 0 while the robot lags behind.

        Remembers when the robot was last near the spot.
        """
        person = self.person
        x, y, yaw = person.perception.robot
        dx, dy = person.spot - (x, y)
        distance = math.hypot(dx, dy)
        bearing = abs(geometry.wrap_angle(math.atan2(dy, dx) - yaw))
        if distance > person.model.leading_distance_max:
            # if the robot does not come for some time, the person continues while the spot is seen
            return 0.0 if person.perception.now - self._last_near_robot < person.model.patience / 2.0 else 0.5
        self._last_near_robot = person.perception.now
        if bearing > EDGE_BEARING and distance > 0.3:
            # the robot is turning; while it sees the spot, the person continues slowly
            return 0.25
        return 1.0 if distance > 0.5 else 0.6

    # ------------------------------------------------------------ walking
    def _follow(self, line: np.ndarray) -> None:
        """Keeps the person near the spot, out of the robot's path and view."""
        person = self.person
        if person.walker.walking or person.spot is None or person.perception.now < self._next_check:
            return
        self._next_check = person.perception.now + 0.5
        if not person.walker.is_good_position(person.walker.position, person.spot, line):
            person.walker.go_to_point_at(person.spot, line)


class NetworkRobotSystemScript(ParticipantScript):
    """Walks to the border, says "define border", draws, shows the seed, and says "save".

    If no camera sees the spot, the person holds still while the robot is on its way, and then draws the missed part
    again. If no camera sees the spot at either end of the border, the person guides the robot there, as without ceiling
    cameras (paper, Sect. 4.2, Guide).
    """

    _without_cameras: Optional[RobotOnlyScript] = None

    def prepare(self) -> Step:
        """Walks to the scenario's position for drawing, and gives the command to draw."""
        person = self.person
        self._without_cameras = None
        person.doing = "walks"
        person.walker.walk_to(person.scenario.stand)
        yield from person.arrive()
        yield from person.react()
        yield from person.repeat_command("define_border", self.source)
        yield from person.react()

    def trace_border(self) -> Step:
        """Traces the border, and again the parts that no camera saw."""
        person = self.person
        person.doing = "draws"
        stroke = yield from self._find_seen_start()
        if person.spot_lost_time() > person.model.patience / 2.0:
            self._without_cameras = RobotOnlyScript(person)
            yield from self._without_cameras.prepare()
            yield from self._without_cameras.trace_border()
            return
        first_seen = yield from self._draw_along(stroke, stroke.start, stroke.length)
        if first_seen - stroke.start > 2.0 * GO_BACK:
            # no camera saw the beginning; by now the robot is near
            yield from self._draw_along(stroke, min(first_seen + GO_BACK, stroke.length), stroke.start)
        yield from person.hold_until_seen(0.2, 1.0)
        person.spot = None

    def _draw_along(self, stroke: Stroke, start: float, end: float) -> Generator[None, None, float]:
        """Draws from one arc length [m] to another, in either direction. Returns where the spot was first seen."""
        person = self.person
        sign = 1.0 if end >= start else -1.0
        arc = last_seen = start
        first_seen: Optional[float] = None
        missed = 0
        person.spot = stroke.at(arc)
        while True:
            unseen = person.spot_lost_time()
            is_seen = unseen < FEEDBACK_GAP
            may_retry = missed <= person.model.retries
            has_ended = (end - arc) * sign <= 0.0
            # like any other point, the end must be seen
            if has_ended and (is_seen or not may_retry):
                break
            if is_seen:
                last_seen = arc
                first_seen = arc if first_seen is None else first_seen
            elif may_retry and unseen > FEEDBACK_GAP + person.model.notice_time:
                missed += 1
                yield from self._wait_until_seen(stroke)
                arc = max((last_seen - GO_BACK * sign) * sign, start * sign) * sign
                person.doing = "draws"
                yield from person.move_spot(stroke.at(arc), person.drawing_speed)
                # continues from this point, whether or not it has been seen by now
                yield from person.hold_until_seen(0.1, 2.0)
                last_seen = arc
            yield from person.slip_at_random(stroke, arc, person.drawing_speed)
            arc += sign * min(person.drawing_speed * stroke.pace(arc) * person.dt, abs(end - arc))
            person.spot = stroke.at(arc)
            person.walk_within_reach(person.spot, stroke.points)
            yield
        return start if first_seen is None else first_seen

    def _find_seen_start(self) -> Generator[None, None, Stroke]:
        """Returns a stroke from an end of the border at which a camera sees the spot, or from the last end tried."""
        person = self.person
        border = person.scenario.border
        passes = [border, border] if person.scenario.closed else [border, border[::-1], border]
        for points in passes:
            stroke = person.new_stroke(points)
            person.spot = stroke.at(stroke.start)
            person.walk_within_reach(person.spot, stroke.points)
            yield from person.hold_until_seen(0.1, person.model.patience / 2.0)
            if person.spot_lost_time() < FEEDBACK_GAP:
                break
            person.step_aside(person.spot, stroke.points)
        return stroke

    def _wait_until_seen(self, stroke: Stroke) -> Step:
        """Holds the spot still until a camera sees it or patience runs out."""
        person = self.person
        person.doing = "waits for the robot"
        start = person.perception.now
        moved_aside = False
        while person.spot_lost_time() > FEEDBACK_GAP and person.perception.now - start < person.model.patience:
            asked_to_hold = person.perception.now - person.perception.hold_requested_at < person.model.patience
            waited = person.perception.now - start
            if not moved_aside and not asked_to_hold and waited > 2.0 and person.spot is not None:
                # the person's body may hide the spot; but a person whom the display asks to wait for the robot stays
                moved_aside = True
                person.step_aside(person.spot, stroke.points)
            yield

    def show_seed(self) -> Step:
        """Walks to within reach of the area to restrict, and points at it."""
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
            if person.perception.has_seed:
                break
            person.step_aside(person.spot, person.scenario.border)
        yield from person.wait_for_seed(2.0)


SCRIPTS: Dict[str, Type[ParticipantScript]] = {"nrs": NetworkRobotSystemScript, "robot_only": RobotOnlyScript}


def make_script(
    world: World, scenario: Scenario, model: ParticipantModel, method: str, random_seed: int
) -> ParticipantScript:
    """Creates the script of a person who carries out a scenario with a method, one of SCRIPTS."""
    return SCRIPTS[method](Person(world, scenario, model, method, random_seed))
