"""Chromium as a phone or a wall display, for the tests of the page; needs Debian's packages chromium, chromium-driver
and python3-selenium."""

import contextlib
import math

from selenium import webdriver
from selenium.common.exceptions import ElementClickInterceptedException, StaleElementReferenceException
from selenium.webdriver.chrome.service import Service
from vb_testing import TIMEOUT, wait_until

PHONE, WALL = (360, 740), (1920, 1080)
_SWITCHES = "no-sandbox headless=new disable-gpu disable-background-networking disable-dev-shm-usage".split()
_SWITCHES += "hide-scrollbars disable-extensions no-first-run".split()

# in messages of the console about a server that is down, a picture that a camera lacks yet, and a wrong code
_NO_FAULTS = "ERR_CONNECTION", "WebSocket", "/floor.webp", "/camera/", "/session"


class Browser:
    """A browser with the page open."""

    def __init__(self, url, size=PHONE, language="en", dark=False, mobile=False):
        options = webdriver.ChromeOptions()
        options.binary_location = "/usr/bin/chromium"
        for switch in (*_SWITCHES, f"lang={language}"):
            options.add_argument(f"--{switch}")
        options.add_experimental_option("prefs", {"intl.accept_languages": language})
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        self.driver = webdriver.Chrome(service=Service("/usr/bin/chromedriver"), options=options)
        self.driver.set_script_timeout(TIMEOUT)
        self.url = url
        self.mobile = mobile  # whether two fingers enlarge the page
        self.resize(size, dark)
        self.driver.get(url)

    def resize(self, size, dark=False):
        phone = size[0] < 800
        metrics = {"width": size[0], "height": size[1], "deviceScaleFactor": 2 if phone else 1, "mobile": self.mobile}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})
        self.driver.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True})

    def close(self):
        self.driver.quit()

    def run(self, script, *arguments):
        return self.driver.execute_script(script, *arguments)

    def wait(self, script, *arguments, what=None):
        """Waits until a script returns a true value, and returns that."""
        return wait_until(
            lambda: self.run(f"return ({script})", *arguments),
            lambda: f"{what or script}; the page says: {self.said()}",
        )

    def said(self):
        """Returns the page's text on one line, the most urgent last: a report of failed tests keeps the end."""
        parts = "\n".join(self.text(part) for part in ("main", "#dialog", "#toast", "#banners"))
        return " | ".join(line for line in parts.splitlines() if line.strip())

    def wait_ready(self):
        """Waits until the map is shown and fitted, and the system's state is known."""
        has_map = "window.virtualBorders && window.virtualBorders.map.info"
        has_state = "document.body.dataset.state == 'default'"
        shows_map = "document.getElementById('base').classList.contains('there')"
        self.wait(f"{has_map} && {has_state} && {shows_map}", what="a page that is ready")

    def click(self, selector, text=None):
        """Clicks the first enabled element of a selector, with this text if one is given."""
        script = """[...document.querySelectorAll(arguments[0])].find(
            (e) => !e.disabled && e.getClientRects().length && (!arguments[1] || e.textContent.trim() === arguments[1]))"""
        for _ in range(10):
            element = self.wait(script, selector, text, what=f"{selector} {text or ''}")
            self.wait_arrived()  # it may only just have appeared
            # an update from the nodes may have replaced it, or blocks its surroundings for a moment
            with contextlib.suppress(StaleElementReferenceException, ElementClickInterceptedException):
                self.run("arguments[0].scrollIntoView({block: 'center'})", element)
                element.click()
                return
        raise AssertionError(f"cannot be pressed: {selector} {text or ''}; the page says: {self.said()}")

    def wait_arrived(self):
        """Waits until elements that have just appeared, or were below a dialog that has just closed, can be pressed."""
        parts = "[...document.querySelectorAll('main, #line, #panel, #dialog')]"
        take_events = f"{parts}.every((e) => getComputedStyle(e).pointerEvents !== 'none')"
        self.wait(f"{take_events} && document.querySelector('main').inert === document.getElementById('dialog').open")

    def field(self, selector):
        """Returns a field to type into, with the focus, so that the page keeps it, and with the caret at its end."""
        self.wait_arrived()
        script = """const field = document.querySelector(arguments[0]);
            field.focus();
            if (field.type === "text") field.setSelectionRange(field.value.length, field.value.length);
            return field"""
        return self.run(script, selector)

    def text(self, selector):
        return self.run("const e = document.querySelector(arguments[0]); return e ? e.innerText : ''", selector)

    def wait_text(self, selector, part):
        text = "(document.querySelector(arguments[0]) || {innerText: ''}).innerText"
        self.wait(f"{text}.includes(arguments[1])", selector, part, what=f"'{part}' in {selector}")

    def on_screen(self, point):
        """Returns the position on the screen [px] of a point of the floor [m]."""
        return self.run(
            """const b = document.getElementById('map').getBoundingClientRect();
            const p = window.virtualBorders.map.toScreen(arguments[0]); return [Math.round(b.left + p[0]), Math.round(b.top + p[1])]""",
            point,
        )

    def boxes(self, selector):
        """Returns the bounding box [px] of each shown element of a selector, a dictionary with left, top, right, bottom."""
        script = "return [...document.querySelectorAll(arguments[0])].map((e) => e.getBoundingClientRect().toJSON())"
        return [box for box in self.run(script, selector) if box["width"]]

    def stroke(self, points):
        """Moves a finger over points of the floor [m] by touch events: it may also scroll, and a tap clicks."""
        self.wait_arrived()
        self.run("document.getElementById('map').scrollIntoView({block: 'center'})")
        corners = [self.on_screen(point) for point in points]
        places = [corners[0]]
        for (x0, y0), (x1, y1) in zip(corners, corners[1:]):
            steps = max(1, round(math.hypot(x1 - x0, y1 - y0) / 8))
            places += [(x0 + (x1 - x0) * step / steps, y0 + (y1 - y0) * step / steps) for step in range(1, steps + 1)]
        self.fingers_on_screen([[place] for place in places])

    def fingers(self, steps, lift=True):
        """Puts fingers on points of the floor [m], a list of them for each step."""
        self.fingers_on_screen([[self.on_screen(point) for point in step] for step in steps], lift)

    def fingers_on_screen(self, steps, lift=True):
        """Puts fingers on points of the screen [px], a list of them for each step."""
        count = 0
        for step in steps:
            positions = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(step)]
            self._touch("touchStart" if len(step) > count else "touchMove", positions)
            count = len(step)
        if lift:
            self.lift()

    def lift(self):
        """Takes all fingers away."""
        self._touch("touchEnd", [])

    def _touch(self, kind, fingers):
        self.driver.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": fingers})

    def tap(self, point):
        """Taps a point of the floor [m]."""
        self.stroke([point])

    def faults(self):
        """Returns the page's own faults in the browser's console."""
        severe = [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] == "SEVERE"]
        return [text for text in severe if not any(part in text for part in _NO_FAULTS)]
