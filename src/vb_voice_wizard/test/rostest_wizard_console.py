#!/usr/bin/env python3
"""The wizard console in a pseudo-terminal: a whole interaction, and what it says when others go away."""

from __future__ import annotations

import tempfile
import unittest

import rospy
import rostest

from neighbors import StubNeighbors
from vb_testing import Newest, Process, assert_ends_with_one_line

from terminal import Terminal

from vb_msgs.msg import BorderProgress, InteractionState

FOLDER = tempfile.mkdtemp(prefix="vb_console_")


class WizardConsoleTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("rostest_wizard_console")
        cls.stub = StubNeighbors()
        cls.stub.offer()
        cls.state = Newest("/virtual_borders/state", InteractionState)
        cls.progress = rospy.Publisher("/virtual_borders/progress", BorderProgress, queue_size=1, latch=True)
        cls.manager = Process(
            "vb_voice_wizard",
            "interaction_manager",
            "__name:=interaction_manager",
            f"_log_file:={FOLDER}/log",
            f"_stop_file:={FOLDER}/stop",
        )
        # one console for all that does not need another one: starting it is most of a test's time
        cls.terminal = Terminal()
        cls.terminal.shows("READY")

    @classmethod
    def tearDownClass(cls):
        cls.manager.stop()

    def test_an_interaction_by_keys_while_the_manager_dies_and_comes_back(self):
        terminal = self.terminal
        terminal.press("s")
        terminal.shows("nothing to save")
        terminal.press("b")
        drawing = self.state.wait(lambda message: message.name == "border", "the border state")
        self.assertEqual(drawing.last_source, "wizard")
        self.progress.publish(
            interaction_id=drawing.interaction_id, border_spots=321, cameras_seeing_spot=["red"], code="ok"
        )
        terminal.shows("321 border")
        seen = len(terminal.text)  # it waited when it started, too
        self.manager.kill()
        terminal.shows("waiting for the interaction manager", seen)
        seen = len(terminal.text)
        self.manager.start()
        terminal.shows("READY", seen)
        for key, name in (("b", "border"), ("d", "seed")):
            terminal.press(key)
            self.state.wait(lambda message, name=name: message.name == name, f"the state {name}")
        terminal.press("z")
        terminal.press("\x1b[a")
        terminal.press("s")
        self.state.wait(lambda message: message.last_outcome == "saved", "the saved border")
        self.assertEqual(self.stub.added[-1].source, "wizard")
        terminal.shows("Saved")
        terminal.press("u")
        terminal.shows("Removed from the map: Nursery")
        terminal.press(" ")
        terminal.shows("STOPPED")
        self.state.wait(lambda message: message.stopped and message.stopped_by == "wizard", "the stop")
        terminal.press("p")
        self.state.wait(lambda message: not message.stopped, "the end of the stop")
        self.assertEqual(self.stub.undone, 1)
        self.assertNotIn("Traceback", terminal.text)
        self.assertEqual(terminal.leave(), (0, True))

    def test_without_a_terminal(self):
        assert_ends_with_one_line("vb_voice_wizard", "wizard_console", [([], "needs a terminal")])


if __name__ == "__main__":
    rostest.rosrun("vb_voice_wizard", "wizard_console", WizardConsoleTest)
