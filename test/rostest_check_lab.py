#!/usr/bin/env python3
"""check_lab and lab_monitor beside a newcomer's lab: real topics, and every mistake in it is named."""

import itertools
import json
import os
import subprocess
import unittest
import xmlrpc.client
from pathlib import Path

import rosgraph
import rosnode
import rospy
import rostest
from vb_testing import wait_until
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rosgraph_msgs.msg import Log
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import CameraInfo, Image
from tf2_msgs.msg import TFMessage

from vb_core import names
from vb_core.notices import Notice, Severity
from vb_core.ros.messages import mapping_from_values
from vb_core.ros.notices import NoticePublisher
from vb_msgs.msg import DetectorStatus, LaserSpot, NoticeArray, VirtualBorder, VirtualBorderArray


def listening_beyond_loopback(pid):
    """Finds (address, port) of a process's listening IPv4 sockets that other computers reach."""
    own = set()
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        try:
            own.add(os.readlink(str(descriptor)))
        except OSError:
            continue  # closed meanwhile
    found = []
    for line in Path(f"/proc/{pid}/net/tcp").read_text().splitlines()[1:]:
        fields = line.split()
        address, port = fields[1].split(":")
        listens = fields[3] == "0A"
        if listens and f"socket:[{fields[9]}]" in own and not address.endswith("7F"):
            found.append((address, int(port, 16)))
    return found


