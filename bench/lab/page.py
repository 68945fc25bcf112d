#!/usr/bin/env python3
"""What the page costs and withstands: 20 browsers while somebody draws, spot to page, large maps, hostile messages.

    python3 bench/lab/page.py cost          20 browsers' links: share of a core, time from a spot's stamp to the message
    python3 bench/lab/page.py browser       the same time up to the picture in a real browser
    python3 bench/lab/page.py large         a map of 4000 x 4000 cells: pictures, bytes, frames a second in a real
                                        browser, and 20 browsers' links
    python3 bench/lab/page.py hostile       10,000 malformed or hostile messages and requests against the real nodes
    python3 bench/lab/page.py axe FILE      axe-core (its axe.min.js) on the page in both sizes, light and dark
    python3 bench/lab/page.py pictures DIR  screenshots to be looked at: both sizes and languages, dark, no spot seen, stopped
    python3 bench/lab/page.py carpet        a border round the carpet of the simulated lab, from opening the page to saved: on a
                                        phone in English, on a wall display in German; makes the pictures in docs/images/page

Each starts a roscore and the nodes that it needs on free ports of loopback, stops by itself, and appends a line to
docs/results/lab/page.md.
"""

from __future__ import annotations

import argparse
import asyncio
import base64
import contextlib
import json
import os
import random
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections import Counter
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import psutil

from vb_evaluation.provenance import revision

TOP = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(TOP / "src" / "vb_web" / "test"))
RESULTS = TOP / "docs" / "results" / "lab" / "page.md"
BROWSERS, SECONDS, SPOTS_HZ = 20, 30.0, 75  # three cameras of 25 images a second
LAUNCH = """<launch>
  {map}
  <node pkg="vb_map_integration" type="map_integrator" name="map_integrator" output="log">
    <param name="database_dir" value="{state}/borders"/><param name="map_dir" value="{state}/maps"/></node>
  <node pkg="vb_voice_wizard" type="interaction_manager" name="interaction_manager" output="log">
    <param name="log_file" value="{state}/i.jsonl"/><param name="state_file" value="{state}/s.json"/></node>
  <node pkg="vb_web" type="page" name="page" output="log">
    <param name="port" value="{port}"/><param name="events_file" value="{state}/e.jsonl"/></node>
</launch>"""
LAB_MAP = f'<node pkg="vb_sim" type="map_server" name="map_server"><param name="world" value="{TOP}/src/vb_sim/worlds/lab.yaml"/></node>'


def start(stack, lab=True, simulation=False):
    """Starts roscore and nodes, or the whole simulated lab without a display; returns (page's port, state folder)."""
    from vb_evaluation.processes import Child, free_port

    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="bench_page_")))
    master, port = free_port(), free_port()
    os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{master}"
    os.environ["ROS_LOG_DIR"] = str(folder / "log")
    launch = folder / "bench.launch"
    launch.write_text(LAUNCH.format(map=LAB_MAP if lab else "", state=folder, port=port))
    simulated = [str(TOP / "launch" / "simulation.launch"), "rviz:=false", f"state:={folder}", f"page_port:={port}"]
    stack.callback(
        Child(["roslaunch", "-p", str(master), *(simulated if simulation else [str(launch)])], folder / "out.txt").stop
    )
    import rosgraph
    import rospy

    wait(rosgraph.is_master_online, "the master")
    rospy.init_node("bench_page", anonymous=True, disable_signals=True, log_level=rospy.ERROR)
    import socket

    wait(lambda: socket.socket().connect_ex(("127.0.0.1", port)) == 0, "the page")
    rospy.wait_for_service("/virtual_borders/command", 60)
    return port, folder


