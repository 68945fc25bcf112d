#!/usr/bin/env python3
"""sound_player with a program that takes the samples, one without a sound device, and kobuki_feedback without Kobuki."""

from __future__ import annotations

import importlib.util
import tempfile
import unittest
from pathlib import Path

import rospy
import rostest
from rosgraph_msgs.msg import Log

from vb_testing import Process, assert_ends_with_one_line, wait_until
from vb_feedback.sound.tone_synthesis import synthesize
from vb_msgs.msg import Sound


class SoundPlayerTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("rostest_sound_player")
        cls.said = []
        cls.log = rospy.Subscriber("/rosout", Log, lambda log: cls.said.append((log.name, log.level, log.msg)))
        cls.sounds = rospy.Publisher("/virtual_borders/sound", Sound, queue_size=20)
        cls.folder = tempfile.TemporaryDirectory()
        hears = cls.program("hears", f"cat >> {cls.folder.name}/pcm")
        deaf = cls.program("deaf", f'echo tried >> {cls.folder.name}/tried; exec aplay "$@"')
        cls.nodes = [
            Process("vb_feedback", "sound_player", f"__name:={name}", *more)
            for name, more in (
                ("hears", [f"_program:={hears}", "_volume:=1.0", "_max_age:=10.0"]),
                ("deaf", [f"_program:={deaf}", "_device:=no_such_device"]),
            )
        ]
        wait_until(lambda: cls.sounds.get_num_connections() == 2, "both players")

    @classmethod
    def program(cls, name, text):
        path = Path(cls.folder.name) / name
        path.write_text(f"#!/bin/sh\n{text}\n")
        path.chmod(0o755)
        return path

    def written(self, name):
        path = Path(self.folder.name) / name
        return path.read_bytes() if path.exists() else b""

    @classmethod
    def tearDownClass(cls):
        for node in cls.nodes:
            node.stop()
        cls.folder.cleanup()

    def test_1_sounds_are_played_whole_and_in_order(self):
        names = ["border", "tick", "error"]
        for name in names:
            self.sounds.publish(name=name)
        # the tick may have to give way, and which of the two played first is not a matter of luck
        wanted = [b"".join(synthesize(name).tobytes() for name in played) for played in (names[::2], names)]
        wait_until(lambda: self.written("pcm") in wanted, "the samples of both sounds")

    def test_2_without_a_device_it_says_so_once(self):
        def try_again():
            self.sounds.publish(name="seed")
            return self.written("tried").count(b"tried") >= 2

        wait_until(try_again, "the device to be tried twice")
        # rospy itself warns in a node's name, for instance of a connection that broke off
        said = [text for name, level, text in self.said if name == "/deaf" and level >= Log.WARN]
        said = [text for text in said if "there is no sound:" in text]
        self.assertEqual(len(said), 1, said)
        self.assertIsNone(self.nodes[1].process.poll())

    def test_3_kobuki_without_its_messages_ends_with_one_sentence(self):
        if importlib.util.find_spec("kobuki_msgs") is not None:
            self.skipTest("kobuki_msgs is installed here")
        assert_ends_with_one_line("vb_feedback", "kobuki_feedback", [([], "kobuki_msgs is not installed")])


if __name__ == "__main__":
    rostest.rosrun("vb_feedback", "sound_player", SoundPlayerTest)
