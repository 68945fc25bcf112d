"""Checks that a robot's navigation respects virtual borders, on the running move_base before people rely on it.

Puts a small border across the path between the robot and a goal, asks move_base for plans before and after, clears its
costmaps, tries a soft border, and removes everything again. The robot does not drive.
"""
from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from typing import Callable, List, Optional, Tuple

import numpy as np
import rospy
from rich.console import Console
from rich.table import Table
from std_srvs.srv import Empty, EmptyRequest

from vb_core import geometry, names
from vb_core.errors import CodedError
from vb_core.ros import messages
from vb_core.ros.services import call
from vb_core.ros.transforms import TransformLookup
from vb_evaluation.observer import Observer, wait_until
from vb_msgs.msg import VirtualBorder
from vb_msgs.srv import AddBorder, AddBorderRequest, RemoveBorder, RemoveBorderRequest

WATCHED = 2.0  # [s] for which plans are asked for after the costmaps were cleared
STILL = 0.05  # [m] by which map -> odom may move while nothing but a border changes
SOFT = 0.75  # delta of the soft border
# where move_base keeps them, below its own name; docs/tutorials/first-border-in-your-lab.md says why these values
WANTED = {
    "global_costmap/static_layer/map_topic": names.MAP_WITH_BORDERS,
    "local_costmap/static_layer/map_topic": names.MAP_WITH_BORDERS,
    "global_costmap/static_layer/trinary_costmap": False,
    "local_costmap/static_layer/trinary_costmap": False,
    "make_plan_clear_costmap": False,
}


@dataclass(frozen=True)
class Check:
    """One line of the result; `good` is None where it could not be determined."""

    what: str
    good: Optional[bool]
    found: str


