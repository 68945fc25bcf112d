#!/usr/bin/env python3
"""A simulated person excludes a room: cameras, detection, fusion, interaction, integration, navigation."""

import math
import unittest

import numpy as np
import rospy
import rostest
from scipy.spatial.distance import directed_hausdorff
from std_msgs.msg import Float64
from vb_testing import wait_until
from vb_core import names
from vb_core.geometry import resample_chain
from vb_evaluation import metrics
from vb_evaluation.system_observer import SystemObserver
from vb_msgs.msg import DetectorStatus, LaserSpot, NoticeArray
from vb_sim.lab_simulator_node import MIN_PACE
from vb_sim import floor_plan
from vb_sim.world import load_world

# notices that must not appear while a faultless lab starts and somebody begins to draw
ALARMS = ("camera_", "detector_", "lab_", "spot_not_seen_no_robot")
RATE = 25.0  # [1/s] of the lab's cameras
NEAR = 0.1  # [m] between the spots seen and the line extracted from them


class Pace:
    """Slows simulated time down until this computer searches at least half of the cameras' images, even if busy."""

    def __init__(self) -> None:
        self._pace = 1.0
        self._publisher = rospy.Publisher(names.PACE, Float64, queue_size=1)
        rospy.Subscriber(names.DETECTORS, DetectorStatus, self._adapt, queue_size=10)

    def _adapt(self, status: DetectorStatus) -> None:
        self._pace *= 0.7 if status.rate_hz < 0.5 * RATE else 1.3
        self._pace = min(max(self._pace, MIN_PACE), 1.0)
        self._publisher.publish(self._pace)


class WholeScenario(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        """Watches the simulated person until the border is saved."""
        rospy.init_node("whole_scenario")
        cls.world = load_world(rospy.get_param("~world"))
        cls.scenario = cls.world.scenario(rospy.get_param("~scenario"))
        cls.spots = []
        cls.alarms = set()
        cls.codes_heard = set()
        cls.observer = SystemObserver()
        cls.pace = Pace()  # works as long as the test runs
        rospy.Subscriber(names.NOTICES, NoticeArray, cls.hear)
        subscriber = rospy.Subscriber(names.SPOTS, LaserSpot, cls.keep)
        watched = cls.observer
        wait_until(lambda: watched.outcome is not None, lambda: f"the end; the state is {watched.state}", 500.0)
        assert watched.outcome["outcome"] == "saved", watched.outcome
        wait_until(lambda: watched.state.last_outcome == "saved" and watched.borders, "the saved border")
        subscriber.unregister()
        cls.state = watched.state
        cls.progress = watched.progress
        cls.border = watched.borders[0]

    @classmethod
    def is_drawing(cls):
        return cls.observer.state is not None and cls.observer.state.name == "border"

    @classmethod
    def hear(cls, message):
        cls.codes_heard.update(notice.code for notice in message.notices)
        if not cls.is_drawing() or len(cls.spots) <= 20:
            # on a busy computer, slow cameras are rightly reported
            codes = {notice.code for notice in message.notices if notice.code.startswith(ALARMS)}
            cls.alarms.update(codes - {"camera_slow"})

    @classmethod
    def keep(cls, spot):
        if cls.is_drawing():
            cls.spots.append((spot.position.x, spot.position.y))

    def test_a_faultless_lab_raises_no_alarm(self):
        self.assertEqual(self.alarms, set())

    def test_the_line_became_one_open_border(self):
        self.assertEqual(self.border.id, self.state.last_border_id)
        self.assertEqual(self.border.kind, self.border.SEPARATING_CURVE)
        # exact times are tested where the test controls the clock (rostest_input_methods.py)
        self.assertGreater(min(self.state.border_s, self.state.seed_s), 0.0)

    def test_the_border_follows_the_spots(self):
        line = resample_chain(np.array([(p.x, p.y) for p in self.border.points]), 0.02)
        # a glint, or an end of the line that was drawn after a pause
        left_out = np.array([(p.x, p.y) for p in self.progress.left_out]).reshape(-1, 2)
        # a spot that is missing was either left out by the extraction, or came after the state and was not collected
        collected = f"{self.progress.border_spots} of {len(self.spots)} spots were collected"
        self.assertLess(directed_hausdorff(self.spots, np.vstack([line, left_out]))[0], NEAR, collected)
        self.assertLess(self.progress.left_out_spots, 0.2 * len(self.spots))
        self.assertTrue(not len(left_out) or "strokes_left_out" in self.codes_heard, self.codes_heard)
        self.assertLess(directed_hausdorff(line[[0, -1]], self.spots)[0], NEAR)
        self.assertTrue({"red", "green"} & set(self.progress.cameras), self.progress.cameras)

    def test_only_the_intended_area_is_restricted(self):
        prior, posterior = self.observer.prior, self.observer.posterior
        region = metrics.restricted_cells(prior, posterior)
        truth = floor_plan.ground_truth(self.world, self.scenario)
        self.assertGreater(metrics.jaccard(truth, region), 0.9)
        self.assertTrue((posterior.data[~region] == prior.data[~region]).all())

    def test_navigation_cannot_reach_the_room(self):
        proof = self.scenario.proof
        start, goal = [(x, y, math.radians(degrees)) for x, y, degrees in (proof.start, proof.goal)]
        plan = self.observer.plan
        wait_until(lambda: not len(plan(start, goal, "/move_base/make_plan")), "navigation to know it")
        self.assertTrue(len(plan(start, (4.0, 2.4, 0.0), "/move_base/make_plan")))


if __name__ == "__main__":
    rostest.rosrun("vb_bringup", "whole_scenario", WholeScenario)
