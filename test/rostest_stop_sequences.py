#!/usr/bin/env python3
"""Stops and resumes from five sources in any order, with slow services and killed nodes, over the real nodes.

At the end of each sequence, the robot must stand if an acknowledged stop is newer than every resume. One more
resume, by somebody who looks at the state, must then let it drive again.
"""

import os
import random
import tempfile
import threading
import time
import unittest

import rospy
import rostest

from neighbors import StubNeighbors
from vb_testing import Newest, Process, wait_until
from vb_core import names
from vb_core.errors import CodedError
from vb_core.ros import commands
from vb_core.stop_latch import new_id
from vb_msgs.msg import DriverState, InteractionState, Stop

SEQUENCES = int(os.environ.get("SEQUENCES", "3"))
FIRST = int(os.environ.get("FIRST_SEQUENCE", "0"))
STEPS = 12
# what may happen in a step, and how often relative to the rest
ACTIONS = {"stop": 4, "resume": 4, "define_border": 1, "define_seed": 1, "save": 2, "guide_robot": 1, "kill": 0.6}
FOLDER = tempfile.mkdtemp(prefix="vb_stops_")


class StopSequences(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("stop_sequences")
        cls.neighbors = StubNeighbors()
        cls.neighbors.offer()
        cls.state = Newest(names.STATE, InteractionState)
        cls.driver = Newest(names.DRIVERS, DriverState)
        cls.topic = rospy.Publisher(names.STOP, Stop, queue_size=10)
        files = f"_stop_file:={FOLDER}/manager.json", f"_log_file:={FOLDER}/l"
        cls.manager = Process("vb_interaction", "interaction_manager", "__name:=interaction_manager", *files)
        cls.robot = Process("vb_robot", "robot_driver", "__name:=robot_driver", f"_stop_file:={FOLDER}/robot.json")
        for process in (cls.manager, cls.robot):
            cls.addClassCleanup(process.stop)
        cls.answers = []
        cls.lock = threading.Lock()
        cls.people = [commands.CommandSender(f"person {number}", cls.on_answer) for number in range(3)]
        rospy.wait_for_service(names.COMMAND, 120)
        # a person reacts to what the page shows, so it needs a first state
        assert cls.state.message
        assert cls.driver.message

    @classmethod
    def on_answer(cls, request, context, answer, error):
        with cls.lock:
            cls.answers.append((request.command, context, (answer or error).code))

    def press_page(self, command, at):
        """Sends a command as the page does: from a thread of its own, with the stop that the person saw."""
        request = commands.make_request(command, "page", 30.0, seen_stop=self.state.message.stop_number)
        if command == "stop":
            self.topic.publish(Stop(id=request.id, source="page"))

        def send():
            try:
                answer = commands.send(request)
                self.on_answer(request, at, answer, None)
            except CodedError as error:
                self.on_answer(request, at, None, error)

        threading.Thread(target=send, daemon=True).start()

    def test_a_robot_answers_a_stop_where_no_manager_does(self):
        self.manager.stop()
        for there, code in ((True, "stop_held"), (False, "stop_unconfirmed")):
            if not there:
                self.robot.stop()
            self.answers.clear()
            self.people[0].submit("stop")
            wait_until(lambda: self.answers, "an answer")
            self.assertEqual([answer[-1] for answer in self.answers], [code])
        for process in (self.manager, self.robot):
            process.start()
        wait_until(lambda: self.state.message.stopped, "the manager to know of the stop")
        wait_until(self.resume, "a robot that may drive")

    def test_no_stop_is_lost_or_released_by_an_older_command(self):
        released = judged = 0
        for seed in range(FIRST, FIRST + SEQUENCES):
            print(f"sequence {seed}")  # rosunit swallows a subTest's failures
            obeyed, newest = self.run_sequence(random.Random(seed))
            released += obeyed
            judged += newest
        print(f"{SEQUENCES} sequences; a resume was obeyed in {released}, a stop came last in {judged} of them")

    def run_sequence(self, choice):
        """Returns whether a resume was obeyed, and whether a stop was newer than every resume."""
        self.answers.clear()
        resumes, given = [], 0
        pauses = random.Random(choice.random())  # own generator: another thread draws from it
        self.neighbors.before["add"] = lambda: time.sleep(pauses.choice([0.0, 0.3, 2.0]))
        for _ in range(STEPS):
            at = time.monotonic()
            (action,) = choice.choices(list(ACTIONS), ACTIONS.values())
            if action == "kill":
                process = choice.choice((self.manager, self.robot))
                process.kill()
                process.start()
                continue
            if action == "resume":
                resumes.append(at)
            person = choice.randrange(5)
            if person < 3:
                given += self.people[person].submit(action, at)
            elif person == 3 or action != "stop":
                self.press_page(action, at)
                given += 1
            else:
                self.topic.publish(Stop(id=new_id(), source="a red button"))
            time.sleep(choice.choice([0.0, 0.05, 0.2, 0.5]))
        wait_until(lambda: len(self.answers) >= given, "all answers")
        rospy.wait_for_service(names.COMMAND, 120)
        # by now both must have exchanged their current state
        for messages in (self.state, self.driver):
            messages.next(4)
        codes = ("stopped", "stop_released")
        stops = [at for command, at, code in self.answers if command == "stop" and code in codes]
        is_stop_newest = bool(stops) and max(stops) > max(resumes, default=0.0)
        if is_stop_newest:
            self.assertTrue(self.state.message.stopped, "the newest stop is lost, or was released by an older resume")
            self.assertEqual(self.driver.message.source, "stop")
        obeyed = ("resume", "resumed") in [(command, code) for command, _, code in self.answers]
        wait_until(self.resume, "a resume by somebody who looks")
        self.press_page("cancel", time.monotonic())
        for messages in (self.state, self.driver):
            del messages.all[:-5]
        return obeyed, is_stop_newest

    def resume(self):
        """Gives a resume as somebody who looks at the state. Returns whether robots may drive."""
        self.press_page("resume", time.monotonic())
        time.sleep(0.3)
        return not self.state.message.stopped and not self.driver.message.stops


if __name__ == "__main__":
    rostest.rosrun("vb_bringup", "stop_sequences", StopSequences)
