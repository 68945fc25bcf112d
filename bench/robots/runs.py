#!/usr/bin/env python3
"""Robots over many interactions: collisions, borders entered, speed, waiting at the hand-over.

    python3 bench/robots/runs.py                                    every scenario and method, 20 seeds
    python3 bench/robots/runs.py --scenarios corner --methods nrs --seeds 1 2 3

The study's nodes run without a ROS master, in simulated time as fast as the processor goes (vb_evaluation.virtual_ros).
Once the border is saved navigation is sent to places on either side of it and in it: it must go round or refuse. The judge
sees the lab's ground truth 50 times a second, none of what the robot believes. *Hold*: the longest time that a person
waited for the robot while drawing. Exits non-zero if a run broke a rule.
"""

import itertools
import sys

import actionlib
import numpy as np
import rospy
from actionlib_msgs.msg import GoalStatus
from move_base_msgs.msg import MoveBaseAction, MoveBaseGoal

from bench.frame import Table, arguments
from vb_core import names
from vb_core.grid_map import distance_to
from vb_core.ros.messages import OccupancyGridArray, grid_from_message, message_from_pose2d
from vb_evaluation.study import config
from vb_evaluation.study.result import RunTask
from vb_evaluation.study.runner import LiveRun
from vb_msgs.msg import InteractionState, LabState, LaserSpot

GUIDED_SPEED = 0.2  # [m/s] while a person leads the robot or draws with it alone
DRIVEN_SPEED = 0.5  # [m/s] under navigation
SPEED_TOLERANCE = 0.005  # [m/s] speeds are differences of positions
WAIT_GOAL_S = 10.0
GOAL_S = 60.0  # [s] for navigation to reach a goal or to give it up


class Judge:
    """Watches one run by the ground truth and keeps what it is judged by."""

    def __init__(self, radius: float, guided: bool) -> None:
        self._radius, self._guided_method = radius, guided
        self._maps, self._obstacle_gap, self._border_gap = {}, None, None
        self._before = self._lit_since = self._holds_since = None
        self._allowed_gap, self._seen_at, self.state = np.inf, -np.inf, "default"
        self.least_clearance = np.inf
        self.figures = dict.fromkeys(
            ("border_entered_m", "guided_speed_m_s", "speed_m_s", "longest_hold_s", "longest_unseen_s", "way_m"), 0.0
        )

    def watch(self) -> list:
        """Subscribes to what it judges by."""
        return [
            rospy.Subscriber(names.PHYSICAL_MAP, OccupancyGridArray, self._on_map, "physical"),
            rospy.Subscriber(names.MAP_WITH_BORDERS, OccupancyGridArray, self._on_map, "with borders"),
            rospy.Subscriber(names.STATE, InteractionState, lambda m: setattr(self, "state", m.name)),
            rospy.Subscriber(names.SPOTS, LaserSpot, self._on_spot),
            rospy.Subscriber(names.LAB_STATE, LabState, self._on_lab),
        ]

    def _on_spot(self, message: LaserSpot) -> None:
        self._seen_at = max(self._seen_at, message.header.stamp.to_sec())

    def _on_map(self, message: OccupancyGridArray, which: str) -> None:
        self._maps[which] = grid_from_message(message)
        if len(self._maps) == 2:
            physical, posterior = self._maps["physical"], self._maps["with borders"]
            self._obstacle_gap = distance_to(physical.data >= 65) * physical.resolution
            restricted = posterior.data > np.maximum(physical.data, 0)
            self._border_gap = distance_to(restricted) * physical.resolution if restricted.any() else None
            # a border may be put where the robot stands: from then on it must not go deeper
            self._allowed_gap = np.inf

    def _on_lab(self, message: LabState) -> None:
        if message.robot_poses:
            now, pose = message.header.stamp.to_sec(), message.robot_poses[0]
            self._time_waits(now, message.laser_on, message.participant_doing)
            if self._obstacle_gap is not None:
                self._watch_robot(now, np.array([[pose.x, pose.y]]))

    def _time_waits(self, now: float, laser_on: bool, doing: str) -> None:
        drawing, holds = self.state == "border" and laser_on, self.state == "border" and doing == "waits for the robot"
        self._lit_since = (self._lit_since if self._lit_since is not None else now) if drawing else None
        self._holds_since = (self._holds_since if self._holds_since is not None else now) if holds else None
        if drawing:
            self._most("longest_unseen_s", now - max(self._seen_at, self._lit_since))
        if holds:
            self._most("longest_hold_s", now - self._holds_since)

    def _watch_robot(self, now: float, place: np.ndarray) -> None:
        row, column = self._maps["physical"].world_to_cell(place)[0]
        self.least_clearance = min(self.least_clearance, float(self._obstacle_gap[row, column]) - self._radius)
        if self._border_gap is not None:
            gap = min(float(self._border_gap[row, column]) - self._radius, 0.0)
            # one that has left may not come back, one that was enclosed may not go deeper
            self._allowed_gap = gap if np.isinf(self._allowed_gap) else max(self._allowed_gap, gap)
            self._most("border_entered_m", self._allowed_gap - gap)
        if self._before is not None and now > self._before[0]:
            step = float(np.linalg.norm(place - self._before[1]))
            self.figures["way_m"] += step
            self._most("speed_m_s", step / (now - self._before[0]))
            if self.state == "guide" or (self._guided_method and self.state in ("border", "seed")):
                self._most("guided_speed_m_s", step / (now - self._before[0]))
        self._before = (now, place)

    def _most(self, key: str, value: float) -> None:
        self.figures[key] = max(self.figures[key], value)

    def breaches(self, cell: float, outcome: str, collisions: int) -> list:
        """Which rules were broken; places are known to a cell [m]."""
        f = self.figures
        rules = {
            "no border came out": outcome != "saved",
            "collision": self.least_clearance < -cell or collisions > 0,
            "border entered": f["border_entered_m"] > 2.0 * cell,
            "too fast while guided": f["guided_speed_m_s"] > GUIDED_SPEED + SPEED_TOLERANCE,
            "too fast": f["speed_m_s"] > DRIVEN_SPEED + SPEED_TOLERANCE,
            f"the person waited more than {WAIT_GOAL_S:g} s": f["longest_hold_s"] > WAIT_GOAL_S,
        }
        return [rule for rule, broken in rules.items() if broken]


