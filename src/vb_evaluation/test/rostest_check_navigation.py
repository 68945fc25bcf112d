#!/usr/bin/env python3
"""The navigation check, run on a move_base that respects borders and on one left on the physical map."""

import shutil
import unittest

import rospy
import rostest
from nav_msgs.msg import OccupancyGrid

from vb_testing import wait_until
from vb_core import names
from vb_core.ros import node
from vb_evaluation.navigation_check.check_navigation import NavigationCheck
from vb_evaluation.system_observer import SystemObserver
from vb_msgs.srv import ListBorders

GOAL = (1.6, 1.6)


class NavigationCheckTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("test_navigation_check")
        cls.addClassCleanup(shutil.rmtree, rospy.get_param("~folder"), ignore_errors=True)
        node.wait_for_clock()
        # the command assumes that they exist, and that each move_base has its map: people run it beside a running system
        for service in (names.ADD_BORDER, names.LIST_BORDERS):
            rospy.wait_for_service(service, 120.0)
        rospy.wait_for_message(names.MAP_WITH_BORDERS, OccupancyGrid, 120.0)
        observer, near = SystemObserver(), (GOAL[0] + 0.1, GOAL[1], 0.0)
        for service in ("/move_base/make_plan", "/miswired/move_base/make_plan"):
            rospy.wait_for_service(service, 120.0)
            wait_until(lambda: len(observer.plan((*GOAL, 0.0), near, service)), f"a plan of {service}")

    def borders(self):
        rospy.wait_for_service(names.LIST_BORDERS, 60.0)
        return rospy.ServiceProxy(names.LIST_BORDERS, ListBorders)().borders.borders

    def test_a_good_navigation_passes_and_nothing_stays_behind(self):
        # the limits are generous, since only the command reports how fast it is, and this machine may be busy
        checks = NavigationCheck(GOAL, at_once=60.0, timeout=60.0).run()
        self.assertEqual([check for check in checks if check.passed is False], [])
        self.assertGreaterEqual(sum(check.passed is True for check in checks), 5)
        self.assertEqual(self.borders(), [])

    def test_navigation_that_plans_on_the_physical_map_fails_the_check(self):
        checks = NavigationCheck(GOAL, move_base="miswired/move_base", timeout=2.0).run()
        bad = {check.name for check in checks if check.passed is False}
        self.assertIn("plans respect a new border at once", bad)
        self.assertIn("a soft border is gone round where that is possible", bad)
        self.assertEqual(self.borders(), [])


if __name__ == "__main__":
    rostest.rosrun("vb_evaluation", "navigation_check", NavigationCheckTest)
