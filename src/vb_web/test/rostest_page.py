#!/usr/bin/env python3
"""The page in a real browser, with the real nodes behind it: what people do at home and in a study."""

from __future__ import annotations

import json
import os
import signal
import unittest
from contextlib import closing, contextmanager
from datetime import datetime
from pathlib import Path
from xmlrpc.client import ServerProxy

import numpy as np
import rosgraph
import rospy
import rostest
import yaml
from geometry_msgs.msg import Point
from sensor_msgs.msg import Image

from accessibility import faults_of
from phone import PHONE, WALL, Browser
from vb_testing import Process, is_listening, wait_until
from vb_core import names, sentences
from vb_core.notices import Notice, Severity
from vb_core.ros.messages import OccupancyGridArray, grid_from_message
from vb_core.ros.notices import NoticePublisher
from vb_evaluation.processes import free_port
from vb_msgs.msg import DetectorStatus, DriverState, InteractionState, LaserSpot, StudyEvent
from vb_msgs.msg import RobotStatus, RobotStatusArray, Stop, VirtualBorder, VirtualBorderArray
from vb_msgs.srv import AddBorder, RemoveBorder

CARPET = [[3.12, 0.8], [5.12, 0.8], [5.12, 2.05], [3.12, 2.05]]


def round_the(corners, per_side=6):
    """A finger's path round corners, back to near its start."""
    path = []
    for a, b in zip(corners, corners[1:] + corners[:1]):
        path += [[a[0] + (b[0] - a[0]) * i / per_side, a[1] + (b[1] - a[1]) * i / per_side] for i in range(per_side)]
    return path


class PageTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("rostest_page")
        cls.heard = {}
        for topic, kind in (
            (names.BORDERS, VirtualBorderArray),
            (names.STATE, InteractionState),
            (names.MAP_WITH_BORDERS, OccupancyGridArray),
            (names.PHYSICAL_MAP, OccupancyGridArray),
            (names.STOP, Stop),
            (names.STUDY_EVENTS, StudyEvent),
        ):
            rospy.Subscriber(topic, kind, lambda message, topic=topic: cls.heard.__setitem__(topic, message))
        cls.spots = rospy.Publisher(names.SPOTS, LaserSpot, queue_size=5)
        cls.port = free_port()
        cls.events = Path(rospy.get_param("~state")) / "page_events.jsonl"
        cls.page = None
        cls.start_page()
        cls.browser = Browser(f"http://127.0.0.1:{cls.port}/")

    @classmethod
    def tearDownClass(cls):
        cls.browser.close()
        cls.page.stop()

    @classmethod
    def start_page(cls, *arguments):
        files = (f"_events_file:={cls.events}", f"_codes_file:={cls.events.parent}/page_codes.yaml")
        cls.page = Process("vb_web", "page", "__name:=page", f"_port:={cls.port}", *files, *arguments)
        wait_until(lambda: is_listening(cls.port), "the page to listen")

    def setUp(self):
        if self.browser.run("return document.body.dataset.mode != 'look' || document.getElementById('dialog').open"):
            self.browser.driver.refresh()  # what failed before leaves nothing behind
        self.browser.wait_ready()
        for border in self.borders():
            rospy.ServiceProxy(names.REMOVE_BORDER, RemoveBorder)(id=border.id, source="test")
        self.wait_borders(0)
        self.browser.wait("!document.querySelector('#borders .name')", what="a page without borders")
        self.browser.faults()  # of other tests
        # a banner that goes moves the map
        self.browser.wait("!document.getElementById('banners').textContent", what="a page with nothing to say")

    def borders(self):
        message = self.heard.get(names.BORDERS)
        return list(message.borders) if message else []

    def wait_borders(self, count):
        wait_until(lambda: names.BORDERS in self.heard and len(self.borders()) == count, f"{count} borders")
        return self.borders()

    def draw_carpet(self, name=""):
        before = len(self.borders())
        self.browser.click("#draw")
        self.browser.stroke(round_the(CARPET))
        self.browser.wait_text("#review", "m²")
        if name:
            self.browser.field("#review input[data-key=name]").send_keys(name)
        self.browser.click("#review button", "Save")
        self.browser.wait("document.body.dataset.mode == 'look'", what="the border to be saved")
        return self.wait_borders(before + 1)[-1]

    def store_carpet(self, name="Rug", shown="Rug", **fields):
        """A border that a test only needs to be there."""
        border = VirtualBorder(name=name, kind=VirtualBorder.POLYGON, enabled=True, occupancy=1.0, **fields)
        border.points, border.seed = [Point(x, y, 0.0) for x, y in CARPET], Point(4.0, 1.5, 0.0)
        answer = rospy.ServiceProxy(names.ADD_BORDER, AddBorder)(border=border, frame_id="map", source="test")
        self.assertTrue(answer.success, answer.message)
        self.browser.wait_text("#borders", shown)

    def resume(self):
        self.browser.click("#resume", "Resume")
        wait_until(lambda: not self.heard[names.STATE].stopped, "go on")

    @contextmanager
    def halted_manager(self, ends_with):
        """A manager that hangs, which the page tells, and then gets a signal."""
        uri = rosgraph.Master("/rostest_page").lookupNode("/interaction_manager")
        process = ServerProxy(uri).getPid("/rostest_page")[2]
        os.kill(process, signal.SIGSTOP)
        try:
            self.browser.wait_text("#banners", "has not responded for more than 0:0")
            yield
        finally:
            os.kill(process, ends_with)

    @contextmanager
    def small_phone(self, *options, **more):
        with closing(Browser(self.browser.url, (360, 640), *options, **more)) as small:
            small.wait_ready()
            yield small

    def restart_page(self, *arguments):
        """Kills the page, which forgets what it has heard of, and starts it again."""
        self.page.kill()
        self.browser.wait("document.body.dataset.state == 'offline'", what="the lost connection")
        self.start_page(*arguments)

    # ------------------------------------------------------------- borders
    def test_1_a_border_round_the_carpet_from_the_phone(self):
        border = self.draw_carpet("Küche 厨房")
        self.assertEqual((border.name, border.kind), ("Küche 厨房", VirtualBorder.POLYGON))
        prior, posterior = (
            grid_from_message(self.heard[topic]) for topic in (names.PHYSICAL_MAP, names.MAP_WITH_BORDERS)
        )
        cells = np.argwhere(posterior.data > prior.data)
        places = posterior.cell_to_world(cells)
        self.assertLess(np.abs(places.min(axis=0) - CARPET[0]).max(), 0.1)
        self.assertLess(np.abs(places.max(axis=0) - CARPET[2]).max(), 0.1)
        self.browser.wait(
            "document.getElementById('restricted').classList.contains('there')", what="the restricted floor"
        )
        self.browser.wait_text("#borders", "Küche 厨房")
        # undo and redo
        self.browser.click("#undo")
        self.wait_borders(0)
        self.browser.wait_text("#borders", "No borders yet")
        self.browser.wait_text("#toast", "Removed from the map: Küche 厨房.")
        self.browser.click("#redo")
        self.wait_borders(1)
        self.browser.wait("document.getElementById('redo').disabled", what="a button that has nothing to do")
        self.browser.driver.refresh()  # nobody has to try it
        self.browser.wait_ready()
        self.browser.wait(
            "document.getElementById('redo').disabled && !document.getElementById('undo').disabled",
            what="what can be undone",
        )
        # rename, switch off
        self.browser.click("#borders .name")
        field = self.browser.field("#dialog input")
        field.clear()
        field.send_keys("Rug")
        self.browser.click("#dialog button", "Rename")
        wait_until(lambda: self.borders()[0].name == "Rug", "the new name")
        self.browser.click("#borders .switch")
        wait_until(lambda: not self.borders()[0].enabled, "the border to be off")
        wait_until(
            lambda: (self.heard[names.MAP_WITH_BORDERS].data == self.heard[names.PHYSICAL_MAP].data).all(),
            "the map without it",
        )
        self.browser.wait_text("#borders", "Switched off")
        # the history says it all
        for part in ("Küche 厨房 was added", "Rug has a new name", "Rug was switched off"):
            self.browser.wait(
                "document.getElementById('events').textContent.includes(arguments[0])",
                part,
                what=f"'{part}' in the history",
            )
        self.browser.click("#borders .name")
        self.browser.click("#dialog button", "Remove")
        self.wait_borders(0)
        self.assertEqual(self.browser.faults(), [])

    def test_2_corners_times_and_a_wall(self):
        self.draw_carpet("Rug")
        # a tap on the map opens the menu, and presses nothing that comes up under the finger
        self.browser.wait("window.virtualBorders.map.borders.length", what="the border on the map")
        middle = self.browser.run(
            "const line = window.virtualBorders.map.borders[0].line; return [0, 1].map("
            "(axis) => line.reduce((sum, point) => sum + point[axis], 0) / line.length)"
        )
        for point in ([middle[0] + 0.4, middle[1]], [middle[0] - 0.4, middle[1]]):
            self.browser.tap(point)
            self.browser.wait_text("#dialog", "Switch off")
            self.browser.wait_click()
            self.assertIn("Switch off", self.browser.text("#dialog"))
            self.browser.run("document.getElementById('dialog').close()")
        self.browser.click("#borders .name")
        self.browser.click("#dialog button", "Edit")
        self.browser.wait("document.querySelectorAll('#handles [data-corner]').length >= 4", what="corners")
        self.browser.wait_text("#review", " m\u00b2")
        area = self.browser.text("#review").split(" m\u00b2")[0].split()[-1]
        corner = self.browser.run(
            "return window.virtualBorders.draft().points.reduce((a, b) => b[0] + b[1] > a[0] + a[1] ? b : a)"
        )
        end = [corner[0] + 0.5, corner[1] + 0.4]
        self.browser.stroke([corner, [corner[0] + 0.2, corner[1] + 0.1], end])
        # the corner follows the finger to the end, and the area is that of the new shape
        self.browser.wait(
            "Math.hypot(...window.virtualBorders.draft().points.reduce((a, b) => b[0] + b[1] > a[0] + a[1] ? b : a)"
            ".map((value, axis) => value - arguments[0][axis])) < 0.1",
            end,
            what="the corner under the finger",
        )
        self.browser.wait(
            "!document.getElementById('review').innerText.includes(arguments[0])",
            f"{area} m\u00b2",
            what="the new area",
        )
        # the same by keys
        index = self.browser.run("""const points = window.virtualBorders.draft().points;
            const i = points.reduce((a, b, k) => b[0] + b[1] < points[a][0] + points[a][1] ? k : a, 0);
            document.querySelector(`#handles [data-corner="${i}"]`).focus(); return i""")
        low = self.browser.run("return window.virtualBorders.draft().points[arguments[0]]", index)
        self.browser.driver.switch_to.active_element.send_keys("\ue012" * 2)  # the left arrow
        self.browser.click("#review button", "Save")
        points = wait_until(
            lambda: len(self.borders()) == 1
            and any(p.x > 5.4 for p in self.borders()[0].points)
            and self.borders()[0].points,
            "the moved corner",
        )
        self.assertAlmostEqual(min(abs(p.x - (low[0] - 0.1)) + abs(p.y - low[1]) for p in points), 0.0, delta=0.02)
        # times, which switch it on
        self.browser.click("#borders .switch")
        wait_until(lambda: not self.borders()[0].enabled, "the border to be off")
        self.browser.wait_text("#borders", "Switched off")
        self.browser.click("#borders .name")
        self.browser.click("#dialog button", "Schedule")
        self.browser.wait_text("#dialog", "Rug: schedule")
        self.browser.click("#dialog button", "Weekdays")
        self.browser.click("#dialog button", "Save")  # nobody's times are made up
        self.browser.wait_text("#toast", "both times")
        for field, text in (("from", "8"), ("to", "1230")):
            self.browser.field(f"#dialog input[data-key={field}]").send_keys(text)
        self.browser.click("#dialog button", "Save")
        wait_until(lambda: self.borders()[0].schedule == "mon-fri 08:00-12:30", "the schedule")
        self.assertTrue(self.borders()[0].enabled)
        self.browser.wait_text("#toast", "Switched on: in force only Mon")
        self.browser.wait(
            "document.getElementById('borders').innerText.replace(/\\u2060/g, '').includes('Mon–Fri 08:00–12:30')",
            what="the schedule in the list",
        )
        # what changes nothing is no step of undo
        revision = self.browser.run("return window.virtualBorders.view.borders.revision")
        self.browser.click("#borders .name")
        self.browser.click("#dialog button", "Schedule")
        self.browser.click("#dialog button", "Save")
        self.browser.wait("!document.getElementById('dialog').open", what="the dialog to close")
        self.browser.click("#borders .name")
        self.browser.click("#dialog button", "Edit")
        self.browser.wait_text("#review", "m²")
        self.browser.click("#review button", "Save")
        self.browser.wait("document.body.dataset.mode == 'look'", what="the end of the change")
        self.assertEqual(self.browser.run("return window.virtualBorders.view.borders.revision"), revision)
        # a wall by two taps
        self.browser.click("#wall")
        for point in ([3.3, 4.0], [3.3, 3.1]):
            self.browser.tap(point)
        self.browser.wait_text("#review", "Save this wall?")
        self.browser.click("#review button", "Save")
        wall = self.wait_borders(2)[-1]
        self.assertEqual(wall.kind, VirtualBorder.VIRTUAL_WALL)
        self.browser.wait_text("#borders", "Wall ")  # nobody named it
        self.assertEqual(self.browser.faults(), [])

    def test_2a_a_second_tap_a_second_finger_a_turned_phone_and_back(self):
        corners = "return document.querySelectorAll('#placed .knob').length"
        self.browser.click("#draw")
        self.browser.tap([3.0, 1.0])
        self.browser.fingers([[[3.5, 2.0]], [[3.5, 2.0], [4.0, 2.0]], [[3.4, 2.0], [4.1, 2.0]]])
        self.assertEqual(self.browser.run(corners), 1)  # a closer look keeps what was begun
        # a phone that is turned under the finger: the line until then is no border
        self.browser.fingers([[[3.0, 1.0]], [[3.5, 1.0]], [[4.0, 1.0]]], lift=False)
        self.browser.resize((740, 360))
        self.browser.wait("document.querySelectorAll('#placed .knob').length == 1", what="the corner from before")
        self.browser.lift()
        self.browser.resize(PHONE)
        self.assertEqual(self.browser.run("return document.body.dataset.mode"), "draw")
        # a phone's Back closes what lies on top, and stays on the page; what nobody has saved is not lost without a question
        self.browser.driver.back()
        self.browser.wait_text("#dialog", "not saved yet")
        self.browser.click("#dialog button", "Keep editing")
        self.assertEqual(self.browser.run(corners), 1)
        self.browser.driver.back()
        self.browser.wait_text("#dialog", "not saved yet")
        self.browser.click("#dialog button", "Discard")
        self.browser.wait("document.body.dataset.mode == 'look'", what="the end of the drawing")
        self.browser.click("#draw")
        self.browser.driver.back()
        self.browser.wait("document.body.dataset.mode == 'look'", what="the end of a drawing that has no corner")
        self.browser.click("#settings-button")
        self.browser.driver.back()
        self.browser.wait("!document.getElementById('dialog').open", what="the dialog to close")
        self.browser.click("#zoom-fit")
        # two taps on Save are one border: taking one back leaves none
        self.browser.click("#draw")
        self.browser.stroke(round_the(CARPET))
        self.browser.wait_text("#review", "m²")
        self.browser.run(
            "const save = [...document.querySelectorAll('#review button')].pop(); save.click(); save.click()"
        )
        self.wait_borders(1)
        self.browser.wait("document.body.dataset.mode == 'look'", what="the border to be saved")
        self.browser.click("#undo")
        self.wait_borders(0)
        # a name that was typed comes back
        self.store_carpet()
        self.browser.click("#borders .name")
        self.browser.field("#dialog input").send_keys(" 2")
        self.browser.click("#dialog button", "Close")
        self.browser.click("#dialog button", "Keep editing")
        self.browser.wait_text("#dialog", "Switch off")
        self.assertEqual(self.browser.run("return document.querySelector('#dialog input').value"), "Rug 2")
        self.browser.click("#dialog button", "Rename")
        wait_until(lambda: self.borders()[0].name == "Rug 2", "the new name")
        # what a dialog covered cannot be pressed at once
        self.browser.click("#borders .name")
        under = self.browser.driver.execute_async_script(
            """const done = arguments[0], one = document.querySelector('#map-tools button:last-child');
            one.scrollIntoView({ block: 'center' });
            const dialog = document.getElementById('dialog'), box = one.getBoundingClientRect();
            dialog.addEventListener('close', () => done(
                document.elementFromPoint(box.left + box.width / 2, box.top + box.height / 2).closest('button')), { once: true });
            dialog.close()"""
        )
        self.assertIsNone(under)
        self.assertEqual(self.browser.faults(), [])

    # ------------------------------------------------------------- interaction
    def test_3_commands_stop_and_go_on(self):
        self.browser.click("#commands button", "Define border")
        self.browser.wait("document.body.dataset.state == 'border'", what="the state border")
        self.browser.click("#settings-button")  # stop is in reach also while a dialog is open
        self.browser.click("#stop")
        wait_until(lambda: self.heard[names.STATE].stopped and names.STOP in self.heard, "stop")
        self.browser.wait_text("#banners", "All robots are stopped")
        self.assertGreaterEqual(
            self.browser.run(
                "window.scrollTo(0, 300); return document.getElementById('banners').getBoundingClientRect().top"
            ),
            0,
        )  # wherever one is
        self.browser.run("window.scrollTo(0, 0)")
        # a stop of all robots stands there, so neither the answer nor a notice says it again
        self.browser.wait(
            "document.getElementById('toast').dataset.code == 'stopped'"
            " && window.virtualBorders.view.notices.some((one) => one.code == 'stopped')",
            what="the answer and the notice",
        )
        self.assertEqual(self.browser.text("#toast"), "")
        self.assertNotIn("topped", self.browser.text("#notices"))
        self.assertEqual(self.browser.text("#state"), "Stopped")
        self.browser.click("#dialog button", "Close")
        self.resume()
        self.browser.wait_text("#toast", "Robots may drive again.")
        self.browser.click("#commands button", "Cancel")
        self.browser.wait("document.body.dataset.state == 'default'", what="the state default")
        told = [
            json.loads(line)["values"]["command"] for line in self.events.read_text().splitlines() if "command" in line
        ]
        self.assertEqual(told[-4:], ["define_border", "stop", "resume", "cancel"])  # each once

    def test_3a_nothing_moves_under_a_finger_and_the_map_stays_in_its_frame(self):
        place = "return JSON.stringify(['map', 'stop', 'settings-button'].map((id) => document.getElementById(id).getBoundingClientRect()))"
        self.browser.run("window.scrollTo(0, 0)")
        before = self.browser.run(place)
        self.browser.click("#draw")
        self.browser.tap([3.0, 1.0])
        self.browser.run("window.scrollTo(0, 0)")
        self.assertEqual(self.browser.run(place), before)
        self.browser.click("#review button", "Cancel")
        self.browser.click("#stop")
        self.browser.wait_text("#banners", "All robots are stopped")
        self.browser.run("window.scrollTo(0, 0)")
        self.assertEqual(self.browser.run(place), before)
        # a second tap on Stop is no Resume
        self.browser.run("document.getElementById('toast').dataset.code = ''")
        self.browser.click("#stop")
        self.browser.wait("document.getElementById('toast').dataset.code == 'stopped'", what="the second answer")
        self.assertTrue(self.heard[names.STATE].stopped)
        self.resume()
        inside = """const m = window.virtualBorders.map, [w, h] = m.size(), [x0, x1, y0, y1] = m.box;
            const [a, b] = [m.toScreen([x0, y1]), m.toScreen([x1, y0])];
            return a[0] < w / 2 && b[0] > w / 2 && a[1] < h / 2 && b[1] > h / 2"""
        for swipe in ("pan(-5000, 0)", "pan(0, 5000)", "zoom(3)", "pan(9000, -9000)", "zoom(1 / 9)"):
            self.browser.run(f"window.virtualBorders.map.{swipe}")
            self.assertTrue(self.browser.run(inside), swipe)
        self.browser.click("#zoom-fit")
        view = "return JSON.stringify(window.virtualBorders.map.view)"
        before = self.browser.run(view)
        self.browser.stroke([[4.0, 2.5], [3.0, 2.5], [1.0, 2.5]])  # one finger scrolls the page, if anything
        self.assertEqual(self.browser.run(view), before)
        # what is drawn beyond the map's edge ends at it; what is drawn beside the map is refused in words
        edge = self.browser.run("return window.virtualBorders.map.onMap([-50, -50])")
        self.assertEqual(self.browser.run("return window.virtualBorders.map.onMap(arguments[0])", edge), edge)
        self.assertEqual(self.browser.faults(), [])

    def test_3aa_resume_has_a_place_that_nothing_else_ever_has(self):
        self.store_carpet()
        self.browser.click("#stop")
        self.browser.wait("document.body.classList.contains('stopped')", what="the stop")
        box = "const box = document.getElementById('resume').getBoundingClientRect();"
        place = self.browser.run(f"{box} return JSON.stringify(box)")

        def check(what):
            top = self.browser.run(
                f"{box} return document.elementFromPoint(box.left + box.width / 2, box.top + box.height / 2).id"
            )
            self.assertEqual(top, "resume", what)
            self.assertEqual(self.browser.run(f"{box} return JSON.stringify(box)"), place, what)
            self.assertFalse(
                self.browser.run(
                    f"""{box} return [...document.querySelectorAll('#line button, #stop')].some((one) => {{
                    const other = one.getBoundingClientRect(); return other.width && other.left < box.right
                    && other.right > box.left && other.top < box.bottom && other.bottom > box.top; }})"""
                ),
                what,
            )

        check("nothing else")
        self.browser.click("#borders .switch")
        self.browser.wait_text("#toast", "Undo")
        check("the answer with Undo")
        self.browser.click("#borders .name")
        check("a dialog")
        self.browser.click("#dialog button", "Close")
        self.browser.click("#draw")
        self.browser.tap([3.0, 1.0])
        check("a drawing")
        self.resume()
        self.browser.wait("!document.getElementById('resume').getClientRects().length", what="no Resume")
        self.assertEqual(self.browser.run("return document.querySelectorAll('#placed .knob').length"), 1)
        self.browser.click("#review button", "Cancel")

    def test_3ab_two_fingers_enlarge_the_page_and_stop_keeps_its_place_on_the_screen(self):
        with self.small_phone(mobile=True) as small:
            # on the screen, and not in the page: what was seen of it times the scale
            place = """const { scale, offsetLeft, offsetTop } = visualViewport,
                box = document.getElementById('stop').getBoundingClientRect();
                return [(box.left - offsetLeft) * scale, (box.top - offsetTop) * scale, box.width * scale, box.height * scale]"""
            before = small.run(place)
            apart = [[(180 - 10 * step, 500 + 5 * step), (200 + 10 * step, 500 - 5 * step)] for step in range(1, 13)]
            small.fingers_on_screen([apart[0][:1], *apart])
            small.wait("visualViewport.scale > 1.5 && visualViewport.offsetTop > 50", what="an enlarged page")
            np.testing.assert_allclose(small.run(place), before, atol=1.0)
            self.assertEqual(
                small.run("""const box = document.getElementById('stop').getBoundingClientRect();
                return document.elementFromPoint(box.left + box.width / 2, box.top + box.height / 2).closest('button').id"""),
                "stop",
            )
            small.run("document.getElementById('stop').click()")
            small.wait("document.body.classList.contains('stopped')", what="the stop")
            self.browser.wait_text("#banners", "All robots are stopped")
            # what misses Stop by a thumb's width presses no Resume, which is on the screen as well
            gap = """const [stop, resume] = ['stop', 'resume'].map((id) => document.getElementById(id).getBoundingClientRect());
                const { scale, offsetLeft, offsetTop, width, height } = visualViewport;
                const seen = resume.left >= offsetLeft && resume.top >= offsetTop
                    && resume.right <= offsetLeft + width && resume.bottom <= offsetTop + height;
                return seen ? scale * Math.max(stop.left - resume.right, resume.left - stop.right,
                    stop.top - resume.bottom, resume.top - stop.bottom) : 0"""
            self.assertGreaterEqual(small.run(gap), 24)
            small.driver.execute_cdp_cmd("Emulation.setPageScaleFactor", {"pageScaleFactor": 1})
            small.wait("visualViewport.scale === 1 && !document.getElementById('standing').style.transform")
            for size in ((360, 640), (640, 360), PHONE, WALL):
                small.resize(size)
                self.assertGreaterEqual(small.run(gap), 24, size)
        self.resume()

    def test_3ac_each_border_in_view_has_its_name_or_its_mark_and_nothing_else_has(self):
        self.browser.wait_arrived()
        lines = {"a": CARPET, "b": [[x + 0.4, y + 2.2] for x, y in CARPET]}
        lines.update((name, [[x, 2.3], [x, 3.0]]) for name, x in (("c", 3.9), ("d", 4.1), ("e", 4.3)))
        self.browser.run(
            """window.virtualBorders.map.setBorders(Object.entries(arguments[0]).map(([name, line]) => ({
            id: name, mark: name, name: `A name of some length: ${name}`, note: "", area: 1, points: line.flat().map((v) => 100 * v),
            kind: line.length > 2 ? "polygon" : "wall" })), "")""",
            lines,
        )
        look = """const map = window.virtualBorders.map; map.view = { ...map.view, ...arguments[0] }; map.lay();
            return [...document.querySelectorAll('#placed .name')].map((group) => {
                const shown = [...group.querySelectorAll(':scope > text, .mark')].filter((one) => one.getClientRects().length
                    && getComputedStyle(one).visibility !== 'hidden');
                return [group.border.id, ...shown.map((one) => [one.textContent, one.getBoundingClientRect().toJSON()])]; })"""
        frame = self.browser.run("return document.getElementById('map').getBoundingClientRect().toJSON()")
        scale = self.browser.run("return window.virtualBorders.map.limits[0]")
        for factor, x, y in ((1, 4, 2.5), (1.5, 4, 2.5), (4, 4.1, 2.6), (6, 4, 1.5), (5, 1.0, 1.0), (12, 4.1, 2.0)):
            view = {"scale": scale * factor, "x": x, "y": y}
            half = [frame["width"] / view["scale"] / 2, frame["height"] / view["scale"] / 2]
            boxes = []
            for name, *shown in self.browser.run(look, view):
                low, high = np.min(lines[name], axis=0), np.max(lines[name], axis=0)
                inside = bool(np.all(high > [x - half[0], y - half[1]]) and np.all(low < [x + half[0], y + half[1]]))
                self.assertEqual(len(shown), int(inside), f"{name} at {view}: {shown}")
                boxes += shown
            for number, (text, box) in enumerate(boxes):
                self.assertGreaterEqual(box["left"], frame["left"] - 1, text)
                self.assertLessEqual(box["right"], frame["right"] + 1, text)
                for other, there in boxes[:number]:
                    apart = (
                        box["left"] >= there["right"] - 1
                        or there["left"] >= box["right"] - 1
                        or box["top"] >= there["bottom"] - 1
                        or there["top"] >= box["bottom"] - 1
                    )
                    self.assertTrue(apart, f"{text} and {other} at {view}")
        self.browser.driver.refresh()
        self.browser.wait_ready()

    def test_3ad_lengths_a_scale_and_the_last_corner(self):
        scale = """const map = window.virtualBorders.map; map.lay(); const bar = document.getElementById('scale');
            return [parseFloat(bar.textContent), bar.getBoundingClientRect().width / map.view.scale]"""
        for factor in (1, 3, 3):
            self.browser.run("window.virtualBorders.map.zoom(arguments[0])", factor)
            told, true = self.browser.run(scale)
            self.assertAlmostEqual(told / true, 1.0, delta=0.02)
        self.browser.click("#zoom-fit")
        lengths = "return [...document.querySelectorAll('#placed .length')].map((one) => parseFloat(one.textContent))"
        corners = "return document.querySelectorAll('#placed .knob').length"
        self.browser.click("#draw")
        for point in ([3.0, 1.0], [5.0, 1.0], [5.0, 2.5]):
            self.browser.tap(point)
        self.assertAlmostEqual(self.browser.run(lengths)[0], 1.5, delta=0.1)
        self.browser.click("#review button", "Remove last corner")
        self.assertEqual(self.browser.run(corners), 2)
        self.assertAlmostEqual(self.browser.run(lengths)[0], 2.0, delta=0.1)
        for _ in range(2):
            self.browser.click("#review button", "Remove last corner")
        self.assertEqual(self.browser.run(corners), 0)
        self.assertTrue(
            self.browser.run(
                "return [...document.querySelectorAll('#review button')].find((e) => e.textContent === 'Remove last corner').disabled"
            )
        )
        self.browser.stroke(round_the(CARPET))
        self.browser.wait_text("#review", "m²")
        self.assertEqual(self.browser.run(lengths), [])
        corner = self.browser.run("return window.virtualBorders.draft().points[0]")
        self.browser.tap(corner)
        sides = self.browser.run("""const points = window.virtualBorders.draft().points, last = points[points.length - 1];
            return [points[1], last].map((one) => Math.hypot(one[0] - points[0][0], one[1] - points[0][1]))""")
        np.testing.assert_allclose(sorted(self.browser.run(lengths)), sorted(sides), atol=0.006)
        self.browser.click("#review button", "Cancel")

    def test_3ae_a_wall_with_a_warning_hides_no_name(self):
        with self.small_phone() as small:
            small.click("#wall")
            for point in ([3.2, 3.95], [3.2, 3.1]):  # a doorway
                small.tap(point)
            small.wait_text("#review", sentences.translate("splits_free_space", {}, "en"))
            small.wait_arrived()
            small.run("window.scrollTo(0, 0)")
            for part in ("input", ".issue", ".primary"):
                self.assertTrue(
                    small.run(
                        """const one = document.querySelector(`#review ${arguments[0]}`), box = one.getBoundingClientRect();
                        return [box.top + 2, box.bottom - 2].every(
                            (y) => document.elementFromPoint(box.left + box.width / 2, y) === one)""",
                        part,
                    ),
                    part,
                )

    def test_3af_borders_that_are_not_in_force_look_so(self):
        other_day = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")[(datetime.now().weekday() + 3) % 7]
        for name, fields in (("Always", {}), ("Waits", {"schedule": f"{other_day} 10:00-11:00"}), ("Off", {})):
            self.store_carpet(name, name, **fields)  # all in one place, where one name has room at most
        self.browser.click("#borders li:last-child .switch")
        self.browser.wait_text("#borders", "Switched off")
        self.browser.wait("document.body.classList.contains('marks')", what="marks")
        for selector, properties in (
            ("#world .border", "strokeDasharray"),
            ("#placed .mark", "textDecorationLine strokeDasharray"),
            ("#borders .mark", "textDecorationLine borderTopStyle"),
        ):
            seen = self.browser.run(
                """return [...document.querySelectorAll(arguments[0])].map((one) => [one, ...one.children].map(
                (part) => arguments[1].map((name) => getComputedStyle(part)[name]).join()).join())""",
                selector,
                properties.split(),
            )
            self.assertEqual((len(seen), len(set(seen))), (3, 3), f"{selector}: {seen}")

    def test_3b_a_manager_that_hangs_is_told_with_the_age_of_what_is_shown(self):
        with self.halted_manager(signal.SIGCONT):
            self.assertEqual(self.browser.run("return document.body.dataset.state"), "default")
        self.browser.wait("!document.getElementById('banners').textContent", what="a manager that answers again")

    def test_3c_a_connection_that_is_lost_without_a_word_costs_no_drawing(self):
        self.browser.click("#draw")
        self.browser.stroke(round_the(CARPET))
        self.browser.wait_text("#review", "m²")
        self.browser.run("window.virtualBorders.map.zoom(1.5)")
        view = self.browser.run("return window.virtualBorders.map.view")
        self.page.process.send_signal(signal.SIGSTOP)
        try:
            self.browser.wait("document.body.dataset.state == 'offline'", what="the lost connection")
            self.browser.click("#review button", "Save")
            self.browser.wait_text("#review", "connection is lost")
        finally:
            self.page.process.send_signal(signal.SIGCONT)
        self.browser.wait("document.body.dataset.state == 'default'", what="the connection")
        self.browser.wait_text("#review", "m²")
        self.assertEqual(self.browser.run("return window.virtualBorders.map.view"), view)
        self.assertEqual(self.browser.text("#toast"), "")
        self.browser.click("#review button", "Save")
        self.wait_borders(1)
        self.browser.click("#zoom-fit")

    def test_4_stop_reaches_robots_without_the_manager_and_one_of_them_tells_it(self):
        self.heard.pop(names.STOP, None)
        robot = rospy.Publisher(names.DRIVERS, DriverState, queue_size=1)
        # halted first: killed at once it would be restarted before anybody has missed it
        with self.halted_manager(signal.SIGKILL):
            self.browser.click("#stop")
            wait_until(lambda: names.STOP in self.heard, "stop on its topic")

        def told():
            robot.publish(robot="ada", stops=[self.heard[names.STOP].id])
            return self.heard[names.STATE].stopped

        # roslaunch restarts the manager, and the robot that heard the stop tells it
        wait_until(told, "the manager to know of the stop")
        self.browser.wait_text("#banners", "All robots are stopped")
        self.resume()
        robot.unregister()

    # ------------------------------------------------------------- what is seen
    def test_5_two_browsers_two_sizes_two_languages(self):
        with closing(Browser(self.browser.url, WALL, "de", dark=True)) as other:
            other.wait_ready()
            self.assertEqual(other.run("return document.documentElement.lang"), "de")
            self.store_carpet()
            other.wait_text("#borders", "Rug")
            other.click("#undo", "Rückgängig")
            self.browser.wait_text("#borders", "No borders yet")
            other.wait_text("#borders", "Noch keine Grenzen")
            self.store_carpet("", "Border ")
            other.wait_text("#borders", "Grenze ")
            other.click("#undo", "Rückgängig")
            other.wait_text("#borders", "Noch keine Grenzen")
            notices = NoticePublisher()
            notices.set(
                [
                    Notice("interaction_ends_soon", Severity.WARNING),
                    Notice("robot_caught_in_border", values={"who": sentences.robot_value(""), "border": "Rug"}),
                ]
            )
            self.browser.wait_text("#notices", "discarded soon")
            self.browser.wait_text("#notices", "The robot is inside Rug")
            other.wait_text("#notices", "Der Roboter ist in Rug")
            other.wait("document.querySelector('#notices li')", what="the notice")
            self.assertNotIn("discarded soon", other.text("#notices"))
            notices.close()
            for browser, size in ((self.browser, PHONE), (other, WALL)):
                self.assertLessEqual(browser.run("return document.documentElement.scrollWidth"), size[0])
                self.assertEqual(faults_of(browser), [])
            self.assertEqual(other.faults(), [])

    def test_5a_what_a_tap_brings_up_fits_a_small_phone(self):
        self.store_carpet("The longest name that anybody thought of for a piece of floor", "The longest name")
        with self.small_phone("de") as small:
            small.wait("document.querySelector('#borders .switch')", what="the border")
            self.assertLessEqual(
                small.run("return document.querySelector('#borders .switch').getBoundingClientRect().right"), 360
            )
            within = """const low = document.getElementById('line').getBoundingClientRect().bottom;
                return [...document.querySelectorAll('#dialog > *')].every((one) => {
                const box = one.getBoundingClientRect(); return box.top >= low && box.bottom <= innerHeight; })"""
            small.tap([4.0, 1.4])
            small.wait_text("#dialog", "Ausschalten")
            self.assertTrue(small.run(within))
            small.click("#dialog button", "Zeitplan")
            small.wait_text("#dialog", "Werktage")
            self.assertTrue(small.run(within))
            # on its side too
            small.resize((640, 360))
            self.assertTrue(small.run(within))
            small.click("#dialog button", "Schließen")
            small.tap([4.0, 1.4])
            small.wait_text("#dialog", "Ausschalten")
            self.assertTrue(small.run(within))
            small.click("#dialog button", "Ausschalten")
            small.wait_text("#toast", "Rückgängig")
            self.assertTrue(
                small.run("""const line = document.getElementById('line').getBoundingClientRect();
                const box = document.querySelector('#toast button').getBoundingClientRect();
                return box.right <= line.right && document.querySelector('#toast button').scrollWidth <= box.width""")
            )
            # a button says what one does, and below it the command that one says
            self.assertTrue(
                small.run(
                    """return [...document.querySelectorAll('#commands button')].every((e) =>
                    e.querySelector('small') || e.textContent.toLowerCase() === e.dataset.command)"""  # Pause
                )
            )
            small.click("#commands [data-command=define_border]")
            small.wait_text("#hint", "die Grenze mit dem Laser auf den Boden")
            self.assertEqual(faults_of(small), [])
            small.click("#commands [data-command=cancel]")
            small.wait("document.body.dataset.state == 'default'", what="the state default")
            # a keyboard that shrinks the page covers no field that one types in
            small.click("#draw")
            small.stroke(round_the(CARPET))
            small.wait_text("#review", "m²")
            small.field("#review input[data-key=name]").click()
            small.resize((640, 180))
            small.wait(
                """(() => { const box = document.activeElement.getBoundingClientRect();
                return document.elementFromPoint(box.left + 20, box.top + box.height / 2) === document.activeElement; })()""",
                what="the field that one types in",
            )
            small.resize((640, 360))
            small.click("#review button", "Abbrechen")
            self.assertEqual(small.faults(), [])

    def test_5b_each_robot_has_a_line_and_each_camera_its_picture_below_its_line(self):
        driver = rospy.Publisher(names.DRIVERS, DriverState, queue_size=5)
        detector = rospy.Publisher(names.DETECTORS, DetectorStatus, queue_size=5)
        images = rospy.Publisher("/rostest_page/debug_image", Image, queue_size=1)
        image = Image(height=4, width=4, encoding="mono8", step=4, data=bytes(16))

        def publish(_event):
            driver.publish(DriverState(robot="one", source="navigation", code="obstacle"))
            for camera in ("north", "south"):
                detector.publish(DetectorStatus(camera=camera))
            images.publish(image)

        beat = rospy.Timer(rospy.Duration(0.2), publish)
        self.browser.run("document.getElementById('health').open = true")
        try:
            self.browser.wait_text("#drivers", "one has stopped: something is in its way.")
            self.assertIn("Driven by navigation", self.browser.text("#drivers"))
            for camera in ("south", "north"):
                self.browser.click(f"#cameras [data-key='see {camera}']")
            self.browser.wait(
                "[...document.querySelectorAll('#cameras li')].every((line) => line.querySelector('img').naturalWidth)",
                what="a picture below each line",
            )
            self.browser.click("#cameras [data-key='see north']", "Close")
            self.browser.wait("document.querySelectorAll('#cameras img').length == 1", what="the other picture")
            self.assertEqual(self.browser.run("return document.activeElement.dataset.key"), "see north")
        finally:
            beat.shutdown()
            beat.join()
        self.browser.wait_text("#drivers", "the program that drives it is not responding")
        self.browser.run("document.getElementById('health').open = false")
        self.browser.wait("!document.querySelector('#cameras img')", what="no picture in a closed list")

    def test_6_a_spot_is_seen_and_text_stays_text(self):
        spot = LaserSpot(camera="red")
        spot.header.frame_id, spot.header.stamp = "map", rospy.Time.now()
        spot.position.x, spot.position.y = 4.0, 2.5
        wait_until(lambda: self.spots.get_num_connections(), "the page to listen")
        self.spots.publish(spot)
        self.browser.wait("document.querySelector('.spot')", what="the spot")
        evil = "<img src=x onerror=window.evil=1>"
        self.browser.run("document.getElementById('study').open = true")
        self.browser.field("#mark-form input").send_keys(evil)
        self.browser.click("#mark-form button")
        wait_until(lambda: names.STUDY_EVENTS in self.heard and self.heard[names.STUDY_EVENTS].text == evil, "the note")
        self.browser.wait(
            "document.getElementById('events').textContent.includes(arguments[0])", evil, what="the note in the history"
        )
        self.assertFalse(self.browser.run("return document.querySelectorAll('#events img').length || window.evil || 0"))
        self.assertIn(evil, [json.loads(line)["values"].get("text") for line in self.events.read_text().splitlines()])

    def test_6b_a_picture_that_is_not_there_yet_is_asked_for_again(self):
        """The floor comes from cameras, which may start after the page was opened."""
        self.browser.run("window.virtualBorders.map.picture('floor', 'floor.webp?early')")
        self.browser.wait(
            "performance.getEntriesByType('resource').filter((one) => one.name.endsWith('floor.webp?early')).length > 1",
            what="the second request",
        )
        self.browser.run("window.virtualBorders.map.picture('floor', '')")

    def test_6c_a_robot_in_a_border_is_a_problem_and_a_monitor_that_fell_silent_is_told(self):
        self.restart_page()  # without the cameras and robots of other tests
        self.browser.wait_ready()
        robots = rospy.Publisher(names.ROBOTS, RobotStatusArray, queue_size=1)
        wait_until(robots.get_num_connections, "the page's ear")
        notices = NoticePublisher()
        notices.set([Notice("robot_caught_in_border", Severity.WARNING, values={"who": "$the_robot", "border": "Rug"})])
        ready = RobotStatus(move_base="/move_base", driver=True, localized=True, plans_round_borders=True)
        said = RobotStatusArray(interaction=True, cameras=["red"], robots=[ready])
        self.browser.run("document.getElementById('health').open = true")
        wait_until(
            lambda: robots.publish(said) or self.browser.text("#health-sum") == "1 problem", "the robot in the border"
        )
        self.browser.wait_text("#banners", "robot_monitor has fallen silent")
        self.assertEqual(self.browser.text("#health-sum"), "1 problem")
        notices.close()
        self.browser.wait("!document.getElementById('health-sum').textContent", what="the problem's end")
        self.restart_page()  # which forgets that there was a monitor

    # last: the page that it starts asks every browser for a code
    def test_7_the_page_comes_back_after_it_was_killed_and_in_a_network_asks_for_the_code(self):
        self.store_carpet()
        self.restart_page("_address:=0.0.0.0")
        self.browser.wait(
            "document.querySelector('#login input').getClientRects().length", what="the form for the code"
        )
        # as it was before
        self.assertEqual(self.browser.run("return document.querySelectorAll('#borders li').length"), 1)
        field = self.browser.field("#login input")
        field.send_keys("wrong-code\n")
        self.browser.wait_text("#login-answer", "not a valid code")
        field.clear()
        codes = yaml.safe_load((self.events.parent / "page_codes.yaml").read_text())
        field.send_keys(codes["operator"] + "\n")
        self.browser.wait_ready()
        self.browser.wait_text("#borders", "Rug")
        self.assertIn("Rug was added", self.browser.run("return document.getElementById('events').textContent"))


if __name__ == "__main__":
    rostest.rosrun("vb_web", "rostest_page", PageTest)
