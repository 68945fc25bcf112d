#!/usr/bin/env python3
"""Borders by dragged vertices and by files, over a real roscore and a real map_integrator."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import numpy as np
import rospy
import rostest
from std_srvs.srv import Trigger
from visualization_msgs.msg import InteractiveMarkerFeedback, InteractiveMarkerUpdate

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from ros_helpers import Latest, MapServer, lab, wait_until  # noqa: E402
from vb_core.ros.messages import OccupancyGridArray  # noqa: E402
from vb_map_integration import border_editor_node as editor  # noqa: E402
from vb_map_integration.border import VirtualBorder  # noqa: E402
from vb_map_integration.borders.border_messages import message_from_border  # noqa: E402
from vb_msgs.msg import VirtualBorderArray  # noqa: E402
from vb_msgs.srv import AddBorder, RenameBorder  # noqa: E402

SCRIPTS = Path(__file__).resolve().parent.parent / "scripts"


class Handles:
    """What RViz would show: the interactive markers by name, from the updates."""

    def __init__(self):
        self.places, self.texts, self.menus = {}, {}, {}
        topic = editor.SERVER
        self.subscriber = rospy.Subscriber(topic + "/update", InteractiveMarkerUpdate, self.take, queue_size=1000)
        self.publisher = rospy.Publisher(topic + "/feedback", InteractiveMarkerFeedback, queue_size=1000)

    def take(self, update):
        for name in update.erases:
            for known in (self.places, self.texts, self.menus):
                known.pop(name, None)
        for marker in update.markers:
            self.places[marker.name] = (marker.pose.position.x, marker.pose.position.y)
            self.menus[marker.name] = [entry.id for entry in marker.menu_entries]
            self.texts[marker.name] = " ".join(one.text for control in marker.controls for one in control.markers)
        for pose in update.poses:
            self.places[pose.name] = (pose.pose.position.x, pose.pose.position.y)

    def send(self, name, event, place=(0.0, 0.0), entry=0):
        # what is sent to a marker that is not there yet is lost
        wait_until(lambda: name == editor.TOOL or name in self.places, f"the marker {name}")
        # a server takes no feedback from a second client within a second; "" is who it thinks was the first
        feedback = InteractiveMarkerFeedback(client_id="", marker_name=name, event_type=event, menu_entry_id=entry)
        feedback.header.frame_id = "map"
        feedback.pose.position.x, feedback.pose.position.y = place
        self.publisher.publish(feedback)

    def drag(self, name, place):
        self.send(name, InteractiveMarkerFeedback.POSE_UPDATE, place)
        self.send(name, InteractiveMarkerFeedback.MOUSE_UP, place)

    def menu(self, name, entry):
        self.send(name, InteractiveMarkerFeedback.MENU_SELECT, entry=entry)


class InputMethodsTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("rostest_input_methods")
        cls.grid = lab()
        cls.maps = Latest("/virtual_borders/map", OccupancyGridArray)
        cls.borders = Latest("/virtual_borders/borders", VirtualBorderArray)
        cls.handles = Handles()
        cls.server = MapServer(cls.grid)
        wait_until(lambda: cls.maps.count and cls.borders.count, "the first map")
        wait_until(lambda: cls.handles.publisher.get_num_connections(), "border_editor")

    def setUp(self):
        rospy.ServiceProxy("/virtual_borders/clear", Trigger)()
        wait_until(lambda: not self.borders.message.borders, "the empty list of borders")

    def stored(self, count):
        wait_until(lambda: len(self.borders.message.borders) == count, f"{count} border(s)")
        return self.borders.message.borders

    def drawn_border(self):
        """The id of a separating curve from (0, 0) to (0, 1) whose right side is restricted."""
        border = VirtualBorder([(0.0, 0.0), (0.0, 1.0)], (2.0, 0.0), 1.0, False)
        add = rospy.ServiceProxy("/virtual_borders/add_border", AddBorder)
        add(border=message_from_border(border), frame_id="map", source="test")
        return self.stored(1)[0].id

    def restricted(self):
        cells = np.asarray(self.maps.message.data).reshape(self.grid.shape)
        return int((cells != self.grid.data).sum())

    # ------------------------------------------------------------- dragged vertices
    def test_a_new_polygon_is_dragged_and_saved(self):
        self.handles.drag("tool", (-2.0, 0.0))
        self.handles.menu("tool", editor.NEW_POLYGON)
        wait_until(lambda: "new/3" in self.handles.places, "the handles of a square")
        self.handles.drag("new/2", (-1.0, 1.0))
        wait_until(lambda: self.handles.places.get("new/2") == (-1.0, 1.0), "the vertex where it was dragged to")
        wait_until(lambda: "would restrict" in self.handles.texts.get("new/line", ""), "the preview's answer")
        self.handles.menu("new/0", editor.SAVE)
        border = self.stored(1)[0]
        self.assertEqual([(p.x, p.y) for p in border.points], [(-2.5, -0.5), (-1.5, -0.5), (-1.0, 1.0), (-2.5, 0.5)])
        wait_until(lambda: border.id in self.handles.places and "new/0" not in self.handles.places, "one handle again")

    def test_a_stored_border_is_edited(self):
        key = self.drawn_border()
        self.handles.menu(key, editor.EDIT)
        wait_until(lambda: f"{key}/1" in self.handles.places, "handles of its vertices")
        self.handles.menu(f"{key}/0", editor.INSERT)
        wait_until(lambda: self.handles.places.get(f"{key}/1") == (0.0, 0.5), "a vertex between")
        self.handles.drag(f"{key}/1", (0.3, 0.5))
        # a seed off the map is refused by the preview, and by saving; the draft stays
        self.handles.drag(f"{key}/seed", (80.0, 0.0))
        wait_until(lambda: "outside the map" in self.handles.texts.get(f"{key}/line", ""), "the preview's refusal")
        self.handles.menu(f"{key}/0", editor.SAVE)
        self.handles.drag(f"{key}/seed", (-2.0, 0.0))
        wait_until(lambda: "would restrict" in self.handles.texts.get(f"{key}/line", ""), "the preview's consent")
        self.handles.menu(f"{key}/0", editor.REMOVE_VERTEX)
        wait_until(lambda: f"{key}/2" not in self.handles.places, "one vertex less")
        self.assertEqual(self.borders.message.borders[0].seed.x, 2.0)
        self.handles.menu(f"{key}/0", editor.SAVE)
        wait_until(lambda: self.borders.message.borders[0].seed.x == -2.0, "the new seed")
        self.assertEqual([(p.x, p.y) for p in self.borders.message.borders[0].points], [(0.3, 0.5), (0.0, 1.0)])

    def test_what_somebody_else_changed_is_not_overwritten(self):
        key = self.drawn_border()
        self.handles.menu(key, editor.EDIT)
        wait_until(lambda: f"{key}/1" in self.handles.places, "handles of its vertices")
        rename = rospy.ServiceProxy("/virtual_borders/rename_border", RenameBorder)
        self.assertTrue(rename(key, "theirs", "test", 0).success)
        wait_until(lambda: self.borders.message.borders[0].name == "theirs", "their name")
        self.handles.drag(f"{key}/1", (0.5, 1.0))
        self.handles.menu(f"{key}/0", editor.SAVE)
        wait_until(lambda: "Somebody else" in self.handles.texts.get(f"{key}/line", ""), "the refusal")
        self.assertEqual(self.borders.message.borders[0].name, "theirs")
        self.handles.menu(f"{key}/0", editor.CANCEL)
        wait_until(lambda: f"{key}/0" not in self.handles.places, "no handles")

    def test_menus_of_a_stored_border_and_of_the_tool(self):
        key = self.drawn_border()
        self.handles.menu(key, editor.TOGGLE)
        wait_until(lambda: not self.borders.message.borders[0].enabled, "a border that sleeps")
        self.handles.menu(key, editor.EDIT)
        wait_until(lambda: f"{key}/0" in self.handles.places, "handles")
        self.handles.menu(f"{key}/0", editor.CANCEL)
        wait_until(lambda: f"{key}/0" not in self.handles.places and key in self.handles.places, "no handles")
        self.handles.menu(key, editor.DELETE)
        self.stored(0)
        new = [editor.NEW_POLYGON, editor.NEW_CURVE]
        wait_until(lambda: self.handles.menus.get("tool") == [*new, editor.UNDO], "undo, and no redo")
        self.handles.menu("tool", editor.UNDO)
        self.stored(1)
        wait_until(lambda: editor.REDO in self.handles.menus["tool"], "redo")

    # ------------------------------------------------------------- files
    def run_command(self, name, *arguments):
        done = subprocess.run(
            [sys.executable, str(SCRIPTS / name), *map(str, arguments)],
            universal_newlines=True,
            timeout=240,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
        )
        return done.returncode, done.stdout

    def test_files_go_in_and_out(self):
        with tempfile.TemporaryDirectory() as folder:
            source, copy = Path(folder) / "in.geojson", Path(folder) / "out.yaml"
            square = [[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]
            features = [
                {
                    "type": "Feature",
                    "geometry": {"type": "Polygon", "coordinates": [square]},
                    "properties": {"name": "rug"},
                },
                {
                    "type": "Feature",
                    "geometry": {"type": "LineString", "coordinates": [[60, 0], [60, 1]]},
                    "properties": {"name": "far", "seed": [0, 0]},
                },
            ]
            source.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
            status, output = self.run_command("import_borders", "--dry-run", source)
            self.assertEqual((status, self.borders.message.borders), (1, []), output)
            status, output = self.run_command("import_borders", source)
            self.assertEqual(status, 1, output)
            for words in ("rug: added", "far: refused [outside_map]", "1 of 2 taken"):
                self.assertIn(words, output)
            self.assertEqual(self.stored(1)[0].name, "rug")
            self.assertEqual(self.run_command("export_borders", copy)[0], 0)
            # what was exported and edited is updated, not doubled
            edited = copy.read_text().replace('"rug"', '"carpet"').replace('"enabled": true', '"enabled": false')
            copy.write_text(edited)
            status, output = self.run_command("import_borders", copy)
            self.assertEqual(status, 0, output)
            wait_until(lambda: self.borders.message.borders[0].name == "carpet", "the edited border")
            border = self.stored(1)[0]
            self.assertEqual((border.name, border.in_force, border.reason), ("carpet", False, "disabled"))
            # one of another home is added, and stays switched off
            copy.write_text(copy.read_text().replace('"created": 1', '"created": '))
            count = self.maps.count
            status, output = self.run_command("import_borders", copy)
            self.assertEqual(status, 0, output)
            self.assertEqual([(one.name, one.in_force) for one in self.stored(2)], [("carpet", False)] * 2)
            wait_until(lambda: self.maps.count > count, "the map with it")
            self.assertEqual(self.restricted(), 0)
            copy.write_text("borders: 3")
            status, output = self.run_command("import_borders", copy)
            self.assertEqual(status, 2)
            self.assertIn("bad_border_file", output)
            self.assertNotIn("Traceback", output)


if __name__ == "__main__":
    rostest.rosrun("vb_map_integration", "input_methods", InputMethodsTest)
