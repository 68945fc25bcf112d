"""Disturbs a robot under way in drives.py by a border right in front of it, or by a new box on its path."""

import math
import threading
from typing import Any, Callable, Dict, Tuple

import numpy as np
import rospy

from bench.robots.drive_lab import Lab, PoseInDegrees, Row
from vb_core.errors import CodedError
from vb_core.grid_map import distance_transform
from vb_core.geometry import look_ahead
from vb_core.ros.node import wait_until
from vb_evaluation.navigation_check.move_base_goals import GoalOutcome

ENDS: Tuple[PoseInDegrees, ...] = ((7.0, 0.9, 180), (1.6, 1.6, 0))  # between which it drives
BOX_STANDS = 30.0  # [s]; longer than planner_patience and controller_patience, so that navigation starts its recoveries
BOX_AHEAD = np.arange(0.7, 2.0, 0.1)  # [m] along the path; in the scanner's range, but not on the robot


def _disturb_drive(lab: Lab, random: np.random.Generator, act: Callable, slowly: bool) -> Tuple[GoalOutcome, Row]:
    """Drives to the farther of two ends, and calls `act` once the robot is under way; returns outcome and row."""
    goal = max(ENDS, key=lambda end: math.dist(end[:2], lab.pose()[:2]))
    start, driven_before = lab.pose(), float(random.uniform(1.0, 3.0))

    def watch() -> None:
        try:
            if wait_until(lambda: math.dist(lab.pose()[:2], start[:2]) > driven_before, 120.0, 0.02):
                act()
        finally:
            lab.set_slow(False)

    lab.set_slow(slowly)
    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    result = lab.drive(goal)
    thread.join(130.0)
    return result


def measure_drive_with_border_ahead(lab: Lab, number: int, seed: int) -> Row:
    """Measures a drive in which a border is added across the path, 0.25 to 0.6 m in front of the robot."""
    rng = np.random.default_rng([seed, 1000 + number])
    gap = float(rng.uniform(0.25, 0.6))
    result: Dict[str, Any] = {}

    def act() -> None:
        x, y, yaw = lab.pose()
        half = 0.3
        along = half * np.array([math.cos(yaw), math.sin(yaw)])
        across = half * np.array([-math.sin(yaw), math.cos(yaw)])
        middle = np.array([x, y]) + (lab.radius + gap + half) / half * along
        corners = [middle - along - across, middle + along - across, middle + along + across, middle - along + across]
        call_time = rospy.get_time()
        try:
            result["id"] = lab.add(corners, middle, True)
        except CodedError as error:
            result["error"] = error.code
            return
        result.update(at=(x, y), after_s=round(rospy.get_time() - call_time, 2))
        end = rospy.get_time() + 3.0
        wait_until(lambda: rospy.get_time() > end, 60.0)

    driven, row = _disturb_drive(lab, rng, act, slowly=True)
    path = driven.path
    if "at" in result and len(path):
        path = path[int(np.argmin(np.linalg.norm(path - result["at"], axis=1))) :]
    row.update(gap_m=round(gap, 2), after_s=result.get("after_s"))
    row["border"] = result.get("error", "added" if "id" in result else "none")
    row["entered_m"] = round(lab.entered(path), 3) if "id" in result else None
    if "id" in result:
        lab.remove(result["id"])
    return row


def measure_drive_past_box(lab: Lab, number: int, seed: int) -> Row:
    """Measures a drive with a box at the path's narrowest point beside the carpet's border, which is later removed."""
    scenario = lab.world.scenarios["carpet"]
    if min(math.dist(end[:2], lab.pose()[:2]) for end in ENDS) > 0.5:
        lab.drive(ENDS[0])  # if its last goal was refused under way, it may stand in the area of the border
    border = lab.add(scenario.border, scenario.seed, scenario.closed)
    blocked = lab.observer.posterior
    clearance = distance_transform((blocked.data >= 65) | (blocked.data < 0)) * blocked.resolution

    def act() -> None:
        ahead = np.array([look_ahead(lab.plan, lab.pose()[:2], distance)[0] for distance in BOX_AHEAD])
        rows, columns = blocked.world_to_cell(ahead).T
        lab.put_box(ahead[int(np.argmin(clearance[rows, columns]))])
        end = rospy.get_time() + BOX_STANDS
        wait_until(lambda: rospy.get_time() > end, 300.0)
        lab.put_box(None)

    try:
        return _disturb_drive(lab, np.random.default_rng([seed, 2000 + number]), act, slowly=False)[1]
    finally:
        lab.put_box(None)
        lab.remove(border)
