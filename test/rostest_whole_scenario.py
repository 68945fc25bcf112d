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
from vb_evaluation.navigation_check.plan_observer import Observer
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
    def test_a_drawn_line_closes_the_room(self):
        rospy.init_node("whole_scenario")
        world = load_world(rospy.get_param("~world"))
        scenario = world.scenario(rospy.get_param("~scenario"))
        observer, spots = Observer(), []
        alarms, codes_heard = set(), set()
        _pace = Pace()  # works as long as the test runs

        def hear(message: NoticeArray) -> None:
            codes_heard.update(notice.code for notice in message.notices)
            if not (observer.state and observer.state.name == "border" and len(spots) > 20):
                # on a busy computer, slow cameras are rightly reported
                codes = {notice.code for notice in message.notices if notice.code.startswith(ALARMS)}
                alarms.update(codes - {"camera_slow"})

        rospy.Subscriber(names.NOTICES, NoticeArray, hear)

        def keep(spot: LaserSpot) -> None:
            if observer.state is not None and observer.state.name == "border":
                spots.append((spot.position.x, spot.position.y))

        subscriber = rospy.Subscriber(names.SPOTS, LaserSpot, keep)
        wait_until(lambda: observer.outcome is not None, lambda: f"the end; the state is {observer.state}", 500.0)
        self.assertEqual(observer.outcome["outcome"], "saved", observer.outcome)
        wait_until(lambda: observer.state.last_outcome == "saved" and observer.borders, "the saved border")
        self.assertEqual(alarms, set())
        # the person's line became one open border
        border = observer.borders[0]
        self.assertEqual(border.id, observer.state.last_border_id)
        self.assertEqual(border.kind, border.SEPARATING_CURVE)
        # it has all spots that were seen, and is no longer than these. A busy computer's cameras may miss some, and
        # spots after a pause may be reported as left out: a glint, or an end of the line
        subscriber.unregister()
        line = resample_chain(np.array([(p.x, p.y) for p in border.points]), 0.02)
        # missing spots were left out by the extraction if they were collected, else they came after the state
        collected = f"{observer.progress.border_spots} of {len(spots)} spots were collected"
        left_out = np.array([(p.x, p.y) for p in observer.progress.left_out]).reshape(-1, 2)
        self.assertLess(directed_hausdorff(spots, np.vstack([line, left_out]))[0], NEAR, collected)
        self.assertLess(observer.progress.left_out_spots, 0.2 * len(spots))
        self.assertTrue(not len(left_out) or "strokes_left_out" in codes_heard, codes_heard)
        self.assertLess(directed_hausdorff(line[[0, -1]], spots)[0], NEAR)
        self.assertTrue({"red", "green"} & set(observer.progress.cameras), observer.progress.cameras)
        # it restricts the intended area, and nothing else changed
        truth = floor_plan.ground_truth(world, scenario)
        region = metrics.restricted_cells(observer.prior, observer.posterior)
        self.assertGreater(metrics.jaccard(truth, region), 0.9)
        kept = ~region
        self.assertTrue((observer.posterior.data[kept] == observer.prior.data[kept]).all())
        # exact times are tested where the test controls the clock (rostest_input_methods.py)
        self.assertGreater(min(observer.state.border_s, observer.state.seed_s), 0.0)
        # navigation respects it: the room cannot be reached, the floor outside can
        proof = scenario.proof
        start, goal = ((x, y, math.radians(degrees)) for x, y, degrees in (proof.start, proof.goal))
        wait_until(lambda: not len(observer.plan(start, goal, "/move_base/make_plan")), "navigation to know it")
        self.assertTrue(len(observer.plan(start, (4.0, 2.4, 0.0), "/move_base/make_plan")))


if __name__ == "__main__":
    rostest.rosrun("vb_bringup", "whole_scenario", WholeScenario)
