#!/usr/bin/env python3
"""Lets the simulated laser spot draw a circle on the lab's floor, 0.4 m/s, without a person."""

import math

import rospy

from vb_core import names
from vb_msgs.msg import LabState

rospy.init_node("draw_circle")
publisher = rospy.Publisher(names.LAB_STATE, LabState, queue_size=1)
rate = rospy.Rate(50)
while not rospy.is_shutdown():
    state = LabState(laser_on=True, laser_color="red")
    state.header.stamp, state.header.frame_id = rospy.Time.now(), names.MAP_FRAME
    angle = 0.8 * state.header.stamp.to_sec()
    state.laser.x, state.laser.y = 4.1 + 0.5 * math.cos(angle), 1.4 + 0.5 * math.sin(angle)
    publisher.publish(state)
    try:
        rate.sleep()
    except rospy.ROSInterruptException:
        break
