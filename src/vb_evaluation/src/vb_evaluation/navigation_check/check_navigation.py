"""Checks that a robot's navigation respects virtual borders, on the running move_base before people rely on it.

Puts a small border across the path between the robot and a goal, asks move_base for plans before and after, clears its
costmaps, tries a soft border, and removes everything again. The robot does not drive.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import time
from dataclasses import dataclass
from functools import partial
from typing import Callable, Iterator, List, NamedTuple, Optional, Tuple

import numpy as np
import rospy
from rich.console import Console
from rich.table import Table
from std_srvs.srv import Empty, EmptyRequest

from vb_core import geometry, names, sentences
from vb_core.errors import CodedError
from vb_core.navigation_parameters import is_trinary
from vb_core.ros import messages, node
from vb_core.ros.services import INTEGRATOR, call
from vb_core.ros.transforms import TransformLookup
from vb_evaluation.system_observer import SystemObserver
from vb_msgs.msg import RobotStatus, RobotStatusArray, VirtualBorder
from vb_msgs.srv import AddBorder, AddBorderRequest, RemoveBorder, RemoveBorderRequest

WATCH_TIME = 2.0  # [s] for which plans are requested after the costmaps were cleared
MAX_DRIFT = 0.05  # [m] by which the robot's pose may move while nothing but a border changes
SOFT_OCCUPANCY = 0.75  # delta of the soft border
AROUND, ACROSS, NO_PLAN = "around", "across", "no plan"  # courses of plans
_SIGNS = {True: "[green]ok[/green]", False: "[red]NO[/red]", None: "[yellow]?[/yellow]"}


class Check(NamedTuple):
    """One line of the result. `passed` is None where it could not be determined."""

    name: str
    passed: Optional[bool]
    result: str


def find_course(plan: Callable[[], np.ndarray], middle: np.ndarray, half_size: float) -> str:
    """Asks for a plan and returns whether it leads `AROUND` or `ACROSS` a border, or that there is `NO_PLAN`.

    Args:
        plan: returns a plan (N, 2) [m], empty if there is none.
        middle: (2,) [m] middle of the border.
        half_size: [m] from there, in x and in y, within which a plan crosses the border.
    """
    path = plan()
    if not len(path):
        return NO_PLAN
    distances = np.abs(geometry.resample_chain(path, 0.01) - middle).max(axis=1)
    return ACROSS if np.any(distances < half_size) else AROUND


@dataclass(frozen=True)
class NavigationCheck:
    """Runs the checks against map_integrator and move_base of a running system.

    Args:
        goal: (x, y) [m] in the map frame, somewhere the robot could drive to from where it is.
        size: [m] edge of the square border that is put on the path.
        move_base: name of the node.
        base_frame: name of the robot's base frame.
        at_once: [s] after a border was added until plans have to go around it.
        timeout: [s] to wait for anything before giving up.
    """

    goal: Tuple[float, float]
    size: float = 0.5
    move_base: str = "move_base"
    base_frame: str = "base_link"
    at_once: float = 1.0
    timeout: float = 10.0

    def run(self) -> List[Check]:
        """Runs all checks, in order.

        Raises:
            CodedError: "no_map_with_borders", "no_transform", "no_planner", "no_response", "no_path" or "path_too_short" if
                the checks cannot be made; "refused" if the map integrator refuses the border.
        """
        service = self._resource("make_plan")
        try:
            # a running move_base offers this service without delay
            rospy.wait_for_service(service, timeout=2.0)
        except rospy.ROSException:
            raise CodedError("no_planner", f"no node offers {service}: start move_base first") from None
        observer, transforms = SystemObserver(), TransformLookup()
        if not node.wait_until(lambda: observer.posterior is not None, 10.0):
            raise CodedError("no_map_with_borders", topic=names.MAP_WITH_BORDERS)
        start = self._robot_pose(transforms)
        plan = partial(observer.plan, start, (*self.goal, 0.0), service)
        middle = self._place_border(plan(), start)
        # one cell less: a path may touch the border's edge
        course = partial(find_course, plan, middle, 0.5 * self.size - observer.posterior.resolution)
        checks = []
        with self._border(middle, 1.0):
            checks.append(self._soon("plans respect a new border at once", course, AROUND, self.at_once))
            checks.append(self._check_cleared_costmaps(course))
        checks.append(self._soon("the way is free again once the border is removed", course, ACROSS))
        with self._border(middle, SOFT_OCCUPANCY):
            checks.append(self._check_soft_border(course))
        moved = float(np.hypot(*(np.array(self._robot_pose(transforms)) - start)[:2]))
        return [*checks, Check("localisation does not jump", moved <= MAX_DRIFT, f"moved by {100 * moved:.1f} cm")]

    def _resource(self, name: str) -> str:
        return f"/{self.move_base.strip('/')}/{name}"

    def _robot_pose(self, transforms: TransformLookup) -> geometry.Pose:
        transform = transforms.lookup(names.MAP_FRAME, self.base_frame, rospy.Time(0), timeout=5.0)
        return geometry.pose2d_from_transform(transform)

    def _place_border(self, path: np.ndarray, start: geometry.Pose) -> np.ndarray:
        """Returns the middle (2,) [m] of a path (N, 2) [m], if a border fits there between the robot and the goal."""
        if not len(path):
            raise CodedError("no_path", "move_base finds no path to the goal: choose another one with --goal")
        points = geometry.resample_chain(path, 0.02)
        middle = points[len(points) // 2]
        # the border must be clear of the robot and of the goal
        if np.abs(np.array([start[:2], self.goal]) - middle).max(axis=1).min() < self.size:
            reason = f"a border of {self.size:g} m does not fit on the path: choose a --goal farther away"
            raise CodedError("path_too_short", reason)
        return middle

    @contextlib.contextmanager
    def _border(self, middle: np.ndarray, occupancy: float) -> Iterator[None]:
        """Adds a square border round a point (2,) [m], and removes it at the end."""
        border = VirtualBorder(name="navigation check", kind=VirtualBorder.POLYGON, occupancy=occupancy, enabled=True)
        corners = middle + 0.5 * self.size * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        border.points = messages.points_from_array(corners)
        border.seed = messages.points_from_array(middle[None])[0]
        reply = call(names.ADD_BORDER, AddBorder, AddBorderRequest(border=border, source="check"), INTEGRATOR)
        if not reply.success:
            raise CodedError("refused", f"the map integrator does not take the border ({reply.code}): {reply.message}")
        try:
            yield
        finally:
            call(names.REMOVE_BORDER, RemoveBorder, RemoveBorderRequest(id=reply.id), INTEGRATOR)

    def _check_soft_border(self, course: Callable[[], str]) -> Check:
        """Checks a soft border, if move_base is configured to see one."""
        name = "a soft border is gone round where that is possible"
        costmaps = [self._resource(costmap) for costmap in ("global_costmap", "local_costmap")]
        blind = [costmap for costmap in costmaps if is_trinary(rospy.get_param(costmap, None))]
        if blind:
            return Check(name, None, sentences.translate("soft_border_ignored", {"costmaps": ", ".join(blind)}))
        return self._soon(name, course, AROUND)

    def _check_cleared_costmaps(self, course: Callable[[], str]) -> Check:
        """Checks that plans still go round the border soon after the costmaps were cleared, and keep doing so."""
        name = "a border survives clear_costmaps"
        try:
            call(self._resource("clear_costmaps"), Empty, EmptyRequest(), "move_base")
        except CodedError as error:
            return Check(name, None, str(error))
        # the costmap is empty until its next cycle; what counts is that the border returns on its own
        check = self._soon(name, course, AROUND, self.at_once)
        if not check.passed:
            return check
        courses = []
        end = time.monotonic() + WATCH_TIME
        while time.monotonic() < end:
            courses.append(course())
        crossing, missing = courses.count(ACROSS), courses.count(NO_PLAN)
        result = f"back {check.result}; of {len(courses)} plans after that {crossing} cross it, {missing} are missing"
        is_unknown = missing > 0 and crossing == 0
        return Check(name, None if is_unknown else crossing == 0, result)

    def _soon(self, name: str, course: Callable[[], str], expected: str, limit: float = float("inf")) -> Check:
        """Checks that plans come to take a course within a limit [s] of wall time."""
        start = time.monotonic()
        if not node.wait_until(lambda: course() == expected, self.timeout, 0.02):
            if expected == AROUND and course() == NO_PLAN:  # the border may close the only way
                return Check(name, None, "move_base finds no plan: choose a --goal with another way round")
            return Check(name, False, f"not within {self.timeout:g} s")
        seconds = time.monotonic() - start
        is_in_time = seconds <= limit
        excess = "" if is_in_time else f", {limit:g} s are allowed"
        return Check(name, is_in_time, f"after {seconds:.2f} s{excess}")


def find_robot(name: str) -> RobotStatus:
    """Returns the robot of that name, or the only one, as robot_monitor knows it; without a monitor, default names.

    Raises:
        CodedError: "which_robot" if there is none of that name, or several.
    """
    try:
        robots = rospy.wait_for_message(names.ROBOTS, RobotStatusArray, 3.0).robots
    except rospy.ROSException:
        robots = []
    matches = [robot for robot in robots if name in ("", robot.robot)]
    if robots and len(matches) != 1:
        robot_names = ", ".join(robot.robot for robot in robots)
        raise CodedError("which_robot", f"choose one of these robots with --robot: {robot_names}")
    prefix = f"{name}/" if name else ""
    robot = matches[0] if matches else RobotStatus(frame=f"{prefix}base_link")
    robot.move_base = robot.move_base or f"/{prefix}move_base"
    return robot


def main() -> None:
    """Runs the command. Exits with 1 if a check failed or none could be made."""
    parser = argparse.ArgumentParser(prog="check_navigation", description=(__doc__ or "").splitlines()[0])
    about_goal = "[m] in the map, some metres from the robot, with another way round"
    parser.add_argument("--goal", nargs=2, type=float, required=True, metavar=("X", "Y"), help=about_goal)
    parser.add_argument("--size", type=float, default=0.5, help="[m] edge of the border that is put on the way")
    parser.add_argument("--robot", default="", help="its name, if there are several")
    options = parser.parse_args(rospy.myargv()[1:])
    # rospy's own handler would end the node before its border is taken away
    rospy.init_node("check_navigation", anonymous=True, disable_signals=True)
    console = Console()
    console.print("Asks move_base for plans, with and without a border; half a minute. The robot does not drive.")
    try:
        robot = find_robot(options.robot)
        checks = NavigationCheck(tuple(options.goal), options.size, robot.move_base, robot.frame).run()
    except CodedError as error:
        console.print(str(error), style="red", markup=False)  # a name in brackets is not markup
        sys.exit(1)
    table = Table("", "check", "found")
    for check in checks:
        table.add_row(_SIGNS[check.passed], check.name, check.result)
    console.print(table)
    sys.exit(1 if any(check.passed is False for check in checks) else 0)
