#!/usr/bin/env python3
"""What people see, over a real roscore: display_markers, RViz, and floor_projector with its calibration by clicks."""

import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import numpy as np
import rospy
import rostest
import yaml
from geometry_msgs.msg import Point, PointStamped
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from vb_testing import TOP, Newest, Process, assert_ends_with_one_line, run_command, wait_until, write_program
from vb_core import sentences
from vb_core.grid_map import GridMap
from vb_core.ros.images import array_from_image
from vb_core.ros.messages import NumpyBorderPreview, NumpyOccupancyGrid, message_from_grid
from vb_core.notices import Notice, Severity
from vb_core.ros.notices import message_from_notice
from vb_feedback.display.layout import Rectangle, fit_view
from vb_feedback.display.restriction_overlay import PREVIEW
from vb_feedback.projector import projector_calibration
from vb_feedback.projector.projector_calibration import markers
from vb_msgs.msg import BorderIssue, BorderProgress, InteractionState, LaserSpot, NoticeArray
from vb_msgs.msg import VirtualBorder, VirtualBorderArray
from visualization_msgs.msg import Marker, MarkerArray

SIZE = (320, 200)
# the projected picture covers 3.2 m x 2.0 m of the map, axis-aligned, its lower left corner at (1, 1)
SCALE = 100.0


def floor_of(column, row):
    return 1.0 + column / SCALE, 1.0 + (SIZE[1] - 1 - row) / SCALE


class Screen:
    """Stands in for RViz: applies each marker message."""

    def __init__(self):
        self.markers = {}
        self.subscriber = rospy.Subscriber("/virtual_borders/markers", MarkerArray, self.take, queue_size=100)

    def take(self, message):
        markers = dict(self.markers)  # a copy, so that a test in another thread never sees half a message
        for marker in message.markers:
            if marker.action == Marker.DELETEALL:
                markers.clear()
            elif marker.action == Marker.DELETE:
                markers.pop((marker.ns, marker.id), None)
            else:
                markers[marker.ns, marker.id] = marker
        self.markers = markers

    def text_of(self, namespace):
        words = sorted((number, marker.text) for (ns, number), marker in self.markers.items() if ns == namespace)
        return " ".join(word for _, word in words)

    def has(self, namespace):
        return [marker for key, marker in self.markers.items() if key[0] == namespace]


class DisplayTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("rostest_display")
        latched = {"queue_size": 1, "latch": True}
        cls.map = rospy.Publisher("/map", NumpyOccupancyGrid, **latched)
        cls.map_with_borders = rospy.Publisher("/virtual_borders/map", NumpyOccupancyGrid, **latched)
        cls.state = rospy.Publisher("/virtual_borders/state", InteractionState, **latched)
        cls.progress = rospy.Publisher("/virtual_borders/progress", BorderProgress, **latched)
        cls.borders = rospy.Publisher("/virtual_borders/borders", VirtualBorderArray, **latched)
        cls.preview = rospy.Publisher("/virtual_borders/preview", NumpyBorderPreview, **latched)
        cls.notices = rospy.Publisher("/virtual_borders/notices", NoticeArray, **latched)
        cls.spots = rospy.Publisher("/virtual_borders/spots", LaserSpot, queue_size=10)
        cls.overlays = Newest("/virtual_borders/display/restricted", NumpyOccupancyGrid)
        cls.pictures = Newest("/virtual_borders/projector", Image)
        cls.screen = Screen()
        cls.folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls.folder.cleanup)
        cells = np.zeros((100, 160), np.int8)
        cells[0] = 100
        cls.grid = GridMap(cells, 0.05, (-2.0, 1.0, 0.0))
        cls.map.publish(message_from_grid(cls.grid, rospy.Time.now()))

    def map_of(self, cells, rows, columns):
        """Returns a map of these cells with a rectangle of occupied ones: slices of rows and columns."""
        cells = cells.copy()
        cells[rows, columns] = 100
        return message_from_grid(self.grid.with_data(cells), rospy.Time.now())

    def publish_state(self, **changes):
        usual = {"name": "default", "available_commands": ["define_border"], "last_success": True}
        self.state.publish(InteractionState(**{**usual, **changes}))

    def test_words_follow_the_state(self):
        self.publish_state()
        wait_until(lambda: self.screen.text_of("words/state") == "Ready", "the default state's title")
        refused = {"last_message": "The map integrator does not answer; say save again.", "last_success": False}
        available = {"available_commands": ["save", "cancel"]}
        self.publish_state(name="seed", interaction_id="i", border_s=70.0, **available, **refused)
        wait_until(lambda: self.screen.text_of("words/state") == "Seed", "the seed state's title")
        self.assertEqual([self.screen.text_of(f"words/say/{number}") for number in range(3)], ["save", "cancel", ""])
        self.assertEqual(self.screen.text_of("words/elapsed"), "1:10")
        self.assertIn("say save again", self.screen.text_of("words/answer"))
        self.publish_state(name="seed", interaction_id="i", stopped=True, last_code="stopped", last_message="Not read.")
        wait_until(lambda: self.screen.text_of("words/state") == "Stopped", "the stop")
        wait_until(lambda: self.screen.text_of("words/answer").startswith("Stopped: no robot"), "the code's sentence")

    def test_a_drawing_belongs_to_its_interaction(self):
        self.publish_state(name="border", interaction_id="i7")
        drawn = BorderProgress(interaction_id="i7", cameras=["red", "robot"], cameras_seeing_spot=["robot"])
        drawn.points = [Point(0, 2, 0), Point(1, 2, 0)]
        drawn.point_cameras = bytes([0, 1])
        drawn.chain = [*drawn.points, Point(1, 3, 0)]
        drawn.has_seed = True
        drawn.seed = Point(0.5, 2.5, 0)
        self.progress.publish(drawn)
        wait_until(lambda: self.screen.has("drawing/chain"), "the chain")
        points = self.screen.has("drawing/points")[0]
        self.assertEqual(len(points.points), 2)
        self.assertNotEqual(points.colors[0], points.colors[1])
        self.assertEqual(len(self.screen.has("drawing/seed")), 3)
        self.assertEqual(self.screen.text_of("words/seen/0"), "robot")
        self.publish_state()
        wait_until(lambda: not self.screen.has("drawing/chain"), "the end of the chain")
        self.assertFalse(self.screen.has("drawing/points") or self.screen.has("drawing/seed"))

    def test_a_border_has_outline_and_label_while_it_is_stored(self):
        border = VirtualBorder(name="T\u00fcr", kind=VirtualBorder.POLYGON, occupancy=1.0, enabled=True, area_m2=1.0)
        border.points = [Point(0, 2, 0), Point(2, 2, 0), Point(2, 3, 0)]
        border.seed = Point(1.5, 2.2, 0)
        self.borders.publish(borders=[border])
        wait_until(lambda: self.screen.text_of("borders/label/0") == "T\u00fcr 1.00 m\u00b2", "its label")
        self.assertEqual(len(self.screen.has("borders/outline")[0].points), 6)
        self.borders.publish(borders=[])
        wait_until(lambda: not self.screen.has("borders/outline"), "the end of the border")

    def test_only_the_restricted_area_is_striped(self):
        self.map_with_borders.publish(self.map_of(self.grid.data, slice(20, 40), slice(40, 80)))
        overlay = self.overlays.wait(lambda overlay: np.any(overlay.data), "stripes")
        rows, columns = np.nonzero(np.reshape(overlay.data, (100, 160)))
        self.assertEqual((rows.min(), rows.max(), columns.min(), columns.max()), (20, 39, 40, 79))

    def test_a_preview_belongs_to_its_interaction(self):
        self.map_with_borders.publish(message_from_grid(self.grid, rospy.Time.now()))
        self.publish_state(name="seed", interaction_id="i8", available_commands=["save"], last_message="Point.")
        preview = NumpyBorderPreview(interaction_id="i8", available=True, success=True, area_m2=2.0)
        preview.issues = [BorderIssue(severity=BorderIssue.WARNING, message="it parts the room")]
        preview.region = self.map_of(np.zeros_like(self.grid.data), slice(50, 70), slice(20, 60))
        self.preview.publish(preview)

        def orange():
            return np.argwhere(np.reshape(self.overlays.message.data, (100, 160)) == PREVIEW).tolist()

        rows, columns = np.transpose(wait_until(orange, "the region to restrict"))
        self.assertEqual((rows.min(), rows.max(), columns.min(), columns.max()), (50, 69, 20, 59))
        wait_until(lambda: self.screen.text_of("words/notice/1") == "Saving would restrict 2.00 m\u00b2.", "its size")
        self.assertEqual(self.screen.text_of("words/notice/2"), "Note: it parts the room")
        # a code that is in no catalogue: the notice's own sentence is shown, whatever its words
        inside = Notice("robot_where_it_should_not_be", Severity.WARNING, message="A robot: Carpet!")
        warning = NoticeArray(source="/monitor", notices=[message_from_notice(inside)])
        first = "words/notice/1"
        wait_until(lambda: self.notices.publish(warning) or self.screen.text_of(first) == inside.message, "the warning")
        self.assertTrue(self.screen.has("words/notice/1/plate"))
        self.notices.publish(source="/monitor", notices=[])
        wait_until(lambda: self.screen.text_of(first).startswith("Saving would"), "the robot to leave")
        self.publish_state(last_message="Saved.", last_outcome="saved")
        wait_until(lambda: not orange() and not self.screen.has("words/notice/2"), "the end of the preview")

    def test_spots_come_and_fade(self):
        self.publish_state(name="border", interaction_id="i")
        wait_until(lambda: self.spots.get_num_connections(), "the subscriber")

        def point():
            # repeatedly, as from a camera: on a busy machine a single spot may expire before it is drawn
            for camera, x in (("red", 1.0), ("blue", float("nan"))):
                self.spots.publish(header=Header(stamp=rospy.Time.now()), camera=camera, position=Point(x, 2.0, 0.0))
            return self.screen.has("spots/red")

        discs = wait_until(point, "the spot")
        self.assertEqual(discs[0].pose.position.x, 1.0)
        self.assertEqual(discs[0].type, Marker.CYLINDER)
        self.assertGreater(discs[0].lifetime.to_sec(), 0.0)
        wait_until(lambda: not self.screen.has("spots/red"), "its end")
        self.assertFalse(self.screen.has("spots/blue"))

    def test_rviz_is_fitted_to_the_map(self):
        config = TOP / "rviz" / "smart_display.rviz"
        with tempfile.TemporaryDirectory() as folder:
            write_program(Path(folder) / "rviz", f'shift\ncp "$2" {folder}/config; echo "$@" > {folder}/arguments')
            # a screen that is switched on after the start: the first check finds none
            write_program(Path(folder) / "xdpyinfo", f"test -e {folder}/on || {{ touch {folder}/on; exit 1; }}")
            display = "rosrun vb_feedback smart_display __name:=display _screen:=1280x720".split()
            environment = {**os.environ, "PATH": f"{folder}:{os.environ['PATH']}", "DISPLAY": ":0"}
            run = run_command(*display, f"_config:={config}", env=environment, timeout=120)
            self.assertEqual(run.returncode, 0, run.stdout)
            self.assertIn(sentences.translate("no_screen"), run.stdout)
            view = yaml.safe_load((Path(folder) / "config").read_text())["Visualization Manager"]["Views"]["Current"]
            self.assertIn("__name:=display", (Path(folder) / "arguments").read_text())
        layout = fit_view(Rectangle.from_points(self.grid.corners()), 16 / 9)
        self.assertAlmostEqual(view["Scale"], 1280 / layout.view.width, 1)
        self.assertAlmostEqual(view["X"], layout.view.center[0], 2)

    def test_without_rviz_it_stays_and_names_the_page(self):
        with tempfile.TemporaryDirectory() as folder:
            node = subprocess.Popen(
                [sys.executable, str(TOP / "src/vb_feedback/scripts/smart_display"), "__name:=bare"],
                env={**os.environ, "PATH": folder},
            )
            self.addCleanup(node.wait, 120)
            self.addCleanup(node.terminate)
            wait_until(lambda: rospy.get_param("/bare/lacking", "") == "no_rviz", "the code that check_lab reads")
            self.assertIsNone(node.poll(), "a required node that ends would end the whole lab")
        self.assertIn("8420", sentences.translate("no_rviz"))

    def test_a_newcomer_gets_everything(self):
        self.publish_state(name="guide", interaction_id="i", available_commands=["cancel"])
        wait_until(lambda: self.screen.text_of("words/state") == "Guide", "the guide state's title")
        # two subscribers in one process share a connection, and only a new connection gets the latched messages
        self.screen.subscriber.unregister()
        newcomer = type(self).screen = Screen()
        wait_until(lambda: newcomer.text_of("words/state") == "Guide" and newcomer.has("robot/body"), "everything")
        robot = newcomer.has("robot/body")[0]
        self.assertEqual(robot.header.frame_id, "base_link")
        self.assertTrue(robot.frame_locked)
        self.assertEqual(newcomer.text_of("words/say/0"), "cancel")

    # ------------------------------------------------------------- the projector
    def shown(self):
        return array_from_image(self.pictures.message)

    def at(self, x, y):
        row = round(SIZE[1] - 1 - (y - 1.0) * SCALE)
        column = round((x - 1.0) * SCALE)
        return self.shown()[row, column].astype(int).max()

    def test_four_clicks_on_markers_calibrate_a_projector(self):
        self.publish_state()
        output = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        file = Path(self.folder.name) / "new" / "clicked.yaml"
        size = (f"_width:={SIZE[0]}", f"_height:={SIZE[1]}")
        node = Process("vb_feedback", "floor_projector", f"_calibration:={file}", *size, **output)
        clicks = rospy.Publisher("/clicked_point", PointStamped, queue_size=5)
        wait_until(clicks.get_num_connections, "the node")
        places = markers(*SIZE)

        def bright(number):
            column, row = np.rint(places[number]).astype(int)
            return self.shown()[row, column].max() == 255

        def click(x, y, frame="map"):
            clicks.publish(Header(frame_id=frame), Point(x, y, 0.0))

        click(0.0, 0.0, "odom")  # in another frame: its marker stays
        # after four clicks on one line, the markers come again
        for number in range(4):
            wait_until(lambda: bright(number), f"marker {number}")
            click(float(number), 0.0)
        for number in range(4):
            wait_until(lambda: bright(number), f"marker {number} of the second try")
            click(*floor_of(*places[number]))
        wait_until(lambda: file.exists() and not self.shown().any(), "a dark picture")
        node.process.terminate()
        log, _ = node.process.communicate()
        self.assertIn("not in the frame map", log)
        self.assertIn("order of the markers", log)
        footprint = projector_calibration.read_calibration(file).footprint()
        np.testing.assert_allclose(footprint[0], floor_of(0, 0), atol=1e-3)

    def test_the_projector_shows_borders_drawing_and_preview(self):
        file = Path(self.folder.name) / "projector.yaml"
        clicks = [floor_of(*place) for place in markers(*SIZE)]
        projector_calibration.write_calibration(projector_calibration.calibrate(*SIZE, clicks), file)
        node = Process("vb_feedback", "floor_projector", f"_calibration:={file}")
        self.addCleanup(node.stop)
        self.publish_state()
        wait_until(lambda: self.spots.get_num_connections() > 1 and not self.shown().any(), "a dark picture")
        border = VirtualBorder(kind=VirtualBorder.SEPARATING_CURVE, occupancy=1.0, enabled=True)
        border.points = [Point(1.5, 1.5, 0), Point(2.0, 1.5, 0)]
        self.borders.publish(borders=[border])
        wait_until(lambda: self.at(1.75, 1.5) > 100, "the border")
        self.publish_state(name="border", interaction_id="i")
        drawing = BorderProgress(interaction_id="i", chain=[Point(3.0, 1.4, 0), Point(3.0, 2.6, 0)])
        self.progress.publish(drawing)
        wait_until(lambda: self.at(3.0, 2.0) > 100 and self.shown()[0, 0].max() > 100, "drawing and frame")

        def dark():
            self.spots.publish(header=Header(stamp=rospy.Time.now()), camera="red", position=Point(3.0, 2.5, 0))
            return self.at(3.0, 2.4) == 0 and self.at(3.0, 1.6) > 100

        wait_until(dark, "the dark place about the spot")
        count = self.pictures.count
        wait_until(lambda: self.progress.publish(drawing) or self.at(3.0, 2.4) > 100, "the spot's end")
        self.assertLess(self.pictures.count - count, 4, "an unchanged drawing causes no new picture")
        cells = np.zeros((60, 80), np.int8)
        cells[30:50, 40:60] = 100
        region = message_from_grid(GridMap(cells, 0.05), rospy.Time.now())
        self.preview.publish(NumpyBorderPreview(interaction_id="i", available=True, success=True, region=region))
        wait_until(lambda: self.shown()[75:120, 105:195].any(), "what save would restrict")
        self.publish_state()
        wait_until(lambda: self.at(3.0, 1.6) == 0 and self.at(1.75, 1.5) > 100, "the borders alone")

    def test_a_projector_without_a_calibration_says_so(self):
        cases = [([], "calibration"), (["_calibration:=/"], "cannot read")]
        assert_ends_with_one_line("vb_feedback", "floor_projector", cases)


if __name__ == "__main__":
    rostest.rosrun("vb_feedback", "display", DisplayTest)
