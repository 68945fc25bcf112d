#!/usr/bin/env python3
"""The real node compares clocks with a real detector, a computer whose clock is wrong, and one that is away."""

import threading
import time
import unittest

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rosgraph_msgs.msg import Log

from vb_msgs.srv import GetTime, GetTimeResponse

TIMEOUT = 120.0


class ClockCheckTest(unittest.TestCase):
    def setUp(self):
        rospy.init_node("other")
        self.ahead, self.slow = 0.05, 0.0
        self.changed = threading.Condition()
        self.found, self.warned = {}, []
        rospy.Service("/other/get_time", GetTime, self.answer)
        rospy.Subscriber("/diagnostics", DiagnosticArray, self.on_diagnostics)
        rospy.Subscriber("/rosout", Log, self.on_log)

    def answer(self, _request):
        now = rospy.Time.from_sec(time.time() + self.ahead)
        time.sleep(self.slow)  # on its way back
        return GetTimeResponse(now, now)

    def on_diagnostics(self, message):
        with self.changed:
            for status in message.status:
                self.found[status.name.split(" ")[-1]] = status
            self.changed.notify_all()

    def on_log(self, message):
        with self.changed:
            if "[clocks_differ]" in message.msg:
                self.warned.append(message.msg)
            self.changed.notify_all()

    def wait(self, condition, what):
        with self.changed:
            self.assertTrue(
                self.changed.wait_for(condition, TIMEOUT), f"waited in vain for {what}: {self.found} {self.warned}"
            )

    def level(self, name):
        return self.found[name].level if name in self.found else None

    def offset(self, name):
        return float(next((value.value for value in self.found[name].values if value.key == "offset [ms]"), "nan"))

    def test_clocks(self):
        self.wait(
            lambda: self.level("other") == DiagnosticStatus.WARN and "ahead of" in self.found["other"].message,
            "a warning",
        )
        self.assertAlmostEqual(self.offset("other"), 50.0, delta=15.0)
        self.wait(lambda: self.level("spot_detector_red") == DiagnosticStatus.OK, "a clock that is right")
        self.assertLess(abs(self.offset("spot_detector_red")), 10.0)
        self.wait(lambda: "away" in self.found and "does not answer" in self.found["away"].message, "one that is away")
        self.wait(lambda: self.warned, "the log")
        # said once, until it changes
        self.assertEqual(len(self.warned), 1)
        # answers that take long say nothing: neither that the clock is right, nor again that it is wrong
        self.slow = 0.2
        self.wait(lambda: "takes too long" in self.found["other"].message, "answers that are too slow")
        self.slow = 0.0
        self.wait(lambda: "ahead of" in self.found["other"].message, "quick answers again")
        self.assertEqual(len(self.warned), 1)
        self.ahead = 0.0
        self.wait(lambda: self.level("other") == DiagnosticStatus.OK, "the clock that was set right")


if __name__ == "__main__":
    rostest.rosrun("vb_laser_detect", "clocks", ClockCheckTest)
