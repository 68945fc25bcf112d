"""The fixture of the page's tests: the page in a real browser, with the real nodes behind it."""

import unittest
from contextlib import closing, contextmanager
from pathlib import Path

import rospy
from geometry_msgs.msg import Point

from phone import Browser
from vb_testing import Process, is_listening, listen, wait_until
from vb_core import names
from vb_core.child_processes import free_port
from vb_msgs.msg import InteractionState, LaserSpot, Stop, VirtualBorder, VirtualBorderArray
from vb_msgs.srv import AddBorder, RemoveBorder

SCRIPTS = "".join(path.read_text(encoding="utf-8") for path in Path(__file__).parent.glob("*.js"))
CARPET = [[3.12, 0.8], [5.12, 0.8], [5.12, 2.05], [3.12, 2.05]]


def overlap(first, second, tolerance=0.0):
    """Returns whether two of `Browser.boxes` overlap by more than a tolerance [px]."""
    across = min(first["right"], second["right"]) - max(first["left"], second["left"])
    down = min(first["bottom"], second["bottom"]) - max(first["top"], second["top"])
    return min(across, down) > tolerance


def run_script(browser, name, *arguments):
    """Runs a function of the JavaScript files beside this one in the page, and returns its result."""
    return browser.run(f"{SCRIPTS} return {name}(...arguments)", *arguments)


def draw_carpet(browser):
    """Draws a border that can be saved."""
    browser.click("#draw")
    browser.stroke([*CARPET, (3.12, 1.0)])  # back to near its start
    browser.wait_text("#review", "m²")


class PageTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("page_test")
        cls.heard = listen({names.BORDERS: VirtualBorderArray, names.STATE: InteractionState, names.STOP: Stop})
        cls.spots = rospy.Publisher(names.SPOTS, LaserSpot, queue_size=5)
        cls.port = free_port()
        cls.codes = Path(rospy.get_param("~state")) / "page_codes.yaml"
        cls.page = None
        cls.start_page()
        cls.addClassCleanup(lambda: cls.page.stop())
        cls.browser = Browser(f"http://127.0.0.1:{cls.port}/")
        cls.addClassCleanup(cls.browser.close)

    @classmethod
    def start_page(cls, *arguments):
        node_arguments = (f"_port:={cls.port}", f"_codes_file:={cls.codes}", *arguments)
        cls.page = Process("vb_web", "page", "__name:=page", *node_arguments)
        wait_until(lambda: is_listening(cls.port), "the page to listen")

    def setUp(self):
        if self.browser.run("return document.body.dataset.mode != 'look' || document.getElementById('dialog').open"):
            self.browser.driver.refresh()  # a failed test leaves nothing behind
        self.browser.wait_ready()
        wait_until(self.remove_borders, "a page without borders")
        self.browser.faults()  # discards those of other tests
        # a banner that disappears moves the map
        self.browser.wait("!document.getElementById('banners').textContent", what="a page with nothing to say")

    def tearDown(self):
        self.assertEqual(self.browser.faults(), [])

    def borders(self):
        message = self.heard.get(names.BORDERS)
        return list(message.borders) if message else []

    def remove_borders(self):
        """Removes the borders heard of on the topic; returns whether there is none any more, there and on the page."""
        for border in self.borders():
            rospy.ServiceProxy(names.REMOVE_BORDER, RemoveBorder)(id=border.id, source="test")
        is_shown = self.browser.run("return Boolean(document.querySelector('#borders .name'))")
        return names.BORDERS in self.heard and not self.borders() and not is_shown

    def wait_borders(self, count):
        wait_until(lambda: names.BORDERS in self.heard and len(self.borders()) == count, f"{count} borders")
        return self.borders()

    def store_carpet(self, name="Rug", shown="Rug"):
        """Stores a border past the page, for a test that only needs one."""
        border = VirtualBorder(name=name, kind=VirtualBorder.POLYGON, enabled=True, occupancy=1.0)
        border.points = [Point(x, y, 0.0) for x, y in CARPET]
        border.seed = Point(4.0, 1.5, 0.0)
        answer = rospy.ServiceProxy(names.ADD_BORDER, AddBorder)(border=border, frame_id="map", source="test")
        self.assertTrue(answer.success, answer.message)
        self.browser.wait_text("#borders", shown)
        # the next test's setUp removes only borders heard of on the topic
        wait_until(lambda: answer.id in [border.id for border in self.borders()], "the border on its topic")

    def resume(self):
        self.browser.click("#resume", "Resume")
        wait_until(lambda: not self.heard[names.STATE].stopped, "go on")

    @contextmanager
    def small_phone(self, *options, **more):
        """Opens the page in another browser, of 360 x 640 px."""
        with closing(Browser(self.browser.url, (360, 640), *options, **more)) as small:
            small.wait_ready()
            yield small
            self.assertEqual(small.faults(), [])

    def restart_page(self, *arguments):
        """Kills the page node, which forgets all that it has heard, and starts it again."""
        self.page.kill()
        self.browser.wait("document.body.dataset.state == 'offline'", what="the lost connection")
        self.start_page(*arguments)
