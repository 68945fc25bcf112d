"""The loop in which a camera node takes its images and reports its progress."""
from __future__ import annotations

import time
from typing import Callable

import rospy

from vb_core.ros import node
from vb_sim.cameras.frame_clock import FrameSchedule, SmoothClock

_REPORT_S = 1.0


def run_cameras(
    schedule: FrameSchedule,
    clock: SmoothClock,
    running: Callable[[], bool],
    publish: Callable[[int, float], None],
    report: Callable[[float], None],
) -> None:
    """Publishes each image when it is due, until the node ends.

    Args:
        running: whether to go on.
        publish: takes and sends one image: index of the camera in the schedule, stamp [s].
        report: says how the cameras get on, once a second: time [s].
    """
    node.wait_for_clock()
    report_at = 0.0
    while running() and not rospy.is_shutdown():
        now = clock.now()
        try:
            for index, stamp in schedule.due(now):
                publish(index, stamp)
            # on a steady clock: the counts matter most when simulated time is in trouble
            if time.monotonic() >= report_at:
                report_at = time.monotonic() + _REPORT_S
                report(now)
        except rospy.ROSException:
            # the topics close during shutdown
            return
        # simulated time may run slower than the wall's: look again at least every few milliseconds
        time.sleep(min(max(schedule.wait(clock.now()), 0.001), 0.02))
