"""A page's server that listens on loopback, with a stand-in for all that it would ask other nodes for."""

import asyncio
import contextlib
import json
import socket
import threading

from tornado.httpclient import AsyncHTTPClient, HTTPRequest
from tornado.websocket import websocket_connect

from vb_core.errors import CodedError
from vb_core.rate_limiter import RateLimiter
from vb_web import access_control
from vb_web.page_images import EncodedImage, ImageCache
from vb_web.page_view import PageView
from vb_web.server import PageParams, PageServer

CODES = {"viewer": "view-er22", "operator": "oper-at33"}
BOUNDS = (0.0, 0.0), (8.0, 5.0)


class FakeBackend:
    """Records the requests that it gets."""

    def __init__(self):
        self.done, self.previews = [], []
        self.arrived = threading.Semaphore(0)
        self.gate = threading.Event()
        self.gate.set()

    def carry_out(self, request, source):
        if request.action == "preview":
            self.previews.append(source)
            self.arrived.release()
            self.gate.wait(60.0)
        if request.action == "remove":
            raise CodedError("page_no_border")
        self.done.append((request.action, dict(request.values)))
        return {"ok": True, "code": "ok", "values": {}, "message": ""}

    def command(self, request, source):
        answered = asyncio.get_event_loop().create_future()
        answered.set_result(self.carry_out(request, source))
        return answered

    def camera_jpeg(self, camera):
        return b"jpeg" if camera == "red" else None

    def floor_webp(self):
        return b"webp"


class Running:
    """A server that listens on loopback."""

    def __init__(self, sessions, params=PageParams(port=0)):
        self.backend = FakeBackend()
        self.view = PageView()
        self.images = ImageCache()
        self.faults = []
        self.images.put("map", EncodedImage(b"png", "a" * 16, 1))
        self.view.put("state", {"name": "default"})
        parts = {"view": self.view, "images": self.images, "actions": self.backend, "cameras": self.backend}
        self.server = PageServer(params, sessions, **parts, find_bounds=lambda: BOUNDS, on_fault=self.faults.append)
        # all requests come from one address: limits are tested separately
        self.server.request_limiter = self.server.connection_limiter = RateLimiter(rate=1e9, burst=1e9)
        self.server.start()
        self.host = f"127.0.0.1:{self.server.port}"

    def ask(self, path, method="GET", body=None, scheme="http", options=None, **headers):
        async def fetch():
            extra = {"headers": {key.replace("_", "-"): value for key, value in headers.items()}, **(options or {})}
            request = HTTPRequest(f"{scheme}://{self.host}{path}", method, body=body, follow_redirects=False, **extra)
            request.allow_nonstandard_methods = True
            return await AsyncHTTPClient(force_instance=True).fetch(request, raise_error=False)

        return asyncio.run(fetch())

    async def connect(self, **headers):
        all_headers = {"Origin": f"http://{self.host}", **headers}
        return await websocket_connect(HTTPRequest(f"ws://{self.host}/link", headers=all_headers))

    def socket(self, **how):
        """Opens a plain TCP connection to the server."""
        return socket.create_connection(("127.0.0.1", self.server.port), **how)

    def link(self, work, **headers):
        """Runs work(connection) over a WebSocket; returns its result."""

        async def run():
            connection = await self.connect(**headers)
            try:
                return await work(connection)
            finally:
                connection.close()

        return asyncio.run(run())


@contextlib.contextmanager
def serving(*given):
    running = Running(*given)
    try:
        yield running
    finally:
        running.server.close()
    assert not running.faults


def cookie(running, role):
    return f"{access_control.COOKIE}={running.server.sessions.open(CODES[role.name.lower()])}"


def log_in(running, code, **headers):
    all_headers = {"Origin": f"http://{running.host}", **headers}
    return running.ask("/session", "POST", json.dumps({"code": code}), **all_headers)