class CheckLab(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("check_lab")
        cls.images = rospy.Publisher("/north/image_raw", Image, queue_size=1)
        cls.infos = rospy.Publisher("/north/camera_info", CameraInfo, queue_size=1)
        cls.borders = rospy.Publisher(names.BORDERS, VirtualBorderArray, queue_size=1, latch=True)
        waiting = VirtualBorder(name="wall 1", enabled=True, schedule="mon-sun 18:00-22:00", reason="off_schedule")
        unfit = VirtualBorder(name="rug", enabled=True, reason="inactive_on_this_map")
        cls.borders.publish(borders=[VirtualBorder(name="desk", enabled=True, in_force=True), waiting, unfit])
        cls.told, cls.diagnosed, cls.logged = set(), set(), []
        rospy.Subscriber(names.NOTICES, NoticeArray, cls.on_notices, queue_size=10)
        rospy.Subscriber("/diagnostics", DiagnosticArray, cls.on_diagnostics, queue_size=10)
        rospy.Subscriber("/rosout", Log, cls.on_log, queue_size=100)
        cls.timer = rospy.Timer(rospy.Duration(0.1), cls.play)

    @classmethod
    def on_notices(cls, message):
        if message.source != "/lab_monitor":
            return
        cls.told = {(notice.code, notice.camera) for notice in message.notices}

    @classmethod
    def on_diagnostics(cls, message):
        cls.diagnosed.update(
            [(one.name, mapping_from_values(one.values).get("code"), one.level) for one in message.status]
        )

    @classmethod
    def on_log(cls, message):
        if message.name == "/lab_monitor":
            cls.logged.append(message.msg)

    @classmethod
    def play(cls, _event):
        """Plays a camera of 10 images/s that nobody calibrated."""
        image = Image(height=48, width=64, encoding="mono8", step=64, data=bytes(48 * 64))
        image.header.stamp, image.header.frame_id = rospy.Time.now(), "head_camera"
        cls.images.publish(image)
        cls.infos.publish(CameraInfo(height=48, width=64))

    def check(self, *arguments):
        done = subprocess.run(
            ["rosrun", "vb_bringup", "check_lab", "--seconds", "2", *arguments],
            stdout=subprocess.PIPE,
            universal_newlines=True,
            timeout=300,
        )
        return done.returncode, done.stdout

    def test_each_fault_is_a_line_for_programs(self):
        status, text = self.check("--json")
        self.assertEqual(status, 1)
        lines = {(line["subject"], line["code"]) for line in json.loads(text)}
        self.assertLessEqual(
            {
                ("camera north", "lab_camera_not_calibrated"),
                ("camera north", "lab_camera_no_pose"),
                ("camera south", "lab_camera_no_detector"),
                ("nodes", "lab_node_missing"),
                ("map", "lab_map_without_borders"),
            },
            lines,
        )
        self.assertNotIn(("camera north", "lab_camera_silent"), lines)

    def test_only_a_border_that_cannot_be_in_force_is_a_warning(self):
        _, text = self.check("--json")
        found = {line["code"]: line for line in json.loads(text) if line["subject"] == "borders"}
        self.assertEqual(
            {code: line["state"] for code, line in found.items()},
            {"lab_borders_ok": "ok", "lab_borders_off_schedule": "ok", "lab_borders_not_in_force": "warning"},
        )
        self.assertIn("1 of 3", found["lab_borders_ok"]["message"])
        self.assertIn("Wall 1", found["lab_borders_off_schedule"]["message"])
        self.assertIn("rug", found["lab_borders_not_in_force"]["message"])

    def test_the_running_lab_repeats_nothing_about_borders_that_may_have_changed(self):
        camera = ("lab: camera north", "lab_camera_not_calibrated", DiagnosticStatus.ERROR)
        self.wait(lambda: camera in self.diagnosed)  # all lines of a check come in one message
        self.assertNotIn("lab: borders", {name for name, _, _ in self.diagnosed})

    def test_people_read_what_cures_it(self):
        status, text = self.check("--language", "de")
        self.assertEqual(status, 1)
        self.assertIn("calibrate_camera spots", " ".join(text.split()))

    def test_nothing_listens_beyond_this_machine(self):
        nodes = 0
        for name in rosnode.get_node_names():
            uri = rosgraph.Master("/check_lab").lookupNode(name)
            nodes += 1
            self.assertEqual(
                listening_beyond_loopback(xmlrpc.client.ServerProxy(uri).getPid("/check_lab")[2]), [], name
            )
        self.assertGreaterEqual(nodes, 4)

    def wait(self, arrived):
        wait_until(arrived, lambda: f"what is not in {self.told} and {self.diagnosed}")

    def test_a_camera_that_should_be_there_is_reported_to_people(self):
        self.wait(lambda: ("detector_missing", "south") in self.told)

    def test_what_another_node_tells_people_is_in_the_result_and_in_the_terminal(self):
        notices = NoticePublisher()
        try:
            notices.set(
                [
                    Notice("page_full_of_rain", Severity.ERROR),
                    Notice("strokes_left_out", Severity.WARNING, values={"spots": "4711"}),
                ]
            )
            status, text = self.check("--json")
            self.assertEqual(status, 1)
            found = {line["code"]: (line["state"], line["from_notice"]) for line in json.loads(text)}
            self.assertEqual(found["strokes_left_out"], ("warning", True))
            self.assertEqual(found["page_full_of_rain"], ("error", True))
            self.assertEqual(found["lab_camera_no_detector"], ("error", False))
            self.wait(lambda: any("4711" in text for text in self.logged))
        finally:
            notices.close()

    def test_cameras_that_disagree_are_reported_until_one_of_them_has_another_pose(self):
        spots = rospy.Publisher(names.SPOTS, LaserSpot, queue_size=10)
        states = rospy.Publisher(names.DETECTORS, DetectorStatus, queue_size=10)
        poses = rospy.Publisher("/tf_static", TFMessage, queue_size=1)
        told = lambda: "cameras_disagree" in {code for code, _ in self.told}  # noqa: E731

        def repeat(each, arrived):
            """Does `each` ten times a second until something has arrived."""
            steps = itertools.count()
            timer = rospy.Timer(rospy.Duration(0.1), lambda _event: each(next(steps)))
            self.wait(arrived)
            timer.shutdown()
            timer.join()

        def draw(step):
            for camera, off in (("east", 0.0), ("west", 0.1)):
                states.publish(camera=camera, frame_id=f"{camera}_frame", received=step)
                spot = LaserSpot(camera=camera)
                spot.header.stamp = rospy.Time.now()
                spot.position.x, spot.position.y = 0.01 * step + off, 1.0
                spots.publish(spot)

        def move(step):
            pose = TransformStamped(child_frame_id="west_frame")
            pose.transform.translation.x = 0.1 * (step % 2)
            poses.publish(TFMessage([pose]))

        repeat(draw, told)
        repeat(move, lambda: not told())

    def test_the_running_lab_says_by_itself_what_is_wrong(self):
        self.wait(lambda: ("lab_camera_not_calibrated", "north") in self.told)
        self.wait(lambda: ("lab: camera north", "lab_camera_not_calibrated", DiagnosticStatus.ERROR) in self.diagnosed)
        self.wait(lambda: ("lab: nodes", "lab_node_missing", DiagnosticStatus.ERROR) in self.diagnosed)


if __name__ == "__main__":
    rostest.rosrun("vb_bringup", "check_lab", CheckLab)
