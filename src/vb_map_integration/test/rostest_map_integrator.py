#!/usr/bin/env python3
"""map_integrator, and borders imported from files, over a real roscore."""

import os
import shutil
import unittest
from pathlib import Path

import numpy as np
import rosnode
import rospy
import rosservice
import rostest
from geometry_msgs.msg import Point, TransformStamped
from tf2_ros import StaticTransformBroadcaster

from integrators import room
from vb_testing import Newest, run_command, wait_until
from vb_core.ros.messages import NumpyOccupancyGrid, message_from_grid
from vb_core.map_files import read_map
from vb_map_integration.border import VirtualBorder as Border, borders_to_geojson
from vb_msgs.msg import NoticeArray, VirtualBorder, VirtualBorderArray
from vb_msgs.srv import ConfirmMapRequest


def polygon(x=0.0, y=0.0, size=1.0, **fields):
    """Returns a square border that restricts its inside."""
    corners = [(x, y), (x + size, y), (x + size, y + size), (x, y + size)]
    return VirtualBorder(
        points=[Point(*corner, 0.0) for corner in corners],
        enabled=True,
        seed=Point(x + size / 2, y + size / 2, 0.0),
        **{"kind": VirtualBorder.POLYGON, "occupancy": 1.0, **fields},
    )


class MapIntegratorTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("rostest_map_integrator")
        cls.folder = rospy.get_param("~folder")
        cls.addClassCleanup(shutil.rmtree, cls.folder, ignore_errors=True)
        cls.maps = Newest("/virtual_borders/map", NumpyOccupancyGrid)
        cls.borders = Newest("/virtual_borders/borders", VirtualBorderArray)
        cls.notices = Newest("/virtual_borders/notices", NoticeArray)
        cls.grid = room(100, 160, (-4.0, -2.0, 0.0))
        cls.grid.data[60:70, 20:30] = -1
        early = cls.call("add_border", polygon(), "", "test")
        assert not early.success and early.code == "no_map", early
        cls.server = rospy.Publisher("/map", NumpyOccupancyGrid, queue_size=1, latch=True)
        cls.serve(cls.grid)
        transform = TransformStamped()
        transform.header.frame_id, transform.child_frame_id = "map", "base_link"
        transform.transform.translation.x, transform.transform.translation.y = -2.0, -1.0
        transform.transform.rotation.w = 1.0
        cls.broadcaster = StaticTransformBroadcaster()
        cls.broadcaster.sendTransform(transform)
        assert cls.borders.message
        assert (cls.cells() == cls.grid.data).all()

    @classmethod
    def serve(cls, grid):
        cls.server.publish(message_from_grid(grid, rospy.Time.now()))

    @classmethod
    def call(cls, name, *arguments):
        """Waits for a service and calls it with the first fields of its request."""
        service = f"/virtual_borders/{name}"
        rospy.wait_for_service(service, 120.0)
        kind = rosservice.get_service_class_by_name(service)
        return rospy.ServiceProxy(service, kind)(**dict(zip(kind._request_class.__slots__, arguments)))

    @classmethod
    def cells(cls):
        message = cls.maps.message
        return np.asarray(message.data).reshape(message.info.height, message.info.width)

    def setUp(self):
        for border in self.call("list_borders").borders.borders:
            self.call("remove_border", border.id)
        # an older map may also be without borders: only the stamp shows that this is the newest one
        revision = self.call("list_borders").borders.revision
        wait_until(
            lambda: self.borders.message.revision == revision
            and self.maps.message.header.stamp == self.borders.message.header.stamp,
            "the map that goes with the empty list of borders",
        )
        self.assertTrue((self.cells() == self.grid.data).all())

    def restricted(self):
        return int((self.cells() != self.grid.data).sum())

    def test_add_update_remove_undo_redo_clear(self):
        added = self.call("add_border", polygon(), "map", "test")
        self.assertTrue(added.success, added.message)
        wait_until(lambda: self.restricted() == 400, "400 restricted cells")
        info = self.maps.message.info
        self.assertEqual((info.width, info.height, round(info.resolution, 6)), (160, 100, 0.05))
        self.assertEqual(self.maps.message.header.frame_id, "map")
        wait_until(lambda: [b.id for b in self.borders.message.borders] == [added.id], "the border in the list")
        border = self.borders.message.borders[0]
        self.assertAlmostEqual(border.area_m2, 1.0, places=3)
        self.assertEqual(self.borders.message.header.stamp, self.maps.message.header.stamp)

        changed = polygon(size=2.0, id=added.id)
        self.assertTrue(self.call("update_border", changed, "", "test").success)
        wait_until(lambda: self.restricted() == 1600, "the larger border")
        self.assertTrue(self.call("undo").success)
        wait_until(lambda: self.restricted() == 400, "the smaller border again")
        for _ in range(2):  # a repeated request is carried out once
            self.assertTrue(self.call("undo_redo", True, "again").success)
        wait_until(lambda: self.restricted() == 1600, "the larger border again")
        self.assertTrue(self.call("remove_border", added.id).success)
        wait_until(lambda: self.restricted() == 0, "no border")
        self.assertFalse(self.call("redo").success)
        self.assertEqual(self.call("remove_border", added.id).code, "unknown_border")
        self.assertEqual(self.call("list_borders").borders.borders, [])

    def test_refusals_are_coded_and_change_nothing(self):
        count, revision = self.maps.count, self.call("list_borders").borders.revision
        for code, border, frame in (
            ("bad_points", VirtualBorder(kind=VirtualBorder.POLYGON, points=[Point(float("nan"), 0.0, 0.0)] * 3), ""),
            ("unknown_frame", polygon(id="b1"), "odom"),
            ("bad_kind", polygon(kind=9), ""),
        ):
            for answer in (self.call("update_border", border, frame), self.call("preview_border", border, frame)):
                self.assertEqual((answer.success, answer.code), (False, code))
                self.assertTrue(answer.message and answer.issues[-1].code == code)
        self.assertEqual(self.maps.count, count)
        self.assertEqual(self.call("list_borders").borders.revision, revision)

    def test_warnings_for_the_robot_and_for_soft_borders(self):
        # repeatedly, since the transform may still be under way
        def codes():
            return [issue.code for issue in self.call("preview_border", polygon(x=-2.5, y=-1.5), "").issues]

        wait_until(lambda: "robot_inside" in codes(), "the warning that the robot is inside")
        answer = self.call("add_border", polygon(occupancy=0.75), "", "test")
        self.assertTrue(answer.success)
        self.assertEqual([f.code for f in answer.issues], ["soft_border_ignored"])
        wait_until(lambda: (self.cells() == 75).sum() == 400, "soft cells")

    def test_repeated_requests_and_changes_meanwhile(self):
        first, again = (self.call("add_border", polygon(), "", "test", "once") for _ in range(2))
        self.assertEqual((first.success, again.success, again.id), (True, True, first.id))
        self.assertEqual(len(self.call("list_borders").borders.borders), 1)
        self.assertEqual(self.call("rename_border", first.id, "rug", "test", first.revision).code, "ok")
        late = self.call("set_border_enabled", first.id, False, "test", first.revision)
        self.assertEqual((late.success, late.code), (False, "revision_conflict"))
        self.assertEqual(self.call("set_border_enabled", first.id, False, "test", late.revision).code, "ok")
        wait_until(lambda: self.borders.message.borders[0].reason == "disabled", "the border that sleeps")
        border = self.borders.message.borders[0]
        self.assertEqual((border.name, border.in_force), ("rug", False))
        robots = self.call("add_border", polygon(robots=["nobody"]), "", "test")
        self.assertEqual((robots.code, robots.values[0].value), ("unknown_robot", "nobody"))

    def test_walls_and_slow_zones(self):
        limits = Newest("/virtual_borders/speed_limits", NumpyOccupancyGrid)
        slow = polygon(zone=VirtualBorder.SLOW, max_speed=0.25)
        self.assertEqual(self.call("add_border", slow, "", "test").code, "ok")
        wait_until(lambda: (np.asarray(limits.message.data) == 25).sum() == 400, "limits")
        self.assertEqual(self.restricted(), 0)
        ends = [Point(-1.0, -1.0, 0.0), Point(-1.0, 1.0, 0.0)]
        wall = VirtualBorder(points=ends, kind=VirtualBorder.VIRTUAL_WALL, occupancy=1.0)
        self.assertEqual(self.call("add_border", wall, "", "test").code, "ok")
        wait_until(lambda: 40 <= self.restricted() <= 130, "a thin band")
        wait_until(lambda: [b.kind for b in self.borders.message.borders][1:] == [wall.kind], "the wall")
        self.assertTrue(all(border.in_force for border in self.borders.message.borders))

    def test_a_map_that_may_be_another_place(self):
        self.call("add_border", polygon(name="carpet"), "", "test")
        wait_until(lambda: self.restricted() == 400, "400 restricted cells")
        other = self.grid.with_data(self.grid.data.copy())
        other.data[30:32, 20:120] = 100
        try:
            self.serve(other)
            wait_until(lambda: self.borders.message.needs_confirmation, "the doubt")
            self.assertEqual(self.borders.message.code, "borders_unconfirmed")
            self.assertEqual((self.cells()[45:55, 85:95] == 100).all(), True)  # still in force
            wait_until(lambda: "borders_unconfirmed" in [n.code for n in self.notices.message.notices], "the notice")
            self.assertEqual(self.call("add_border", polygon(x=2.0), "", "test").code, "confirm_map_first")
            self.assertEqual(self.call("confirm_map", ConfirmMapRequest.OTHER_PLACE, "upstairs", "test").code, "ok")
            wait_until(lambda: not self.borders.message.needs_confirmation, "no doubt")
            self.assertEqual((self.borders.message.borders, self.borders.message.map_name), ([], "upstairs"))
        finally:
            self.serve(self.grid)
        wait_until(lambda: [b.name for b in self.borders.message.borders] == ["carpet"], "the first place's border")
        self.assertFalse(self.borders.message.needs_confirmation)

    def test_why_a_map_is_refused_is_reported_until_one_is_accepted(self):
        for code, frame, cells in (("map_wrong_frame", "odom", 16000), ("bad_map", "map", 3)):
            message = message_from_grid(self.grid, rospy.Time.now(), frame)
            message.data = message.data[:cells]
            self.server.publish(message)
            wait_until(lambda: [n.code for n in self.notices.message.notices] == [code], code)
        self.serve(self.grid)
        wait_until(lambda: self.notices.message.notices == [], "no notice")

    def import_borders(self, source):
        done = run_command("rosrun", "vb_map_integration", "import_borders", source, timeout=240)
        return done.returncode, done.stdout

    def test_saved_maps_and_borders_from_files(self):
        source = Path(self.folder) / "in.geojson"
        rug = Border([(0, 0), (1, 0), (1, 1), (0, 1)], (0.5, 0.5), occupancy=0.75, closed=True, name="rug")
        far = Border([(60, 0), (60, 1)], (0, 0), closed=False, name="far")
        source.write_text(borders_to_geojson([rug, far]))
        status, output = self.import_borders(source)
        self.assertEqual(status, 1, output)
        for words in ("rug: added as b", "far: refused", "error [outside_map]", "1 of 2 added"):
            self.assertIn(words, output)
        wait_until(lambda: (self.cells() == 75).sum() == self.restricted() == 400, "the map with a soft border")
        answer = self.call("save_map", "soft", True)
        self.assertTrue(answer.success, answer.message)
        self.assertTrue(all(os.path.isfile(path) for path in answer.files) and len(answer.files) == 3)
        self.assertTrue((read_map(Path(answer.files[1])).data == self.cells()).all())
        # an exported border that was edited is added to the other one, and stays switched off
        edited = Path(answer.files[-1]).read_text().replace('"rug"', '"carpet"')
        source.write_text(edited.replace('"enabled": true', '"enabled": false'))
        status, output = self.import_borders(source)
        self.assertEqual(status, 0, output)
        borders = self.call("list_borders").borders.borders
        self.assertEqual([(border.name, border.in_force) for border in borders], [("rug", True), ("carpet", False)])
        source.write_text('{"type": "FeatureCollection", "features": 3}')
        status, output = self.import_borders(source)
        self.assertEqual(status, 2)
        self.assertIn("bad_border_file", output)
        self.assertNotIn("Traceback", output)

    def test_the_nodes_end_costs_no_border(self):
        """Otherwise borders whose addition was acknowledged are gone after a restart."""
        for name, x in (("carpet", 0.0), ("rug", 2.0)):
            self.assertEqual(self.call("add_border", polygon(x=x, name=name), "", "test").code, "ok")
        wait_until(lambda: self.restricted() == 800, "two borders")
        count = self.maps.count
        rosnode.kill_nodes(["/map_integrator"])
        wait_until(lambda: self.maps.count > count, "a map from the node that came back")
        wait_until(lambda: self.restricted() == 800, "the borders that came back")
        self.assertEqual([border.name for border in self.call("list_borders").borders.borders], ["carpet", "rug"])


if __name__ == "__main__":
    rostest.rosrun("vb_map_integration", "map_integrator", MapIntegratorTest)
