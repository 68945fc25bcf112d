"""Surprises for a robot under way in drives.py: a border right in front of it, a box that was not there."""

import math
import threading

import numpy as np
import rospy

from vb_core.errors import CodedError
from vb_core.grid_map import distance_to
from vb_core.geometry import look_ahead
from vb_evaluation.observer import wait_until

ENDS = [(7.0, 0.9, 180), (1.6, 1.6, 0)]  # (x, y [m], yaw [deg]) between which it drives
BOX_STANDS = 30.0  # [s]: longer than planner_patience and controller_patience, so that navigation begins its recoveries
BOX_AHEAD = np.arange(0.7, 2.0, 0.1)  # [m] along the path: near enough for the scan, not on the robot


def surprise(lab, rng, act, slowly):
    """Drives to the farther of two ends, and calls `act` once the robot is under way; returns outcome and row."""
    goal = max(ENDS, key=lambda end: math.dist(end[:2], lab.pose()[:2]))
    start, driven_before = lab.pose(), float(rng.uniform(1.0, 3.0))

    def watch():
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


def drive_nose(lab, number, seed) -> dict:
    """Measures a drive in which a border is drawn across the path, 0.25 to 0.6 m in front of the robot."""
    rng = np.random.default_rng([seed, 1000 + number])
    gap = float(rng.uniform(0.25, 0.6))
    put = {}

    def act():
        x, y, yaw = lab.pose()
        ahead, half = lab.radius + gap, 0.3
        along = half * np.array([math.cos(yaw), math.sin(yaw)])
        across = half * np.array([-math.sin(yaw), math.cos(yaw)])
        middle = np.array([x, y]) + (ahead + half) / half * along
        corners = [middle - along - across, middle + along - across, middle + along + across, middle - along + across]
        called = rospy.get_time()
        try:
            put["id"] = lab.add(corners, middle, True)
        except CodedError as error:
            put["error"] = error.code
            return
        put["at"], put["after_s"], until = (x, y), round(rospy.get_time() - called, 2), rospy.get_time() + 3.0
        wait_until(lambda: rospy.get_time() > until, 60.0)

    driven, row = surprise(lab, rng, act, slowly=True)
    path = driven.path
    if "at" in put and len(path):
        path = path[int(np.argmin(np.linalg.norm(path - put["at"], axis=1))) :]
    row.update(gap_m=round(gap, 2), after_s=put.get("after_s"))
    row["border"] = put.get("error", "added" if "id" in put else "none")
    row["entered_m"] = round(lab.entered(path), 3) if "id" in put else None
    if "id" in put:
        lab.remove(put["id"])
    return row


def drive_box(lab, number, seed) -> dict:
    """Measures a drive with a box put where the path is narrowest, beside the carpet's border, and taken away again."""
    what = lab.world.scenarios["carpet"]
    if min(math.dist(end[:2], lab.pose()[:2]) for end in ENDS) > 0.5:
        lab.drive(ENDS[0])  # its last goal was refused under way; it may stand where the border will be
    border = lab.add(what.border, what.seed, what.closed)
    blocked = lab.observer.posterior
    clearance = distance_to((blocked.data >= 65) | (blocked.data < 0)) * blocked.resolution

    def act():
        ahead = np.array([look_ahead(lab.plan, lab.pose()[:2], distance)[0] for distance in BOX_AHEAD])
        rows, columns = blocked.world_to_cell(ahead).T
        lab.put_box(ahead[int(np.argmin(clearance[rows, columns]))])
        until = rospy.get_time() + BOX_STANDS
        wait_until(lambda: rospy.get_time() > until, 300.0)
        lab.put_box(None)

    try:
        return surprise(lab, np.random.default_rng([seed, 2000 + number]), act, slowly=False)[1]
    finally:
        lab.put_box(None)
        lab.remove(border)
