#!/usr/bin/env python3
"""buttons over a real roscore, with the interaction manager as a stub."""

from __future__ import annotations

import unittest

import rospy
import rostest
from sensor_msgs.msg import Joy

from vb_testing import assert_ends_with_one_line, wait_until

from vb_msgs.msg import InteractionState
from vb_msgs.srv import Command, CommandResponse


class ButtonsTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("rostest_buttons")
        cls.joy = rospy.Publisher("joy", Joy, queue_size=10)
        cls.state = rospy.Publisher("/virtual_borders/state", InteractionState, queue_size=1, latch=True)
        cls.commands = []
        cls.service = rospy.Service("/virtual_borders/command", Command, cls.on_command)
        wait_until(lambda: cls.joy.get_num_connections() and cls.state.get_num_connections(), "the node")

    @classmethod
    def on_command(cls, request):
        cls.commands.append((request.command, request.source))
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
