#!/usr/bin/env python3
"""What people see on the page: languages, sizes, robots and cameras, and missing parts of the lab or its server."""

import signal
from contextlib import closing

import rospy
import rostest
import yaml
from sensor_msgs.msg import Image

from page_rig import PageTest, draw_carpet, run_script
from phone import PHONE, WALL, Browser
from vb_testing import wait_until
from vb_core import names, sentences
from vb_core.notices import Notice, Severity
from vb_core.ros.notices import NoticePublisher
from vb_msgs.msg import DetectorStatus, DriverState, LaserSpot, RobotStatus, RobotStatusArray


class SeenTest(PageTest):
    def test_browsers_show_the_same_in_their_languages(self):
        with closing(Browser(self.browser.url, WALL, "de", dark=True)) as second_browser:
            second_browser.wait_ready()
            self.assertEqual(second_browser.run("return document.documentElement.lang"), "de")
            self.store_carpet()
            second_browser.wait_text("#borders", "Rug")
            second_browser.click("#undo", "Rückgängig")
            self.browser.wait_text("#borders", "No borders yet")
            second_browser.wait_text("#borders", "Noch keine Grenzen")
            self.store_carpet("", "Border ")
            second_browser.wait_text("#borders", "Grenze ")
            second_browser.click("#undo", "Rückgängig")
            second_browser.wait_text("#borders", "Noch keine Grenzen")
            notices = NoticePublisher()
            in_rug = {"who_code": "the_robot", "border": "Rug"}
            in_unnamed = {"who": "ada", "border_code": "border_without_name"}
            caught = [Notice("robot_caught_in_border", values=values) for values in (in_rug, in_unnamed)]
            notices.set([Notice("interaction_ends_soon", Severity.WARNING), *caught])
            self.browser.wait_text("#notices", "discarded soon")
            self.browser.wait_text("#notices", "The robot is inside Rug")
            second_browser.wait_text("#notices", "Der Roboter ist in Rug")
            second_browser.wait_text("#notices", sentences.translate("border_without_name", {}, "de"))
            self.assertNotIn("discarded soon", second_browser.text("#notices"))
            notices.close()
            for browser, size in ((self.browser, PHONE), (second_browser, WALL)):
                self.assertLessEqual(browser.run("return document.documentElement.scrollWidth"), size[0])
                self.assertEqual(run_script(browser, "findFaults"), [])
            self.assertEqual(second_browser.faults(), [])

    def test_dialog_and_undo_fit_a_small_phone(self):
        self.store_carpet("The longest name that anybody thought of for a piece of floor", "The longest name")
        with self.small_phone("de") as small:
            small.wait("document.querySelector('#borders .switch')", what="the border")
            self.assertLessEqual(small.boxes("#borders .switch")[0]["right"], 360)
            small.tap([4.0, 1.4])
            small.wait_text("#dialog", "Ausschalten")
            self.assert_dialog_fits(small, height=640)
            small.resize((640, 360))
            self.assert_dialog_fits(small, height=360)
            small.click("#dialog button", "Schließen")
            small.tap([4.0, 1.4])
            small.wait_text("#dialog", "Ausschalten")
            self.assert_dialog_fits(small, height=360)
            small.click("#dialog button", "Ausschalten")
            small.wait_text("#toast", "Rückgängig")
            (undo,), (line,) = small.boxes("#toast button"), small.boxes("#line")
            self.assertLessEqual(undo["right"], line["right"])
            self.assertLessEqual(small.run("return document.querySelector('#toast button').scrollWidth"), undo["width"])

    def assert_dialog_fits(self, browser, height):
        """Asserts that each part of the dialog is seen below the banners, in a window of this height [px]."""
        (line,) = browser.boxes("#line")
        for box in browser.boxes("#dialog > *"):
            self.assertGreaterEqual(box["top"], line["bottom"])
            self.assertLessEqual(box["bottom"], height)

    def test_a_button_shows_its_spoken_command(self):
        with self.small_phone("de") as small:
            small.resize((640, 360))
            self.assertEqual(run_script(small, "commandsWithoutWords"), [])
            small.click("#commands [data-command=define_border]")
            small.wait_text("#hint", "die Grenze mit dem Laser auf den Boden")
            self.assertEqual(run_script(small, "findFaults"), [])
            small.click("#commands [data-command=cancel]")
            small.wait("document.body.dataset.state == 'default'", what="the state default")

    def test_a_keyboard_does_not_cover_its_field(self):
        with self.small_phone("de") as small:
            small.resize((640, 360))
            draw_carpet(small)
            small.field("#review input[data-key=name]").click()
            small.resize((640, 180))  # the keyboard takes the rest
            wait_until(lambda: run_script(small, "isFocusInView"), "the field in view")
            small.resize((640, 360))
            small.click("#review button", "Abbrechen")

    def test_each_robot_has_a_line_and_each_camera_a_picture(self):
        driver = rospy.Publisher(names.DRIVERS, DriverState, queue_size=5)
        detector = rospy.Publisher(names.DETECTORS, DetectorStatus, queue_size=5)
        images = rospy.Publisher("/camera_of_the_test/debug_image", Image, queue_size=1)
        image = Image(height=4, width=4, encoding="mono8", step=4, data=bytes(16))

        def publish(_event):
            driver.publish(DriverState(robot="one", source="navigation", code="obstacle"))
            for camera in ("north", "south"):
                detector.publish(DetectorStatus(camera=camera, detector="/camera_of_the_test"))
            images.publish(image)

        beat = rospy.Timer(rospy.Duration(0.2), publish)
        self.browser.run("document.getElementById('health').open = true")
        try:
            self.browser.wait_text("#drivers", "one has stopped: something is in its way.")
            self.assertIn("Driven by navigation", self.browser.text("#drivers"))
            for camera in ("south", "north"):
                self.browser.click(f"#cameras [data-key='see {camera}']")
            has_image = "(line) => line.querySelector('img').naturalWidth"
            all_have_images = f"[...document.querySelectorAll('#cameras li')].every({has_image})"
            self.browser.wait(all_have_images, what="a picture below each line")
            self.browser.click("#cameras [data-key='see north']", "Close")
            self.browser.wait("document.querySelectorAll('#cameras img').length == 1", what="the other picture")
            self.assertEqual(self.browser.run("return document.activeElement.dataset.key"), "see north")
        finally:
            beat.shutdown()
            beat.join()
        self.browser.wait_text("#drivers", "the program that drives it is not responding")
        self.browser.run("document.getElementById('health').open = false")
        self.browser.wait("!document.querySelector('#cameras img')", what="no picture in a closed list")

    def test_a_missing_picture_is_asked_for_again(self):
        """The floor comes from cameras, which may start after the page was opened."""
        self.browser.run("window.virtualBorders.map.showPicture('floor', 'floor.webp?early')")
        requests = "performance.getEntriesByType('resource').filter(({ name }) => name.endsWith('floor.webp?early'))"
        self.browser.wait(f"{requests}.length > 1", what="the second request")
        self.browser.run("window.virtualBorders.map.showPicture('floor', '')")

    def test_a_floor_switched_off_stays_off(self):
        self.assertEqual(run_script(self.browser, "switchFloorOff"), ["true", "false", "false"])
        self.browser.driver.refresh()

    def test_a_map_with_another_origin_is_shown_in_its_place(self):
        moved = "const { map } = virtualBorders; map.setMap({ ...map.info, origin: [50, 0, 0] }); return map.view.x"
        self.assertGreater(self.browser.run(moved), 50)
        self.browser.driver.refresh()

    def test_a_spot_is_seen(self):
        spot = LaserSpot(camera="red")
        spot.header.frame_id = "map"
        spot.header.stamp = rospy.Time.now()
        spot.position.x, spot.position.y = 4.0, 2.5
        wait_until(lambda: self.spots.get_num_connections(), "the page to listen")
        self.spots.publish(spot)
        self.browser.wait("document.querySelector('.spot')", what="the spot")

    def test_text_stays_text(self):
        evil = "<img src=x onerror=window.evil=1>"
        self.store_carpet(evil, evil)
        self.browser.wait("document.getElementById('events').textContent.includes(arguments[0])", evil, what="event")
        self.assertFalse(self.browser.run("return document.querySelectorAll('#borders img, #events img').length"))
        self.assertFalse(self.browser.run("return window.evil"))

    # ------------------------------------------------------------- missing parts
    def test_a_lost_connection_keeps_the_drawing(self):
        draw_carpet(self.browser)
        self.browser.run("window.virtualBorders.map.zoom(1.5)")
        view = self.browser.run("return window.virtualBorders.map.view")
        run_script(self.browser, "hurryAndCountTries")
        self.page.process.send_signal(signal.SIGSTOP)
        try:
            self.browser.wait("document.body.dataset.state == 'offline'", what="the lost connection")
            self.browser.click("#review button", "Save")
            self.browser.wait_text("#review", "connection is lost")
            self.browser.wait("window.asked > 1", what="another try after one that nobody answers")
        finally:
            self.page.process.send_signal(signal.SIGCONT)
        self.browser.wait("document.body.dataset.state == 'default'", what="the connection")
        self.browser.wait_text("#review", "m²")
        self.assertEqual(self.browser.run("return window.virtualBorders.map.view"), view)
        self.assertEqual(self.browser.text("#toast"), "")
        self.browser.click("#review button", "Save")
        self.wait_borders(1)
        self.browser.driver.refresh()

    def test_a_caught_robot_and_a_silent_monitor_are_problems(self):
        self.restart_page()  # which forgets the cameras and robots of other tests
        self.browser.wait_ready()
        robots = rospy.Publisher(names.ROBOTS, RobotStatusArray, queue_size=1)
        wait_until(robots.get_num_connections, "the page's ear")
        notices = NoticePublisher()
        notices.set([Notice.of_robot("", "robot_caught_in_border", Severity.WARNING, border="Rug")])
        ready = RobotStatus(move_base="/move_base", driver=True, localized=True, plans_round_borders=True)
        message = RobotStatusArray(interaction=True, cameras=["red"], robots=[ready])
        self.browser.run("document.getElementById('health').open = true")
        wait_until(lambda: robots.publish(message) or self.browser.text("#health-sum") == "1 problem", "the problem")
        self.browser.wait_text("#banners", "robot_monitor has fallen silent")
        self.assertEqual(self.browser.text("#health-sum"), "1 problem")
        notices.close()
        self.browser.wait("!document.getElementById('health-sum').textContent", what="the problem's end")
        self.restart_page()  # which forgets that there was a monitor

    def test_a_restarted_page_asks_for_the_code(self):
        self.store_carpet()
        self.restart_page("_address:=0.0.0.0")
        # for later tests, which have no code: parameters stay on the server
        self.addCleanup(self.restart_page, "_address:=127.0.0.1")
        self.browser.wait("document.querySelector('#login input').getClientRects().length", what="the login form")
        # the list is as it was before
        self.assertEqual(self.browser.run("return document.querySelectorAll('#borders li').length"), 1)
        field = self.browser.field("#login input")
        self.browser.run("window.ask = fetch; window.fetch = () => Promise.reject()")
        field.send_keys("wrong-code\n")
        self.browser.wait_text("#login-answer", "no answer")
        self.browser.run("window.fetch = window.ask")
        field.send_keys("\n")
        self.browser.wait_text("#login-answer", "not a valid code")
        field.clear()
        field.send_keys(yaml.safe_load(self.codes.read_text())["operator"] + "\n")
        self.browser.wait_ready()
        self.browser.wait_text("#borders", "Rug")


if __name__ == "__main__":
    rostest.rosrun("vb_web", "rostest_page_seen", SeenTest)
