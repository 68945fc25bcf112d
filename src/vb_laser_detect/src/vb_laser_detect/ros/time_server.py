"""Serves this computer's clock to nodes that compare clocks."""
from __future__ import annotations

import time

import rospy

from vb_msgs.srv import GetTime, GetTimeRequest, GetTimeResponse


class TimeServer:
    """Services:
    ~get_time (vb_msgs/GetTime): this computer's clock, whatever ROS time is
    """

    def __init__(self) -> None:
        self._service = rospy.Service("~get_time", GetTime, self._answer)

    def _answer(self, _request: GetTimeRequest) -> GetTimeResponse:
        received = rospy.Time.from_sec(time.time())
        return GetTimeResponse(received, rospy.Time.from_sec(time.time()))
