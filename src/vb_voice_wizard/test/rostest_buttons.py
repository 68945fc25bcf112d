#!/usr/bin/env python3
"""buttons over a real roscore, with the interaction manager as a stub."""

from __future__ import annotations

import unittest

import rospy
import rostest
from sensor_msgs.msg import Joy

from vb_testing import assert_ends_with_one_line, wait_until

from vb_msgs.msg import InteractionState, Stop
from vb_msgs.srv import Command, CommandResponse


class ButtonsTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("rostest_buttons")
        cls.joy = rospy.Publisher("joy", Joy, queue_size=10)
        cls.state = rospy.Publisher("/virtual_borders/state", InteractionState, queue_size=1, latch=True)
        cls.commands, cls.requests = [], []
        cls.service = rospy.Service("/virtual_borders/command", Command, cls.on_command)
        wait_until(lambda: cls.joy.get_num_connections() and cls.state.get_num_connections(), "the node")

    @classmethod
    def on_command(cls, request):
        cls.commands.append((request.command, request.source))
        cls.requests.append(request)
        return CommandResponse(success=True, code="ok", message="Ok.")

    def press(self, button):
        buttons = [int(index == button) for index in range(12)]
        for _ in range(3):
            self.joy.publish(buttons=buttons)
        self.joy.publish(buttons=[0] * 12)

    def test_presses_become_commands_once(self):
        del self.commands[:]
        for button in (0, 11, 3):  # number 11 means nothing
            self.press(button)
        wait_until(lambda: len(self.commands) >= 2, f"two commands, got {self.commands}")
        self.assertEqual(self.commands, [("define_border", "buttons"), ("save", "buttons")])

    def test_each_press_is_a_command_of_its_own_that_expires(self):
        del self.requests[:]
        for button in (5, 6):
            self.press(button)
        wait_until(lambda: len(self.requests) == 2, "stop and resume")
        # stop waits for nothing: which of the two comes first is open
        self.assertEqual({request.command for request in self.requests}, {"stop", "resume"})
        self.assertEqual(len({request.id for request in self.requests}), 2)
        for request in self.requests:
            self.assertTrue(request.id and request.expires > rospy.Time.now())

    def test_each_press_names_the_newest_stop_and_robots_hear_a_stop_directly(self):
        heard = []
        robot = rospy.Subscriber("/virtual_borders/stop", Stop, heard.append)
        wait_until(robot.get_num_connections, "the node's stops")
        self.state.publish(InteractionState(name="default", stop_number="seventh"))

        def press_and_look():
            del self.requests[:]
            self.press(6)
            wait_until(lambda: self.requests, "a command")
            return self.requests[0].seen_stop == "seventh"

        wait_until(press_and_look, "a resume that names the stop")
        del self.requests[:]
        self.press(5)
        wait_until(lambda: heard and self.requests, "the stop")
        self.assertEqual((heard[0].id, heard[0].source), (self.requests[0].id, "buttons"))

    def test_the_state_gives_a_button_its_meaning(self):
        self.state.publish(InteractionState(name="border"))

        def press_and_look():
            del self.commands[:]
            self.press(0)
            wait_until(lambda: self.commands, "a command")
            return self.commands[0][0] == "define_seed"

        wait_until(press_and_look, "the meaning in the border state")
        self.state.publish(InteractionState(name="default"))

    def test_a_bad_mapping_is_one_line(self):
        assert_ends_with_one_line("vb_voice_wizard", "buttons", [(["_mapping:={dance: 1}"], "dance")])


if __name__ == "__main__":
    rostest.rosrun("vb_voice_wizard", "buttons", ButtonsTest)
