#!/usr/bin/env python3
"""feedback over a real roscore."""

from __future__ import annotations

import unittest

import rospy
import rostest
from std_msgs.msg import ColorRGBA

from vb_testing import wait_until
from vb_msgs.msg import InteractionState, LaserSpot, Sound


class FeedbackTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("rostest_feedback")
        cls.lights, cls.sounds = [], []
        cls.subscribers = [
            rospy.Subscriber("/virtual_borders/led", ColorRGBA, cls.lights.append),
            rospy.Subscriber("/virtual_borders/sound", Sound, lambda sound: cls.sounds.append(sound.name)),
        ]
        cls.state = rospy.Publisher("/virtual_borders/state", InteractionState, queue_size=10)
        cls.spots = rospy.Publisher("/virtual_borders/spots", LaserSpot, queue_size=10)
        wait_until(lambda: cls.state.get_num_connections() and cls.spots.get_num_connections(), "the node")
        wait_until(lambda: all(subscriber.get_num_connections() for subscriber in cls.subscribers), "its topics")

    def publish_state(self, second, **values):
        usual = {"last_success": True, "last_answered": rospy.Time(second)}
        self.state.publish(InteractionState(**{**usual, **values}))

    def expect_tones(self, *expected):
        """Ticks come beside them, as often as spots are heard apart."""
        wait_until(
            lambda: [sound for sound in self.sounds if sound != "tick"] == list(expected),
            lambda: f"{expected}, got {self.sounds}",
        )

    def test_light_and_sound_of_an_interaction(self):
        self.publish_state(1, name="default")
        wait_until(lambda: len(self.lights) == 1, "the light of the default state")
        self.publish_state(2, name="border")
        self.expect_tones("border")
        wait_until(lambda: len(self.lights) == 2, "another light")
        self.assertNotEqual(self.lights[0], self.lights[1])
        for _ in range(5):
            self.spots.publish(LaserSpot(camera="red"))
        wait_until(lambda: "tick" in self.sounds, "a tick")
        self.publish_state(3, name="border", last_success=False)
        self.publish_state(3, name="border", last_success=False)
        self.publish_state(4, name="border", last_success=False)
        self.publish_state(5, name="default", last_outcome="saved")
        self.expect_tones("border", "error", "error", "success")
        wait_until(lambda: len(self.lights) == 3, "the light of the default state again")
        self.assertEqual(self.lights[2], self.lights[0])
        # latched: who comes later sees the light too
        late = rospy.wait_for_message("/virtual_borders/led", ColorRGBA, 60)
        self.assertEqual(late, self.lights[2])


if __name__ == "__main__":
    rostest.rosrun("vb_feedback", "feedback", FeedbackTest)
