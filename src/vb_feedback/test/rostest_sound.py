#!/usr/bin/env python3
"""feedback; sound_player with a program that takes the samples and without a device; kobuki_feedback, no Kobuki."""

import importlib.util
import os
import tempfile
import unittest
from pathlib import Path
from shutil import which

import rospy
import rostest
from rosgraph_msgs.msg import Log
from std_msgs.msg import ColorRGBA

from vb_testing import Newest, Process, assert_ends_with_one_line, wait_until, write_program
from vb_feedback.sound.sound_output import synthesize
from vb_msgs.msg import InteractionState, LaserSpot, Sound


class SoundTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("rostest_sound")
        cls.logs = Newest("/rosout", Log)
        cls.sounds = rospy.Publisher("/virtual_borders/sound", Sound, queue_size=20)
        cls.folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls.folder.cleanup)
        folder = Path(cls.folder.name)
        deaf = f'echo tried >> {folder}/tried; exec {which("aplay")} "$@"'
        cls.nodes = []
        for name, aplay, *options in (
            ("hears", f"cat >> {folder}/pcm", "_volume:=1.0", "_max_age:=10.0"),
            ("deaf", deaf, "_device:=no_such_device"),
        ):
            (folder / name).mkdir()
            write_program(folder / name / "aplay", aplay)
            env = {**os.environ, "PATH": f"{folder / name}:{os.environ['PATH']}"}
            cls.nodes.append(Process("vb_feedback", "sound_player", f"__name:={name}", *options, env=env))
            cls.addClassCleanup(cls.nodes[-1].stop)
        wait_until(lambda: cls.sounds.get_num_connections() == 2, "both players")

    def written(self, name):
        path = Path(self.folder.name) / name
        return path.read_bytes() if path.exists() else b""

    def test_sounds_are_played_whole_and_in_order(self):
        names = ["border", "tick", "error"]
        for name in names:
            self.sounds.publish(name=name)
        # the tick may be skipped, but the order of the others is fixed
        wanted = tuple(b"".join(synthesize(name).tobytes() for name in played) for played in (names[::2], names))
        wait_until(lambda: self.written("pcm").endswith(wanted), "the samples of both sounds")

    def test_without_a_device_it_says_so_once(self):
        seed = Sound(name="seed")
        wait_until(lambda: self.sounds.publish(seed) or self.written("tried").count(b"tried") > 1, "two tries")
        # rospy logs warnings of its own under the node's name, for instance of a broken connection
        warnings = [log.msg for log in self.logs.all if log.name == "/deaf" and log.level >= Log.WARN]
        self.assertEqual(len([text for text in warnings if "there is no sound:" in text]), 1, warnings)
        self.assertIsNone(self.nodes[1].process.poll())

    def test_a_state_has_its_light_and_sound_and_a_spot_ticks(self):
        lights, sounds = Newest("/virtual_borders/led", ColorRGBA), Newest("/virtual_borders/sound", Sound)
        states = rospy.Publisher("/virtual_borders/state", InteractionState, queue_size=10)
        spots = rospy.Publisher("/virtual_borders/spots", LaserSpot, queue_size=10)
        wait_until(lambda: states.get_num_connections() and spots.get_num_connections(), "the node")
        wait_until(lambda: lights.subscriber.get_num_connections(), "its light")
        wait_until(lambda: sounds.subscriber.get_num_connections() == 2, "its sounds, beside those of this test")

        def tell(second, name, **more):
            states.publish(name=name, last_success=True, last_answered=rospy.Time(second), **more)
            wait_until(lambda: lights.count == second, f"the light of {name}")

        def played():
            return [sound.name for sound in sounds.all]

        tell(1, "default")
        tell(2, "border")
        for _ in range(5):
            spots.publish(LaserSpot(camera="red"))
        wait_until(lambda: "tick" in played(), "a tick")
        tell(3, "default", last_outcome="saved")
        # ticks come between the others, as many as the timing of the spots allows
        wait_until(lambda: [name for name in played() if name != "tick"] == ["border", "success"], played)
        self.assertNotEqual(lights.all[0], lights.all[1])
        self.assertEqual(lights.all[0], lights.all[2])
        # latched: a later subscriber gets the light too
        self.assertEqual(rospy.wait_for_message("/virtual_borders/led", ColorRGBA, 60), lights.all[2])

    def test_kobuki_without_its_messages_ends_with_one_sentence(self):
        if importlib.util.find_spec("kobuki_msgs") is not None:
            self.skipTest("kobuki_msgs is installed here")
        assert_ends_with_one_line("vb_feedback", "kobuki_feedback", [([], "kobuki_msgs is not installed")])


if __name__ == "__main__":
    rostest.rosrun("vb_feedback", "sound", SoundTest)
