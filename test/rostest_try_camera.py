#!/usr/bin/env python3
"""`make try`: a film's line becomes a border in metres, where the rendering says it is, unattended and by hand."""

import shutil
import sys
import tempfile
import unittest
from contextlib import ExitStack, closing
from pathlib import Path

import rospkg
import rostest
import shapely
import yaml
from scipy.spatial.distance import directed_hausdorff
from phone import WALL, Browser
from vb_testing import run_command, wait_until
from vb_core.errors import CodedError
from vb_core.child_processes import ChildProcess, free_port
from vb_map_integration.border import borders_from_geojson

ROOM = Path(rospkg.RosPack().get_path("vb_bringup")) / "example_video"
TRUTH = yaml.safe_load((ROOM / "room.yaml").read_text())
CARPET = [100 * TRUTH[side] for side in ("width", "depth")]  # [cm]
TRY = ["env", "DISPLAY=", "BROWSER=true", sys.executable, "-m", "vb_bringup.try_camera", "--out"]  # opens no browser
JUDGE = "get('width').value = get('depth').value = 99; corners = arguments[0]; return ask('floor')"
REFUSED = CodedError("bad_rectangle").message
MISSED = (0.8, -0.6), (-0.7, 0.5), (0.4, 0.9), (-0.9, -0.4)  # [px] of the screen, by which a hand misses the corners
# whether the spot that the page shows has gone from near the seed, or from elsewhere
GONE = """Object.values(virtualBorders.map.spots || {}).some((spot) => spot.style.opacity === "0" &&
    Math.hypot(spot.position[0] - arguments[0], spot.position[1] - arguments[1]) %s 0.2)"""
MOMENTS = {  # what somebody who watches the film sees before giving a command
    "define_border": GONE % "<",
    "define_seed": "virtualBorders.view.progress?.closed && " + GONE % ">",
    "save": "virtualBorders.view.progress?.seed.length && " + GONE % "<",
}


class TestTryCamera(unittest.TestCase):
    def assert_drawn(self, folder):
        """Checks the saved border against the film's."""
        (border,) = borders_from_geojson((Path(folder) / "borders.geojson").read_text())
        self.assertTrue(border.closed)
        self.assertLess(directed_hausdorff(TRUTH["border"], border.points)[0], 0.02)
        sides = shapely.LinearRing(TRUTH["border"])  # no point lies off these
        self.assertLess(shapely.distance(sides, shapely.points(border.points)).max(), 0.02)

    def test_the_supplied_film_becomes_a_border_unattended(self):
        with tempfile.TemporaryDirectory() as folder:
            done = run_command(*TRY, folder, "--once", timeout=200)
            self.assertEqual(done.returncode, 0, done.stdout)
            self.assert_drawn(folder)

    def test_a_film_given_as_a_camera_becomes_a_border_by_hand(self):
        port = free_port()
        with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
            film = Path(folder) / "film.mp4"
            command = [*TRY, folder, "--camera", str(film), "--port", str(port)]
            running = ChildProcess(command, Path(folder) / "said.txt")
            stack.callback(running.stop)
            wait_until(lambda: f"check_lab --camera {film}" in running.tail(), "how to describe a missing camera")
            browser = stack.enter_context(closing(Browser(f"http://127.0.0.1:{port}/", WALL)))
            unplugged = CodedError("camera_unplugged", source=str(film), camera="1").message
            self.assertEqual(browser.run(JUDGE, TRUTH["corners"]), {"error": unplugged})
            shutil.copy(str(ROOM / "room.mp4"), str(film))
            left, top, scale = browser.wait("""picture.naturalWidth && (({ left, top, width }) =>
                [left, top, width / picture.naturalWidth])(picture.getBoundingClientRect())""")
            self.assertEqual(browser.run(JUDGE, []), {"error": REFUSED})  # there are no corners
            for (u, v), (right, down) in zip(TRUTH["corners"], MISSED):
                browser.fingers_on_screen([[(left + (u + 0.5) * scale + right, top + (v + 0.5) * scale + down)]])
            for sides, told in (([2000.0, 2000.0], REFUSED), (CARPET, "half a metre apart")):
                browser.run("[get('width').value, get('depth').value] = arguments; judge()", *sides)
                browser.wait("text.textContent.includes(arguments[0])", told)
            self.assertGreater(browser.run("get('start').click(); return lines.length"), 4)
            browser.wait_ready()
            for command, moment in MOMENTS.items():
                browser.wait(moment, *TRUTH["seed"], what=f"the moment to {command}")
                browser.click(f"#commands [data-command={command}]")
            browser.click("#dialog button", "Save")
            wait_until((Path(folder) / "borders.geojson").exists, browser.said)
            self.assert_drawn(folder)


if __name__ == "__main__":
    rostest.rosrun("vb_bringup", "try_camera", TestTryCamera)
