#!/usr/bin/env python3
"""The wizard console in a pseudo-terminal: a whole interaction, and what it says when others go away."""
from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import unittest

import rospy
import rostest

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from ros_helpers import Newest, Process, StubNeighbours  # noqa: E402
from terminal import Terminal  # noqa: E402

from std_srvs.srv import Trigger, TriggerResponse  # noqa: E402
from vb_msgs.msg import BorderProgress, InteractionState, VirtualBorder, VirtualBorderArray  # noqa: E402

FOLDER = tempfile.mkdtemp(prefix="vb_console_")


class WizardConsoleTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("rostest_wizard_console")
        cls.stub = StubNeighbours()
        cls.stub.offer()
        cls.undone = []
        cls.undo = rospy.Service("/virtual_borders/undo", Trigger, cls.on_undo)
        cls.state = Newest("/virtual_borders/state", InteractionState)
        cls.progress = rospy.Publisher("/virtual_borders/progress", BorderProgress, queue_size=1, latch=True)
        cls.borders = rospy.Publisher("/virtual_borders/borders", VirtualBorderArray, queue_size=1, latch=True)
        cls.manager = Process(
            "interaction_manager", "__name:=interaction_manager",
            f"_log_file:={FOLDER}/log", f"_state_file:={FOLDER}/state",
        )

    @classmethod
    def tearDownClass(cls):
        cls.manager.stop()

    @classmethod
    def on_undo(cls, _request):
        cls.undone.append(True)
        return TriggerResponse(True, "Undone: Nursery is gone.")

    def test_an_interaction_by_keys_while_the_manager_dies_and_comes_back(self):
        terminal = Terminal()
        terminal.shows("DEFAULT")
        self.borders.publish(borders=[VirtualBorder(id="b0", name="Nursery", area_m2=8.0, enabled=True)])
        terminal.shows("Nursery")
        terminal.press("s")
        terminal.shows("nothing to save")
        terminal.press("b")
        drawing = self.state.wait(lambda message: message.name == "border", "the border state")
        self.assertEqual(drawing.last_source, "wizard")
        self.progress.publish(
            interaction_id=drawing.interaction_id, border_spots=321, seeing=["red"], cameras=["red", "robot"], code="ok"
        )
        terminal.shows("321 border")
        terminal.shows("red, robot")
        self.manager.kill()
        terminal.shows("interaction manager is away")
        self.manager.start()
        terminal.shows("interaction manager is there")
        terminal.press("d")
        self.state.wait(lambda message: message.name == "seed", "the seed state")
        terminal.press("x")
        terminal.shows("'x' means nothing")
        terminal.press("\x1b[A")
        terminal.press("s")
        self.state.wait(lambda message: message.last_outcome == "saved", "the saved border")
        self.assertEqual(self.stub.added[-1].source, "wizard")
        terminal.shows("Saved")
        terminal.press("u")
        terminal.shows("Nursery is gone")
        self.assertTrue(self.undone)
        self.assertNotIn("Traceback", terminal.text)
        self.assertEqual(terminal.leave(), (0, True))

    def test_the_master_may_come_late_and_be_restarted(self):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        environment = {"ROS_MASTER_URI": f"http://127.0.0.1:{port}"}
        terminal = Terminal(environment)
        terminal.shows("waiting for the ROS master")

        def master():
            # the master alone: it is up in a moment
            return subprocess.Popen(["rosmaster", "--core", "-p", str(port)], stdout=subprocess.DEVNULL,
                                    stderr=subprocess.DEVNULL, env={**os.environ, **environment})

        first = master()
        terminal.shows("connected to the ROS master")
        terminal.shows("waiting for the interaction manager")
        first.kill()
        first.wait()
        terminal.shows("master is away")
        second = master()
        terminal.shows("the ROS master was restarted: connected again")
        seen = len(terminal.text)
        terminal.shows("waiting for the interaction manager", seen - 3000 if seen > 3000 else 0)
        self.assertNotIn("Traceback", terminal.text)
        self.assertEqual(terminal.leave(), (0, True))
        second.kill()
        second.wait()

    def test_without_a_terminal(self):
        found = subprocess.run(["rosrun", "vb_voice_wizard", "wizard_console"], stdin=subprocess.DEVNULL,
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE, universal_newlines=True, timeout=90)
        self.assertEqual(found.returncode, 1)
        self.assertIn("needs a terminal", found.stderr)
        self.assertNotIn("Traceback", found.stderr)


if __name__ == "__main__":
    rostest.rosrun("vb_voice_wizard", "wizard_console", WizardConsoleTest)
