#!/usr/bin/env python3
"""The real voice node with spoken commands, from sound to the command service."""

import threading
import unittest

import rospy
import rostest

from vb_testing import Newest, Process, assert_fields, wait_until
from speech import RATE, pieces, say
from vb_msgs.msg import Audio, SpeechCommand, NoticeArray, Sound
from vb_msgs.srv import Command, CommandResponse


class VoiceCommandsTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("rostest_voice_commands")
        cls.requests = []
        cls.answer = CommandResponse(success=True, code="ok", message="Draw the border.")
        cls.hold = threading.Event()
        cls.hold.set()
        cls.service = rospy.Service("/virtual_borders/command", Command, cls.on_command)
        cls.audio = rospy.Publisher("/virtual_borders/voice/audio", Audio, queue_size=100)
        cls.sound = rospy.Publisher("/virtual_borders/sound", Sound, queue_size=10)
        cls.node = Process("vb_voice_wizard", "voice_commands", "_source:=topic")
        cls.addClassCleanup(cls.node.stop)
        cls.heard = Newest("/virtual_borders/voice/heard", SpeechCommand)
        cls.sounds = Newest("/virtual_borders/sound", Sound)
        wait_until(cls.audio.get_num_connections, "the node's ear")
        wait_until(cls.heard.subscriber.get_num_connections, "the node's report")
        # the subscribers are this process, which counts sounds, and the node
        wait_until(lambda: cls.sound.get_num_connections() > 1, "the node to hear its own sounds")

    @classmethod
    def on_command(cls, request):
        cls.requests.append(request)
        cls.hold.wait(60)
        return cls.answer

    def setUp(self):
        del self.requests[:]
        del self.heard.all[:]
        del self.sounds.all[:]

    def speak(self, text, seed=0):
        for piece in pieces(say(text, seed=seed)):
            self.audio.publish(piece)

    def give(self, text, understood=lambda: VoiceCommandsTest.requests):
        """Says a text, each time in new noise, until it is understood; the bench measures how often it is."""
        for seed in range(20):
            count = self.heard.count
            self.speak(text, seed)
            wait_until(lambda: understood() or self.heard.count > count, "what was made of it")  # noqa: B023
            if understood():
                return
        self.fail(f"{text} was not understood so: {self.heard.all}")

    def test_a_command_reaches_the_interaction(self):
        for broken in (Audio(sample_rate=0, data=b"ab"), Audio(sample_rate=RATE, data=b"abc")):
            self.audio.publish(broken)  # dropped
        self.give("define border")
        heard = self.heard.wait(lambda message: message.accepted, "the command")
        wait_until(lambda: "recognized" in [sound.name for sound in self.sounds.all], "the sound of a command")
        self.assertEqual([(request.command, request.source) for request in self.requests], [("define_border", "voice")])
        assert_fields(heard, command="define_border", reason="ok", success=True, code="ok")
        self.assertGreater(heard.confidence, 0.0)
        self.assertTrue(self.requests[0].id and self.requests[0].expires > rospy.Time.now())

    def test_a_slow_answer_does_not_make_it_deaf_and_anything_else_is_not_acted_on(self):
        self.hold.clear()
        self.addCleanup(self.hold.set)
        self.give("save")
        self.speak("has anyone seen my glasses")
        heard = self.heard.wait(lambda message: message.reason == "unlike_a_command", "a sentence meanwhile")
        self.assertFalse(heard.accepted or heard.success)
        self.hold.set()
        self.heard.wait(lambda message: message.command == "save" and message.success, "the late answer")
        self.assertEqual({request.command for request in self.requests}, {"save"})

    def test_beside_own_sounds_a_stop_counts_and_nothing_else(self):
        # our own sounds play all the time
        timer = rospy.Timer(rospy.Duration(0.1), lambda _event: self.sound.publish(Sound(name="success")))
        self.addCleanup(timer.shutdown)
        self.give("cancel", lambda: ("cancel", "muted") in [(said.command, said.reason) for said in self.heard.all])
        del self.requests[:]  # commands that came before the node heard of the sound
        obeyed = ("stop", True, True)
        self.give("stop", lambda: obeyed in [(said.command, said.accepted, said.success) for said in self.heard.all])
        self.assertEqual({request.command for request in self.requests}, {"stop"})

    def test_silence_is_reported(self):
        notices = Newest("/virtual_borders/notices", NoticeArray)
        notices.wait(lambda message: [n.code for n in message.notices] == ["microphone_silent"], "the silence")
        self.speak("define border")
        notices.wait(lambda message: "microphone_silent" not in [n.code for n in message.notices], "its end")

    def test_a_missing_microphone_is_reported(self):
        notices = Newest("/virtual_borders/notices", NoticeArray)
        node = Process("vb_voice_wizard", "voice_commands", "__name:=deaf", "_source:=microphone", "_device:=none_such")
        self.addCleanup(node.stop)
        missing = ("/deaf", "microphone_missing")
        wait_until(lambda: missing in [(m.source, n.code) for m in notices.all for n in m.notices], "the missing one")


if __name__ == "__main__":
    rostest.rosrun("vb_voice_wizard", "voice_commands", VoiceCommandsTest)