def go_to(places) -> str:
    """Sends navigation to places (x, y) [m]; returns what became of the goals."""
    client, states = actionlib.SimpleActionClient("/move_base", MoveBaseAction), []
    while client.action_client.last_status_msg is None:
        rospy.sleep(0.1)
    for x, y in places:
        goal = MoveBaseGoal()
        goal.target_pose.header.frame_id = names.MAP_FRAME
        goal.target_pose.pose = message_from_pose2d(float(x), float(y), 0.0)
        client.send_goal_and_wait(goal, rospy.Duration(GOAL_S), rospy.Duration(2.0))
        states.append(GoalStatus.to_string(client.get_state()).lower())
    return " ".join(states)


def run(study, scenario: str, method: str, seed: int) -> dict:
    """Performs one run; the seed is the participant's number."""
    live = LiveRun(study, RunTask(seed, scenario, method))
    judge, goals = Judge(study.world.robots[0].radius, method == "robot_only"), []
    proof = live.scenario.proof
    after = [proof.start[:2], proof.goal[:2], live.scenario.seed]
    result = live.run(judge.watch, lambda: goals.append(go_to(after)))
    outcome = result.outcome or "time is up"
    return {
        "outcome": outcome,
        "least_clearance_m": judge.least_clearance,
        **judge.figures,
        "goals": result.goals,
        "goals_after": goals[0] if goals and result.saved else "",
        "breaches": "; ".join(judge.breaches(study.world.room.resolution, outcome, result.collisions)),
    }


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--scenarios", nargs="+", default=["room", "carpet", "corner"])
    parser.add_argument("--methods", nargs="+", default=["nrs", "robot_only"], choices=["nrs", "robot_only"])
    parser.add_argument("--seeds", nargs="+", type=int, default=list(range(1, 21)))
    given = parser.parse_args()
    study, table = config.load(), Table(given.csv)
    for task in itertools.product(given.scenarios, given.methods, given.seeds):
        table.add(**dict(zip(("scenario", "method", "seed"), task)), **run(study, *task))
    bad = sum(bool(row["breaches"]) for row in table.rows)
    print(f"{len(table.rows)} runs, rules broken in {bad}")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