class NavigationCheck:
    """Runs the checks against map_integrator and move_base of a running system.

    Args:
        goal: (x, y) [m] in the map frame, somewhere the robot could drive to from where it is.
        size: [m] edge of the square border that is put on the path.
        move_base: name of the node.
        base_frame: the robot's.
        at_once: [s] after a border was added until plans have to go around it.
        patience: [s] to wait for anything before giving up.
    """

    def __init__(
        self, goal: Tuple[float, float], size: float = 0.5, move_base: str = "move_base", base_frame: str = "base_link",
        at_once: float = 1.0, patience: float = 10.0,
    ) -> None:
        self._goal, self._size, self._move_base = (goal[0], goal[1], 0.0), size, "/" + move_base.strip("/")
        self._at_once, self._patience = at_once, patience
        self._base_frame = base_frame
        self._observer = Observer()
        self._transforms = TransformLookup()
        self._added: List[str] = []
        self._start = (0.0, 0.0, 0.0)

    def run(self) -> List[Check]:
        """All checks, in order.

        Raises:
            CodedError: "no_map", "no_transform", "no_planner", "no_way" or "short_way" if there is nothing to check
                with; "refused" if the map integrator rejects the border.
        """
        service = f"{self._move_base}/make_plan"
        try:
            # that of a running move_base is there at once
            rospy.wait_for_service(service, timeout=2.0)
        except rospy.ROSException:
            raise CodedError("no_planner", f"nobody offers {service}: start move_base, or name it with --move-base") from None
        if not wait_until(lambda: self._observer.posterior is not None, 10.0):
            raise CodedError("no_map", f"nothing on {names.MAP_WITH_BORDERS}: does map_integrator run, and is there a /map?")
        self._start = geometry.transform_pose2d(self._pose(self._base_frame))
        way = self._plan()
        if not len(way):
            raise CodedError("no_way", "move_base finds no way to the goal: choose another with --goal")
        odom = self._pose("odom")
        checks = [self._parameter(name, wanted) for name, wanted in WANTED.items()]
        square = self._square_on(way)
        try:
            border = self._add(square, 1.0)
            seconds = self._seconds_until(lambda: not self._crosses(self._plan(), square))
            checks.append(self._timed("plans respect a new border at once", seconds, self._at_once))
            checks.append(self._cleared(square))
            self._remove(border)
            seconds = self._seconds_until(lambda: self._crosses(self._plan(), square))
            checks.append(self._timed("the way is free again once the border is removed", seconds))
            self._add(square, SOFT)
            seconds = self._seconds_until(lambda: not self._crosses(self._plan(), square))
            checks.append(self._timed("a soft border is gone round where that is possible", seconds))
        finally:
            for identifier in list(self._added):
                self._remove(identifier)
        moved = float(np.linalg.norm((self._pose("odom") - odom)[:2, 3]))
        checks.append(Check("localisation does not jump", moved <= STILL, f"map -> odom moved by {100 * moved:.1f} cm"))
        return checks

    # ------------------------------------------------------------ single checks
    def _parameter(self, name: str, wanted) -> Check:
        found = rospy.get_param(f"{self._move_base}/{name}", None)
        if found is None:
            return Check(f"{name} is {wanted}", None, "not set; another name of the layer, or no costmap_2d")
        same = found == wanted if isinstance(wanted, bool) else "/" + str(found).strip("/") == wanted
        return Check(f"{name} is {wanted}", same, f"it is {found}")

    def _cleared(self, square: np.ndarray) -> Check:
        what = "a border survives clear_costmaps"
        try:
            call(f"{self._move_base}/clear_costmaps", Empty, EmptyRequest(), "move_base")
        except CodedError as error:
            return Check(what, None, str(error))
        # the costmap is empty until its next cycle; what counts is that the border returns on its own
        seconds = self._seconds_until(lambda: not self._crosses(self._plan(), square))
        if seconds is None or seconds > self._at_once:
            return self._timed(what, seconds, self._at_once)
        crossing, asked, end = 0, 0, time.monotonic() + WATCHED
        while time.monotonic() < end:
            asked, crossing = asked + 1, crossing + self._crosses(self._plan(), square)
        return Check(what, crossing == 0, f"back after {seconds:.2f} s; {crossing} of {asked} plans after that cross it")

    def _timed(self, what: str, seconds: Optional[float], limit: float = float("inf")) -> Check:
        if seconds is None:
            return Check(what, False, f"not within {self._patience:g} s")
        allowed = f", {limit:g} s are allowed" if seconds > limit else ""
        return Check(what, seconds <= limit, f"after {seconds:.2f} s{allowed}")

    # ------------------------------------------------------------ what they need
    def _pose(self, frame: str) -> np.ndarray:
        return self._transforms.lookup(names.MAP_FRAME, frame, rospy.Time(0), timeout_s=5.0)

    def _plan(self) -> np.ndarray:
        return self._observer.plan(self._start, self._goal, f"{self._move_base}/make_plan")

    def _square_on(self, way: np.ndarray) -> np.ndarray:
        """(4, 2) [m] a square around the middle of the path, clear of the robot and of the goal."""
        dense = geometry.resample_chain(way, 0.02)
        middle = dense[len(dense) // 2]
        ends = np.array([self._start[:2], self._goal[:2]])
        if np.abs(ends - middle).max(axis=1).min() < self._size:
            raise CodedError("short_way", f"a border of {self._size:g} m does not fit on the way: choose a farther --goal")
        return middle + 0.5 * self._size * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])

    def _crosses(self, way: np.ndarray, square: np.ndarray) -> bool:
        if not len(way):
            return False
        # a cell inwards: a path may touch the border's edge
        reach = 0.5 * self._size - self._observer.posterior.resolution
        return bool((np.abs(geometry.resample_chain(way, 0.01) - square.mean(axis=0)).max(axis=1) < reach).any())

    def _seconds_until(self, condition: Callable[[], bool]) -> Optional[float]:
        """[s] of wall time until a condition held; None if it did not while there was patience."""
        begin = time.monotonic()
        return time.monotonic() - begin if wait_until(condition, self._patience, 0.02) else None

    def _add(self, square: np.ndarray, occupancy: float) -> str:
        border = VirtualBorder(name="navigation check", kind=VirtualBorder.POLYGON, occupancy=occupancy, enabled=True)
        border.points = messages.points_from_array(square)
        border.seed = messages.points_from_array(square.mean(axis=0)[None])[0]
        request = AddBorderRequest(border=border, source="check")
        reply = call(names.ADD_BORDER, AddBorder, request, "the map integrator")
        if not reply.success:
            raise CodedError("refused", f"the map integrator does not take the border ({reply.code}): {reply.message}")
        self._added.append(reply.id)
        return reply.id

    def _remove(self, identifier: str) -> None:
        call(names.REMOVE_BORDER, RemoveBorder, RemoveBorderRequest(id=identifier), "the map integrator")
        self._added.remove(identifier)


def main() -> None:
    """The command; exits with 1 if a check failed or none could be made."""
    parser = argparse.ArgumentParser(prog="check_navigation", description=__doc__.splitlines()[0])
    parser.add_argument("--goal", nargs=2, type=float, required=True, metavar=("X", "Y"),
                        help="[m] in the map, some metres from the robot, with another way round")
    parser.add_argument("--size", type=float, default=0.5, help="[m] edge of the border that is put on the way")
    parser.add_argument("--move-base", default="move_base", help="name of the node")
    parser.add_argument("--base-frame", default="base_link", help="frame of the robot")
    options = parser.parse_args(rospy.myargv()[1:])
    rospy.init_node("check_navigation", anonymous=True)
    console = Console()
    console.print("Asks move_base for plans, with and without a border; half a minute. The robot does not drive.")
    try:
        checks = NavigationCheck(tuple(options.goal), options.size, options.move_base, options.base_frame).run()
    except CodedError as error:
        console.print(f"[red]{error}[/red]")
        sys.exit(1)
    table = Table("", "check", "found")
    for check in checks:
        sign = {True: "[green]ok[/green]", False: "[red]NO[/red]", None: "[yellow]?[/yellow]"}[check.good]
        table.add_row(sign, check.what, check.found)
    console.print(table)
    sys.exit(1 if any(check.good is False for check in checks) else 0)
