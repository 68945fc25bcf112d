#!/usr/bin/env python3
"""Stop, Resume and the other commands on the page."""

import os
import signal

import numpy as np
import rospy
import rostest

from page_rig import PageTest, overlap, run_script
from phone import PHONE, WALL
from vb_testing import process_of, wait_until
from vb_core import names
from vb_msgs.msg import DriverState


class StopTest(PageTest):
    def test_commands_go_on_after_a_stop(self):
        self.browser.click("#commands button", "Define border")
        self.browser.wait("document.body.dataset.state == 'border'", what="the state border")
        self.browser.click("#settings-button")  # stop can be reached even while a dialog is open
        self.browser.click("#stop")
        wait_until(lambda: self.heard[names.STATE].stopped and names.STOP in self.heard, "stop")
        self.browser.wait_text("#banners", "All robots are stopped")
        self.browser.run("window.scrollTo(0, 300)")  # the banner is seen wherever the page is scrolled
        self.assertGreaterEqual(self.browser.boxes("#banners")[0]["top"], 0)
        self.browser.run("window.scrollTo(0, 0)")
        # the banner shows the stop of all robots, so neither the answer nor a notice repeats it
        self.browser.wait("document.getElementById('toast').dataset.code == 'stopped'", what="the answer")
        self.browser.wait("virtualBorders.view.notices.some(({ code }) => code == 'stopped')", what="the notice")
        self.assertEqual(self.browser.text("#toast"), "")
        self.assertNotIn("topped", self.browser.text("#notices"))
        self.assertEqual(self.browser.text("#state"), "Stopped")
        self.browser.click("#dialog button", "Close")
        self.resume()
        self.browser.wait_text("#toast", "Robots may drive again.")
        self.browser.click("#commands button", "Cancel")
        self.browser.wait("document.body.dataset.state == 'default'", what="the state default")
        # events are sent separately from the state
        events = "window.virtualBorders.view.events.map((event) => event.values.command)"
        self.browser.wait(f"{events}.slice(-1)[0] == 'cancel'", what="the last event")
        self.assertEqual(self.browser.run(f"return {events}")[-4:], ["define_border", "stop", "resume", "cancel"])

    def test_resume_has_a_place_that_nothing_else_ever_has(self):
        self.store_carpet()
        self.browser.click("#stop")
        self.browser.wait("document.body.classList.contains('stopped')", what="the stop")
        (place,) = self.browser.boxes("#resume")

        def check(shown):
            (box,) = self.browser.boxes("#resume")
            self.assertEqual(box, place, shown)
            centre = (box["left"] + box["width"] / 2, box["top"] + box["height"] / 2)
            topmost = self.browser.run("return document.elementFromPoint(...arguments).id", *centre)
            self.assertEqual(topmost, "resume", shown)
            others = self.browser.boxes("#line button, #stop")
            self.assertEqual([other for other in others if overlap(box, other)], [], shown)

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

    def test_stop_keeps_its_place_while_the_page_is_enlarged(self):
        with self.small_phone(mobile=True) as small:
            place_before = run_script(small, "placeOfStop")
            pinch = [[(180 - 10 * step, 500 + 5 * step), (200 + 10 * step, 500 - 5 * step)] for step in range(1, 13)]
            small.fingers_on_screen([pinch[0][:1], *pinch])
            small.wait("visualViewport.scale > 1.5 && visualViewport.offsetTop > 50", what="an enlarged page")
            np.testing.assert_allclose(run_script(small, "placeOfStop"), place_before, atol=1.0)
            self.assertEqual(run_script(small, "buttonOnStop"), "stop")
            small.run("document.getElementById('stop').click()")
            small.wait("document.body.classList.contains('stopped')", what="the stop")
            self.browser.wait_text("#banners", "All robots are stopped")
            # a tap that misses Stop by a thumb's width does not press Resume, which is on the screen as well
            self.assertGreaterEqual(run_script(small, "gapBesideStop"), 24)
            small.driver.execute_cdp_cmd("Emulation.setPageScaleFactor", {"pageScaleFactor": 1})
            small.wait("visualViewport.scale === 1 && !document.getElementById('standing').style.transform")
            for size in ((360, 640), (640, 360), PHONE, WALL):
                small.resize(size)
                self.assertGreaterEqual(run_script(small, "gapBesideStop"), 24, size)
        self.resume()

    def test_stop_reaches_robots_without_the_manager(self):
        self.heard.pop(names.STOP, None)
        robot = rospy.Publisher(names.DRIVERS, DriverState, queue_size=1)
        listen = "new MutationObserver(() => said.push(toast.dataset.code)).observe(toast, { attributes: true })"
        self.browser.run(f"said = []; {listen}")
        manager = process_of("/interaction_manager")
        # halted before it is killed, as otherwise it would be restarted before anybody missed it
        os.kill(manager, signal.SIGSTOP)
        try:
            self.browser.wait_text("#banners", "has not responded for more than 0:0")
            self.assertEqual(self.browser.run("return document.body.dataset.state"), "default")
            self.browser.click("#stop")
            wait_until(lambda: names.STOP in self.heard, "stop on its topic")
        finally:
            os.kill(manager, signal.SIGKILL)
        # roslaunch restarts the manager, and the robot that heard the stop reports it
        report = DriverState(robot="ada", stops=[self.heard[names.STOP].id])
        wait_until(lambda: robot.publish(report) or self.heard[names.STATE].stopped, "the manager to know of the stop")
        self.browser.wait_text("#banners", "All robots are stopped")
        # a command that is given before the stop is answered waits for that answer, and may expire until then
        self.browser.wait("said.some((code) => code.startsWith('stop'))", what="the answer to the stop")
        self.resume()
        robot.unregister()

    def test_nothing_moves_under_a_finger(self):
        parts = "#map, #stop, #settings-button"
        self.browser.run("window.scrollTo(0, 0)")
        layout = self.browser.boxes(parts)
        self.browser.click("#draw")
        self.browser.tap([3.0, 1.0])
        self.browser.run("window.scrollTo(0, 0)")
        self.assertEqual(self.browser.boxes(parts), layout)
        self.browser.click("#review button", "Cancel")
        self.browser.click("#stop")
        self.browser.wait_text("#banners", "All robots are stopped")
        self.browser.run("window.scrollTo(0, 0)")
        self.assertEqual(self.browser.boxes(parts), layout)
        # a second tap on Stop does not press Resume
        self.browser.run("document.getElementById('toast').dataset.code = ''")
        self.browser.click("#stop")
        self.browser.wait("document.getElementById('toast').dataset.code == 'stopped'", what="the second answer")
        self.assertTrue(self.heard[names.STATE].stopped)
        self.resume()

    def test_the_map_stays_in_its_frame(self):
        for swipe in ("pan(-5000, 0)", "pan(0, 5000)", "zoom(3)", "pan(9000, -9000)", "zoom(1 / 9)"):
            self.browser.run(f"window.virtualBorders.map.{swipe}")
            self.assertTrue(run_script(self.browser, "isMapAtCenter"), swipe)
        self.browser.click("#zoom-fit")
        view = "return JSON.stringify(window.virtualBorders.map.view)"
        view_before = self.browser.run(view)
        self.browser.stroke([[4.0, 2.5], [3.0, 2.5], [1.0, 2.5]])  # one finger may only scroll the page
        self.assertEqual(self.browser.run(view), view_before)
        # points beyond the map's edge are moved to the edge
        edge = self.browser.run("return window.virtualBorders.map.onMap([-50, -50])")
        self.assertEqual(self.browser.run("return window.virtualBorders.map.onMap(arguments[0])", edge), edge)


if __name__ == "__main__":
    rostest.rosrun("vb_web", "rostest_page_stop", StopTest)
