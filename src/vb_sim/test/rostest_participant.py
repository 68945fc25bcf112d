#!/usr/bin/env python3
"""The participant's node against a scripted system: it answers commands and sees every spot."""

import json
import threading
import time
import unittest

import numpy as np
import rospy
import rostest
from geometry_msgs.msg import Point, Pose2D
from std_msgs.msg import String

from vb_testing import Newest, assert_ends_with_one_line

from vb_core import names
from vb_msgs.msg import BorderProgress, InteractionState, LabState, LaserSpot, ParticipantState
from vb_msgs.srv import Command, CommandResponse

STATES = {
    "define_border": "border",
    "define_seed": "seed",
    "guide_robot": "guide",
    "cancel": "default",
    "save": "default",
}
SPEED = 2.0  # seconds of the lab per second of wall time, so that the test is over sooner


class ScriptedSystem:
    """Lab, cameras and interaction manager in one."""

    def __init__(self):
        self.commands, self.spots = [], {"border": [], "seed": []}
        self.state = "default"
        self.refuse = []
        self.now = 1000.0
        self._lock = threading.Lock()
        self._lab = rospy.Publisher(names.LAB_STATE, LabState, queue_size=1)
        self._spot = rospy.Publisher(names.SPOTS, LaserSpot, queue_size=10)
        self._progress = rospy.Publisher(names.PROGRESS, BorderProgress, queue_size=1)
        self._state = rospy.Publisher(names.STATE, InteractionState, queue_size=1, latch=True)
        self._publish_state()
        rospy.Service(names.COMMAND, Command, self._on_command)
        rospy.Subscriber(names.PARTICIPANT, ParticipantState, self._on_participant, queue_size=5)
        threading.Thread(target=self._run, daemon=True).start()

    def _publish_state(self):
        self._state.publish(InteractionState(name=self.state))

    def _on_command(self, request):
        with self._lock:
            self.commands.append((request.command, request.source))
            if request.command == "save" and self.refuse:
                code = self.refuse.pop(0)
                return CommandResponse(success=False, code=code, message=code)
            self.state = STATES[request.command]
            if request.command in ("cancel", "save"):
                self.drawn, self.spots = self.spots, {"border": [], "seed": []}
        self._publish_state()
        return CommandResponse(success=True, code="ok", message="")

    def _on_participant(self, message):
        if not message.laser_on or self.state == "default":
            return
        spot = LaserSpot(camera="red", position=Point(message.laser.x, message.laser.y, 0.0))
        spot.header.stamp, spot.header.frame_id = message.header.stamp, "map"
        with self._lock:
            self.spots.setdefault(self.state, []).append((message.laser.x, message.laser.y))
            seed = len(self.spots["seed"]) > 3
        self._spot.publish(spot)
        self._progress.publish(BorderProgress(has_seed=seed))

    def _run(self):
        while not rospy.is_shutdown():
            state = LabState(robots=[""], robot_poses=[Pose2D(7.6, 0.4, 2.6)])
            state.header.stamp = rospy.Time.from_sec(self.now)
            self._lab.publish(state)
            self.now += 0.02
            time.sleep(0.02 / SPEED)


class ParticipantTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("test_participant")
        cls.system = ScriptedSystem()
        cls.system.refuse = ["no_seed"]
        cls.done = Newest(names.PARTICIPANT_DONE, String)
        cls.person = Newest(names.PARTICIPANT, ParticipantState)

    def test_it_draws_shows_the_seed_and_saves(self):
        report = json.loads(self.done.message.data)
        self.assertEqual((report["outcome"], report["scenario"], report["method"]), ("saved", "room", "nrs"))
        self.assertGreater(report["ended"], report["started"])
        commands = [command for command, _ in self.system.commands]
        self.assertEqual(commands, ["define_border", "define_seed", "save", "define_seed", "save"])
        border, seed = (np.array(self.system.drawn[key]) for key in ("border", "seed"))
        self.assertLess(np.abs(border[:, 0] - 3.2).max(), 0.1)
        self.assertLess(border[:, 1].min(), 3.28)
        self.assertGreater(border[:, 1].max(), 3.78)
        self.assertLess(np.linalg.norm(seed.mean(axis=0) - (2.3, 3.6)), 0.05)
        self.assertTrue(all(message.person_present for message in self.person.all))

    def test_bad_parameters_end_with_one_line(self):
        world = rospy.get_param("/participant/world")
        cases = [
            (["_scenario:=room"], "/world"),
            ([f"_world:={world}"], "/scenario"),
            ([f"_world:={world}", "_scenario:=attic"], "attic"),
            ([f"_world:={world}", "_scenario:=room", "_method:=magic"], "/method"),
        ]
        assert_ends_with_one_line("vb_sim", "participant", cases)


if __name__ == "__main__":
    rostest.rosrun("vb_sim", "participant", ParticipantTest)