def wait(condition, what, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise SystemExit(f"waited {seconds:g} s for {what}")
        time.sleep(0.05)


def page_pid():
    import xmlrpc.client

    import rospy

    wait(lambda: rospy.get_master().lookupNode("/page")[0] == 1, "the page at the master")
    uri = rospy.get_master().lookupNode("/page")[2]
    return xmlrpc.client.ServerProxy(uri).getPid("/bench")[2]


def cpu_seconds(pid):
    return sum(psutil.Process(pid).cpu_times()[:2])


class Pointer:
    """A moving spot by three cameras and a line that grows, as while a border is drawn."""

    def __init__(self):
        import rospy

        from vb_core import names
        from vb_msgs.msg import BorderProgress, InteractionState, LaserSpot

        self._types = (BorderProgress, InteractionState, LaserSpot)
        self._spots = rospy.Publisher(names.SPOTS, LaserSpot, queue_size=10, tcp_nodelay=True)
        self._progress = rospy.Publisher(names.PROGRESS, BorderProgress, queue_size=1)
        wait(lambda: self._spots.get_num_connections() and self._progress.get_num_connections(), "the page to listen")

    def run(self, seconds):
        """Draws for a time; 75 spots and 5 progress messages a second."""
        import rospy
        from geometry_msgs.msg import Point

        Progress, _, Spot = self._types
        began, points = time.monotonic(), []
        for number in range(int(seconds * SPOTS_HZ)):
            pause = began + number / SPOTS_HZ - time.monotonic()
            if pause > 0:
                time.sleep(pause)
            angle = number / 400.0
            spot = Spot(camera=("red", "green", "blue")[number % 3])
            spot.header.frame_id, spot.header.stamp = "map", rospy.Time.now()
            spot.position.x, spot.position.y = 4.0 + 2.0 * np.cos(angle), 2.5 + 1.5 * np.sin(angle)
            self._spots.publish(spot)
            if number % 15 == 0:
                points = (points + [Point(spot.position.x, spot.position.y, 0.0)])[-300:]
                message = Progress(points=points, chain=points, cameras=["red"], border_spots=number)
                message.header.frame_id = "map"
                self._progress.publish(message)


async def listen(port, until, stamps, sizes):
    from tornado.httpclient import HTTPRequest
    from tornado.websocket import websocket_connect

    request = HTTPRequest(f"ws://127.0.0.1:{port}/link", headers={"Origin": f"http://127.0.0.1:{port}"})
    link = await websocket_connect(request)
    seen = {}
    while time.monotonic() < until:
        try:
            text = await asyncio.wait_for(link.read_message(), max(0.05, until - time.monotonic()))
        except asyncio.TimeoutError:
            break
        if text is None:
            raise SystemExit("the page hung up")
        now = time.time()
        sizes.append(len(text))
        for camera, spot in json.loads(text).get("view", {}).get("spots", {}).items():
            if spot[3] > seen.get(camera, 0.0):
                seen[camera] = spot[3]
                stamps.append(now - spot[3])
    link.close()


LISTENER = "import sys; sys.path[:0] = {path!r}; import page; page.listen_many({port}, {count}, {seconds})"


def listen_many(port, count, seconds):
    """Runs in a separate process: what these browsers cost is not the page's. Prints delays [s] and bytes as JSON."""
    stamps, sizes, until = [], [], time.monotonic() + seconds

    async def run():
        await asyncio.gather(*(listen(port, until, stamps, sizes) for _ in range(count)))

    asyncio.run(run())
    print(json.dumps([stamps, sum(sizes), len(sizes)]))


def drawing_state():
    """Brings the real manager to the state border: lines are shown in it."""
    from vb_core.ros.commands import make_request, send

    send(make_request("define_border", "bench", 10.0))


def links(port, counts):
    """Measures what so many browsers' links cost while somebody draws, one line for each number of them."""
    from vb_evaluation.processes import spawn

    drawing_state()
    pointer, pid, lines = Pointer(), page_pid(), []
    for count in counts:
        script = LISTENER.format(path=[str(TOP / "bench" / "lab")], port=port, count=count, seconds=SECONDS + 2)
        ears = spawn([sys.executable, "-c", script], stdout=subprocess.PIPE, universal_newlines=True)
        time.sleep(2.0)
        before, began = cpu_seconds(pid), time.monotonic()
        pointer.run(SECONDS)
        share = (cpu_seconds(pid) - before) / (time.monotonic() - began)
        delays, size, messages = json.loads(ears.communicate(timeout=60)[0])
        told = ""
        if delays:
            median, late = np.percentile(np.array(delays) * 1000.0, [50, 95])
            told = f"; spot's stamp to message {median:.0f} ms, 95 % {late:.0f} ms (n = {len(delays)})"
            told += (
                f"; {size / count / SECONDS / 1000:.1f} kB/s and {messages / count / SECONDS:.0f} messages/s for each"
            )
        lines.append(f"{count} browsers: {share:.3f} core{told}")
    return lines


def cost():
    with ExitStack() as stack:
        port, _ = start(stack)
        return links(port, (1, BROWSERS))


def browser():
    from phone import PHONE, Browser

    with ExitStack() as stack:
        port, _ = start(stack)
        page = Browser(f"http://127.0.0.1:{port}/", PHONE)
        stack.callback(page.close)
        page.wait_ready()
        page.run("""window.delays = []; const map = window.virtualBorders.map, set = map.setSpots.bind(map);
            map.setSpots = (spots) => { set(spots); const newest = Math.max(...Object.values(spots).map((s) => s[3]));
              requestAnimationFrame(() => requestAnimationFrame(() => window.delays.push(Date.now() / 1000 - newest))) }""")
        Pointer().run(15.0)
        delays = np.array(page.run("return window.delays")) * 1000.0
        median, late = np.percentile(delays, [50, 95])
        return [
            f"spot's stamp to the frame that shows it, headless Chromium on the same two cores: "
            f"{median:.0f} ms, 95 % {late:.0f} ms (n = {len(delays)})"
        ]


def large():
    import rospy
    from phone import PHONE, Browser

    from vb_core import names
    from vb_core.grid_map import GridMap
    from vb_core.ros.messages import OccupancyGridArray, message_from_grid

    with ExitStack() as stack:
        port, _ = start(stack, lab=False)
        draw = np.random.default_rng(1)
        data = np.zeros((4000, 4000), np.int8)
        for _ in range(400):
            row, column = draw.integers(0, 3900, 2)
            data[row : row + draw.integers(2, 300), column : column + draw.integers(2, 6)] = 100
        data[:, :4] = data[:, -4:] = data[:4] = data[-4:] = 100
        publisher = rospy.Publisher(names.PHYSICAL_MAP, OccupancyGridArray, queue_size=1, latch=True)
        publisher.publish(message_from_grid(GridMap(data, 0.025), rospy.Time.now()))
        began = time.monotonic()
        page = Browser(f"http://127.0.0.1:{port}/", PHONE)
        stack.callback(page.close)
        page.wait_ready()
        shown = time.monotonic() - began
        size = page.run(
            """return performance.getEntriesByType("resource")
               .filter((e) => e.name.includes("picture/map")).map((e) => e.encodedBodySize)[0]"""
        )
        frames = page.driver.execute_async_script("""const done = arguments[0], map = window.virtualBorders.map;
            let n = 0; const began = performance.now();
            map.zoom(4); const step = () => { n++; map.view.x += .2; map.touched = true; map.lay();
              performance.now() - began < 5000 ? requestAnimationFrame(step) : done(n / 5) }; step()""")
        rss = (
            int(
                next(
                    line for line in Path(f"/proc/{page_pid()}/status").read_text().splitlines() if "VmHWM" in line
                ).split()[1]
            )
            / 1024
        )
        page.driver.get("about:blank")
        told = (
            f"4000 x 4000 cells: browser started to map shown {shown:.1f} s, picture {size / 1000:.0f} kB, "
            f"{frames:.0f} frames/s while it is moved (software rendering), page's highest memory {rss:.0f} MB"
        )
        return [told, *(f"4000 x 4000 cells, {line}" for line in links(port, (BROWSERS,)))]


HOSTILE_PATHS = [
    "/",
    "/../../etc/passwd",
    "/picture/map/" + "a" * 16 + ".png",
    "/camera/x.jpg",
    "/words/%s.json",
    "/link",
    "/login",
    "/" + "A" * 3000,
    "/%00",
    "/floor.webp?" + "x" * 500,
]


async def send_hostile_messages(port, texts):
    """Sends texts over WebSockets; returns how many were sent."""
    from tornado.httpclient import HTTPRequest
    from tornado.websocket import WebSocketClosedError, websocket_connect

    sent = 0
    while texts:
        link = await websocket_connect(
            HTTPRequest(f"ws://127.0.0.1:{port}/link", headers={"Origin": f"http://127.0.0.1:{port}"})
        )
        with contextlib.suppress(WebSocketClosedError):
            for _ in range(25):  # the server hangs up after 20 faults
                if texts:
                    await link.write_message(texts.pop().encode("utf-8", "replace"), binary=random.random() < 0.1)
                    sent += 1
        link.close()
        await asyncio.sleep(0.03)  # else the limit of requests answers instead of what is tested
    return sent


def send_hostile_requests(port, count):
    """Sends HTTP requests as from elsewhere; returns how many got each status, 0 for none."""
    import http.client

    draw, answers = random.Random(3), Counter()
    for _ in range(count):
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
        headers = {
            "Host": draw.choice(["evil.example", "127.0.0.1.evil", "", "localhost:1"]),
            "Origin": draw.choice(["null", "http://evil.example"]),
            "Cookie": "virtual_borders_page="
            + "".join(chr(draw.randrange(33, 126)) for _ in range(draw.randrange(300))),
            "X-Forwarded-For": "127.0.0.1",
        }
        method = draw.choice(["GET", "POST", "PUT", "DELETE", "OPTIONS", "TRACE"])
        path, body = draw.choice(HOSTILE_PATHS), draw.choice([None, "{}", "x" * 3000])
        try:
            connection.request(method, path, body=body, headers=headers)
            answers[connection.getresponse().status] += 1
        except (OSError, http.client.HTTPException):
            answers[0] += 1
        connection.close()
        time.sleep(0.02)
    return answers


def hostile():
    import rospy
    from hostile import hostile_messages

    from vb_core import names
    from vb_core.errors import CodedError
    from vb_msgs.msg import InteractionState
    from vb_msgs.srv import ListBorders
    from vb_web import action_requests

    bounds = action_requests.Bounds((-0.2, -0.2), (8.2, 5.2))

    def is_request(text):
        try:
            action_requests.parse(text, bounds)
        except CodedError:
            return False
        return True

    with ExitStack() as stack:
        port, folder = start(stack)
        pid, state, file = page_pid(), {}, folder / "e.jsonl"
        listing = rospy.ServiceProxy(names.LIST_BORDERS, ListBorders)
        rospy.Subscriber(names.STATE, InteractionState, lambda message: state.__setitem__("now", message))
        wait(lambda: "now" in state, "the state")

        def kept():
            history = file.read_text() if file.exists() else ""  # it is made with the first event
            return listing().borders.revision, state["now"].last_command, history

        before = kept()
        texts = [text for text in hostile_messages(7600, seed=11) if not is_request(text)][:7000]
        total = len(texts)
        sent = asyncio.run(send_hostile_messages(port, texts))
        answers = send_hostile_requests(port, 3000)
        after, alive = kept(), page_pid() == pid
        return [
            f"{sent} of {total} hostile messages over WebSockets as an operator, {sum(answers.values())} requests from elsewhere "
            f"(answers {dict(sorted(answers.items()))}): page alive with the same process: {alive}, "
            f"borders, commands and history unchanged: {before == after}"
        ]


def axe(path):
    from phone import PHONE, WALL, Browser

    source, lines = Path(path).read_text(encoding="utf-8"), []
    run = "axe.run(document).then((r) => arguments[0](r.violations.map((v) => `${v.impact}: ${v.id}`)))"
    with ExitStack() as stack:
        port, _ = start(stack)
        for size in (PHONE, WALL):
            for language in ("en", "de"):
                page = Browser(f"http://127.0.0.1:{port}/", size, language)
                found = {}
                for dark in (False, True):
                    page.resize(size, dark)
                    page.driver.refresh()
                    page.wait_ready()
                    page.run("document.querySelectorAll('details').forEach((e) => { e.open = true })")
                    for view, opener in (("main view", None), ("drawing", "#draw"), ("dialog", "#settings-button")):
                        if opener:
                            page.click(opener)
                        page.driver.execute_script(source)
                        faults = page.driver.execute_async_script(run)
                        if faults:
                            found[f"{'dark' if dark else 'light'}, {view}"] = faults
                page.close()
                lines.append(
                    f"axe-core, {size[0]} x {size[1]}, {language}, light and dark, main view, drawing, dialog: {found or 'no violation'}"
                )
    return lines


def pictures(folder):
    import rospy
    from geometry_msgs.msg import Point
    from phone import PHONE, WALL, Browser

    from vb_core import names, sentences
    from vb_core.ros.commands import make_request, send
    from vb_msgs.msg import VirtualBorder
    from vb_msgs.srv import AddBorder

    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        port, _ = start(stack)
        add = rospy.ServiceProxy(names.ADD_BORDER, AddBorder)
        add.wait_for_service(60.0)
        for name, x, y, schedule in (
            ("Rug under the dining table", 3.1, 0.8, ""),
            ("K\u00fcche \u53a8\u623f", 1.0, 3.2, "mon-fri 08:00-12:30"),
        ):
            corners = [Point(x, y, 0), Point(x + 1.6, y, 0), Point(x + 1.6, y + 1.1, 0), Point(x, y + 1.1, 0)]
            border = VirtualBorder(
                name=name,
                kind=VirtualBorder.POLYGON,
                enabled=True,
                occupancy=1.0,
                points=corners,
                seed=Point(x + 0.8, y + 0.5, 0),
                schedule=schedule,
            )
            add(border=border, frame_id="map", source="bench")
        for language in ("en", "de"):
            for size, kind in ((PHONE, "phone"), (WALL, "wall")):
                page = Browser(f"http://127.0.0.1:{port}/", size, language)
                try:
                    page.wait_ready()
                    page.wait("document.querySelectorAll('#borders li').length == 2")

                    def take(view):
                        page.run("window.scrollTo(0, 0)")
                        height = page.run("return document.documentElement.scrollHeight")
                        clip = {"x": 0, "y": 0, "width": size[0], "height": min(height, 2400), "scale": 1}
                        found = page.driver.execute_cdp_cmd(
                            "Page.captureScreenshot", {"captureBeyondViewport": True, "clip": clip}
                        )
                        (target / f"{kind}_{language}_{view}.png").write_bytes(base64.b64decode(found["data"]))

                    take("ready")
                    page.resize(size, True)
                    take("dark")
                    page.resize(size)
                    send(make_request("define_border", "bench", 10.0))
                    page.wait_text("body", sentences.translate("spot_not_seen_check_laser", {}, language))
                    take("unseen")
                    send(make_request("save", "voice", 10.0))
                    page.wait_text("#laser", sentences.translate("missing_spots", {}, language))
                    take("missing")
                    send(make_request("stop", "bench", 10.0))
                    page.wait("document.body.classList.contains('stopped')")
                    take("stopped")
                    send(make_request("resume", "bench", 10.0))
                    send(make_request("cancel", "bench", 10.0))
                finally:
                    page.close()
    return [f"{len(list(target.glob('*.png')))} screenshots"]


def has_floor(port):
    """Returns whether the page has a picture of the floor: the cameras run."""
    with contextlib.suppress(OSError):
        return urllib.request.urlopen(f"http://127.0.0.1:{port}/floor.webp", timeout=30).status == 200


def carpet():
    from phone import PHONE, WALL, Browser

    from vb_sim.room.world import load_world

    world = load_world(TOP / "src" / "vb_sim" / "worlds" / "lab.yaml")
    corners = next(patch for patch in world.patches if patch.name == "carpet").footprint()
    sides = zip(corners, np.roll(corners, -1, axis=0))
    stroke = np.vstack([np.linspace(*side, 6, endpoint=False) for side in sides]).tolist()
    lines = []
    with ExitStack() as stack:
        port, _ = start(stack, simulation=True)
        wait(lambda: has_floor(port), "the cameras")
        for kind, size, language, name, none in (
            ("phone", PHONE, "en", "Rug", "No borders yet"),
            ("wall", WALL, "de", "Teppich", "Noch keine Grenzen"),
        ):
            began = time.monotonic()
            page = Browser(f"http://127.0.0.1:{port}/", size, language, dark=kind == "wall")

            def take():
                clip = {"x": 0, "y": 0, "width": size[0], "height": size[1], "scale": 0.75}
                found = page.driver.execute_cdp_cmd(
                    "Page.captureScreenshot", {"format": "jpeg", "quality": 85, "clip": clip}
                )
                (TOP / "docs" / "images" / "page" / f"{kind}.jpg").write_bytes(base64.b64decode(found["data"]))

            try:
                page.wait_ready()
                page.wait("document.getElementById('floor').classList.contains('there')", what="the carpet")
                page.click("#draw")
                page.stroke(stroke)
                page.wait_text("#review", "m\u00b2")
                if kind == "phone":
                    page.run("window.scrollTo(0, 0)")
                    take()
                page.field("#review input[data-key=name]").send_keys(name)
                page.click("#review .primary")
                page.wait_text("#borders", name)
                seconds = time.monotonic() - began
                if kind == "wall":
                    page.wait("!document.getElementById('toast').textContent")
                    page.click("#health summary")
                    page.wait_text("#cameras", "robot")
                    page.run("document.getElementById('panel').scrollTo(0, 0)")
                    take()
                page.click("#undo")
                page.wait_text("#borders", none)
            finally:
                page.close()
            lines.append(
                f"the carpet of the simulated lab, {size[0]} x {size[1]}, {language}: opened, drawn with a finger, named, saved "
                f"after {seconds:.0f} s; by a program, which need not read or think"
            )
    return lines


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("cost", "browser", "large", "hostile", "axe", "pictures", "carpet"))
    parser.add_argument("file", nargs="?")
    given = parser.parse_args()
    lines = globals()[given.what](*([given.file] if given.what in ("axe", "pictures") else []))
    if given.what == "pictures":
        print(*lines)
        return
    made_by = revision()
    load = os.getloadavg()[0]
    RESULTS.parent.mkdir(parents=True, exist_ok=True)
    if not RESULTS.exists():
        RESULTS.write_text(
            "# The page: measurements\n\nAppended by `bench/lab/page.py`, newest last, bad rows included. "
            "Two cores; `load` is that of the whole machine.\n\n"
            "| command | date, revision, load | result |\n|---|---|---|\n"
        )
    with open(str(RESULTS), "a") as file:
        for line in lines:
            print(line)
            file.write(
                f"| `bench/lab/page.py {given.what}` | {time.strftime('%Y-%m-%d %H:%M')}, {made_by}, {load:.1f} | {line} |\n"
            )


if __name__ == "__main__":
    main()
