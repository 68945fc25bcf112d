#!/usr/bin/env python3
"""The node border_fusion, fed with states and spots."""

import os
import signal
import unittest

import numpy as np
import rospy
import rostest
from vb_testing import TIMEOUT, Newest, process_of, wait_until

from vb_core import names
from vb_core.interaction_tables import BORDER, DEFAULT, SEED, State
from vb_msgs.msg import BorderProgress, InteractionState, LaserSpot, NoticeArray, VirtualBorder
from vb_msgs.srv import GetDrawnBorder

AT_ONCE = 100  # spots: a quarter of the node's queue


def square(count: int) -> np.ndarray:
    """Returns points along a square of 1 m, with a gap of 0.1 m."""
    s = np.linspace(0.0, 3.9, count)
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]], float)
    points = np.column_stack([np.interp(s, range(5), corners[:, k]) for k in range(2)])
    return points + np.random.default_rng(0).normal(0, 0.01, points.shape)


def codes(notices: NoticeArray) -> set:
    return {notice.code for notice in notices.notices}


class BorderFusionTest(unittest.TestCase):
    def setUp(self) -> None:
        self.state = rospy.Publisher(names.STATE, InteractionState, queue_size=10, latch=True)
        self.spots = rospy.Publisher(names.SPOTS, LaserSpot, queue_size=1000)
        self.progress, self.notices = Newest(names.PROGRESS, BorderProgress), Newest(names.NOTICES, NoticeArray)
        self.ends = (self.state, self.spots, self.progress.subscriber, self.notices.subscriber)
        for end in self.ends:
            self.addCleanup(end.unregister)
        self.connected()
        self.enter(DEFAULT, "")  # as every manager starts
        self.drawn_border = rospy.ServiceProxy(names.GET_DRAWN_BORDER, GetDrawnBorder)

    def connected(self) -> None:
        wait_until(lambda: all(end.get_num_connections() for end in self.ends), "the connection")
        rospy.wait_for_service(names.GET_DRAWN_BORDER, TIMEOUT)

    def enter(self, state: State, interaction: str, outcome: str = "", age: float = 0.0) -> None:
        message = InteractionState(name=state.name, interaction_id=interaction, last_outcome=outcome)
        message.header.stamp = message.entered = rospy.Time.now() - rospy.Duration(age)
        self.entered = message.entered
        known = self.progress.count
        self.state.publish(message)
        if state != DEFAULT:
            wait_until(
                lambda: any(seen.interaction_id == interaction for seen in self.progress.all[known:]),
                f"the change to {state.name}",
            )

    def show(self, points, camera: str = "red", frame: str = "map", age: float = 0.0, since: float = 0.0) -> None:
        """Publishes spots as fast as the node counts them, but stamped as while drawing: 25 per second.

        Args:
            age: [s] of the first spot.
            since: [s] from the state's beginning to the first spot, instead of an age.
        """
        begin = self.entered + rospy.Duration(since) if since else rospy.Time.now() - rospy.Duration(age)
        known = self.counted()
        for number, (x, y) in enumerate(points):
            if number and number % AT_ONCE == 0:
                wait_until(lambda: self.counted() >= known + number, f"counting {number} spots")
            spot = LaserSpot(camera=camera, confidence=1.0)
            spot.header.frame_id = frame
            spot.header.stamp = begin + rospy.Duration(0.04 * number)
            spot.position.x, spot.position.y = x, y
            self.spots.publish(spot)

    def counted(self) -> int:
        """Returns how many spots the node has taken or ignored in this interaction."""
        return sum(seen.border_spots + seen.seed_spots + seen.ignored_spots for seen in self.progress.all[-1:])

    def wait_notice(self, code: str, what: str) -> None:
        self.notices.wait(lambda message: code in codes(message), what)

    def wait_untold(self, what: str) -> None:
        self.notices.wait(lambda message: not message.notices, what)

    def test_a_drawing_unknown_to_a_restarted_manager_is_reported_lost(self) -> None:
        self.enter(BORDER, "killed")
        self.show(square(20), since=0.01)
        self.progress.wait(lambda seen: seen.border_spots == 20, "the drawing")
        self.enter(DEFAULT, "")  # without an outcome, which no interaction's end lacks
        self.wait_notice("drawing_lost", "the loss to be told")
        self.enter(BORDER, "next")
        self.assertEqual(self.progress.message.border_spots, 0)
        self.wait_untold("the end of the notice")
        self.enter(DEFAULT, "", "cancelled")

    def test_interaction(self) -> None:
        self.show(square(20), age=5.0)  # of the state Default: ignored even if they arrive in the next state
        self.enter(BORDER, "one")
        self.assertEqual(self.progress.message.border_spots, 0)
        self.assertEqual(self.progress.message.code, "no_spots")
        self.show(square(200), "red", since=0.01)
        self.show(square(200), "green", since=0.02)
        seen = self.progress.wait(lambda seen: seen.border_spots == 400 and len(seen.chain) > 3, "the live chain")
        self.assertEqual(seen.code, "ok")
        self.assertTrue(seen.closed)
        self.assertEqual(set(seen.cameras), {"red", "green"})
        self.assertEqual(len(seen.points), len(seen.point_cameras))
        answer = self.drawn_border("one")
        self.assertFalse(answer.success)
        self.assertEqual(answer.code, "no_spots")
        # in the wrong frame: counted, not collected
        ignored = self.progress.message.ignored_spots
        self.show([(0, 0)], frame="odom")
        self.progress.wait(lambda seen: seen.ignored_spots > ignored, "counting the ignored spot")
        self.assertEqual(self.progress.message.border_spots, 400)
        self.enter(SEED, "one")
        self.show(np.random.default_rng(1).normal([0.5, 0.4], 0.01, (30, 2)))
        self.progress.wait(lambda seen: seen.seed_spots == 30 and seen.has_seed, "the seed")
        answer = self.drawn_border("one")
        self.assertTrue(answer.success, answer.message)
        self.assertEqual(answer.border.kind, VirtualBorder.POLYGON)
        self.assertAlmostEqual(answer.border.seed.x, 0.5, delta=0.03)
        self.assertAlmostEqual(answer.border.seed.y, 0.4, delta=0.03)
        vertices = np.array([(p.x, p.y) for p in answer.border.points])
        self.assertLess(np.abs(np.ptp(vertices, axis=0) - 1.0).max(), 0.06)
        self.assertEqual(self.drawn_border("another").code, "unknown_interaction")
        self.enter(DEFAULT, "", "saved")
        self.enter(BORDER, "two")
        self.assertEqual(self.progress.message.border_spots, 0)
        self.assertFalse(self.progress.message.chain)
        self.enter(DEFAULT, "", "cancelled")

    def next_told(self) -> set:
        """Returns the codes of a message of notices made after this call."""
        return codes(self.notices.next(2))  # the first may have been under way

    def test_doubts_are_reported_from_stroke_end_to_drawing_end(self) -> None:
        def draw_two() -> None:
            self.show(square(60), since=0.01)
            self.show(square(60) + [0.0, 4.0], since=5.0)

        self.enter(BORDER, "doubtful")
        draw_two()  # stamps up to 8 s ahead: the pointer counts as still seen
        self.progress.wait(lambda seen: seen.left_out_spots, "the spots that are left out")
        self.assertNotIn("strokes_left_out", self.next_told())
        self.enter(SEED, "doubtful")
        self.wait_notice("strokes_left_out", "the doubt in Seed")
        self.enter(DEFAULT, "", "saved")
        self.wait_untold("the end of the doubt")
        self.enter(BORDER, "ended", age=40.0)
        draw_two()  # half a minute ago
        self.wait_notice("strokes_left_out", "the doubt in Border")
        by_then = codes(self.notices.message)
        self.assertNotIn("drawing_lost", by_then, "by the manager's clock it began before the node was there")
        self.enter(DEFAULT, "", "cancelled")
        self.wait_untold("the end of the doubt")

    def test_a_drawing_begun_before_the_node_restarted_is_not_saved(self) -> None:
        # the manager's clock is ahead, as when a node has not received the simulated time yet
        self.enter(BORDER, "three", age=-30.0)
        self.show(square(150), since=0.01)
        self.progress.wait(lambda seen: (seen.interaction_id, seen.border_spots) == ("three", 150), "half the drawing")
        os.kill(process_of("/border_fusion"), signal.SIGKILL)
        self.wait_notice("drawing_lost", "the loss to be told")
        self.connected()
        self.enter(SEED, "three")
        self.show(np.random.default_rng(1).normal([0.5, 0.4], 0.01, (30, 2)))
        self.progress.wait(lambda seen: seen.seed_spots == 30, "the seed")
        self.assertEqual(self.drawn_border("three").code, "drawing_lost")
        self.assertIn("drawing_lost", self.next_told())
        self.enter(DEFAULT, "", "cancelled")
        self.wait_untold("the end of the notice")


if __name__ == "__main__":
    rospy.init_node("rostest_border_fusion")
    rostest.rosrun("vb_fusion", "border_fusion", BorderFusionTest)
