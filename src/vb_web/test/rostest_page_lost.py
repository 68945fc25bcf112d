#!/usr/bin/env python3
"""What the page tells when a part of the lab, or its own server, is away."""

from __future__ import annotations

import signal

import rospy
import rostest
import yaml

from page_rig import PageTest, draw_carpet
from vb_testing import wait_until
from vb_core import names
from vb_core.notices import Notice, Severity
from vb_core.ros.notices import NoticePublisher
from vb_msgs.msg import RobotStatus, RobotStatusArray


class LostTest(PageTest):
    def test_a_connection_that_is_lost_without_a_word_costs_no_drawing(self):
        draw_carpet(self.browser)
        self.browser.run("window.virtualBorders.map.zoom(1.5)")
        view = self.browser.run("return window.virtualBorders.map.view")
        self.browser.run("""const wait = window.setTimeout, ask = window.fetch;
            window.asked = 0;
            window.setTimeout = (work, time) => wait(work, time === 8000 ? 2000 : time);
            window.fetch = (...given) => ask(...given, ++window.asked)""")
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

    def test_robot_in_a_border_and_a_silent_monitor_are_problems(self):
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

    def test_killed_page_comes_back_and_asks_for_the_code(self):
        self.store_carpet()
        self.restart_page("_address:=0.0.0.0")
        self.addCleanup(self.restart_page)  # for the tests after it, which have no code
        self.browser.wait(
            "document.querySelector('#login input').getClientRects().length", what="the form for the code"
        )
        # as it was before
        self.assertEqual(self.browser.run("return document.querySelectorAll('#borders li').length"), 1)
        field = self.browser.field("#login input")
        self.browser.run("window.ask = fetch; window.fetch = () => Promise.reject()")
        field.send_keys("wrong-code\n")
        self.browser.wait_text("#login-answer", "no answer")
        self.browser.run("window.fetch = window.ask")
        field.send_keys("\n")
        self.browser.wait_text("#login-answer", "not a valid code")
        field.clear()
        codes = yaml.safe_load(self.codes.read_text())
        field.send_keys(codes["operator"] + "\n")
        self.browser.wait_ready()
        self.browser.wait_text("#borders", "Rug")


if __name__ == "__main__":
    rostest.rosrun("vb_web", "rostest_page_lost", LostTest)
