#!/usr/bin/env python3
"""check_lab in a newcomer's lab: real nodes report its faults, and check_lab names every mistake."""

import json
import unittest

import psutil
import rosnode
import rospy
import rostest
from rosgraph_msgs.msg import Log
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header
from vb_testing import assert_fields, process_of, run_command, wait_until
from vb_core import names
from vb_core.ros.notices import NoticeListener
from vb_msgs.msg import VirtualBorder, VirtualBorderArray


class CheckLab(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("check_lab")
        cls.images = rospy.Publisher("/north/image_raw", Image, queue_size=1)
        cls.infos = rospy.Publisher("/north/camera_info", CameraInfo, queue_size=1)
        cls.borders = rospy.Publisher(names.BORDERS, VirtualBorderArray, queue_size=1, latch=True)
        waiting = VirtualBorder(name="wall 1", enabled=True, reason="inactive_on_this_map")
        cls.borders.publish(borders=[VirtualBorder(name="desk", enabled=True, in_force=True), waiting])
        cls.notices = NoticeListener()
        cls.logged = []
        rospy.Subscriber("/rosout", Log, lambda message: cls.logged.append((message.name, message.msg)), queue_size=100)
        cls.timer = rospy.Timer(rospy.Duration(0.1), cls.play)

    @classmethod
    def play(cls, _event):
        """Plays an uncalibrated camera of 10 images/s."""
        header = Header(stamp=rospy.Time.now(), frame_id="head_camera")
        cls.images.publish(Image(header=header, height=48, width=64, encoding="mono8", step=64, data=bytes(48 * 64)))
        cls.infos.publish(CameraInfo(height=48, width=64))

    def reported(self):
        return {(notice.code, notice.camera) for notice in self.notices.current()}

    def test_each_fault_is_reported_by_its_node_and_printed(self):
        expected = {("camera_not_calibrated", camera) for camera in ("north", "south")}
        expected |= {("camera_no_lens", "north"), ("detector_missing", "south")}
        wait_until(lambda: expected <= self.reported(), lambda: f"a notice that is not in {self.reported()}")
        command = ("rosrun", "vb_bringup", "check_lab", "--seconds", "2", "--json", "--language", "de")
        done = run_command(*command, stderr=None, timeout=300)
        self.assertEqual(done.returncode, 1)
        lines = {(line["code"], line["camera"]): line for line in json.loads(done.stdout)}
        self.assertLessEqual({*expected, ("lab_node_missing", ""), ("lab_map_without_borders", "")}, set(lines))
        self.assertNotIn(("camera_silent", "north"), lines)
        self.assertIn("1 von 2", lines["lab_borders_ok", ""]["message"])
        line = lines["camera_not_calibrated", "south"]
        assert_fields(line, state="error", robot="")
        self.assertEqual(line["values"]["camera"], "south")
        # the nodes logged their faults, with the codes
        for node, code in (("/camera_poses", "detector_missing"), ("/spot_detectors", "camera_no_lens")):
            wait_until(lambda: any(who == node and f"[{code}]" in text for who, text in self.logged), f"{node}: {code}")

    def test_nothing_listens_beyond_this_machine(self):
        nodes = rosnode.get_node_names()
        for name in nodes:
            pid = process_of(name)
            self.assertTrue(pid, name)
            connections = psutil.Process(pid).net_connections("tcp4")
            addresses = [socket.laddr for socket in connections if socket.status == psutil.CONN_LISTEN]
            self.assertEqual([address for address in addresses if not address.ip.startswith("127.")], [], name)
        self.assertGreaterEqual(len(nodes), 4)


if __name__ == "__main__":
    rostest.rosrun("vb_bringup", "check_lab", CheckLab)
