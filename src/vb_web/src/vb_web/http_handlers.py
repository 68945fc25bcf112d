"""Answers browsers: files and images by HTTP, and one WebSocket for everything else.

A browser gets the sections of the view as they change, and sends requests, which `action_parser` checks. No request can
name a file on disk, because everything that can be fetched is in dictionaries.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import random
import time
from functools import partial
from typing import Any, Dict, List, Optional, Tuple

from tornado import web
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from vb_core.errors import CodedError
from vb_core.rate_limiter import RateLimiter
from vb_core.request_origin import is_loopback, is_same_origin, parse_host
from vb_web import access_control, action_parser
from vb_web.access_control import Role
from vb_web.page_view import answer_from_error, compact_json

_SEND_PERIOD = 0.04  # [s] between two messages to a browser: 25 a second look fluid, and cost little for 20 browsers
MAX_BODY = 2048  # [B] the only body is a code
_MAX_UNANSWERED = 4  # requests of one browser that are carried out at the same time
_MAX_REFUSED = 20  # refused messages after which a browser is disconnected
_PROXY_HEADERS = ("Forwarded", "X-Forwarded-For", "X-Real-Ip", "Via")


def routes(page: Any) -> List[Tuple]:
    """Lists the handler of each path. `page` is the `server.PageServer`."""
    settings = {"page": page}
    return [
        (r"/picture/(map|restricted)/([0-9a-f]{16})\.png", _ImageHandler, settings),
        (r"/floor\.webp|/camera/([A-Za-z0-9_]{1,40})\.jpg", _CameraHandler, settings),
        (r"/session", _SessionHandler, settings),
        (r"/link", _LinkHandler, settings),
        (r"/(.*)", _FileHandler, settings),
    ]


class _GuardedHandler(web.RequestHandler):
    """Checks every request before a handler does anything."""

    NEEDS = Role.VIEWER
    role: Role
    session: str  # the name of the session, "" for a browser of this computer

    def initialize(self, page: Any) -> None:
        self.page = page
        self.body = b""

    def set_default_headers(self) -> None:
        self.set_header("Server", "virtual_borders")
        for name, value in access_control.security_headers(self.request.protocol == "https").items():
            self.set_header(name, value)

    def prepare(self) -> None:
        request = self.request
        if not self.page.request_limiter.allows(request.remote_ip or "", time.monotonic()):
            raise web.HTTPError(429)
        self.role, self.session = self._identify()
        holders = filter(None, (request.remote_ip, self.session))
        if not self.page.assign_slot(request.connection.stream, self.role, *holders):
            self.set_header("Connection", "close")
            raise web.HTTPError(503)
        if request.method not in ("GET", "HEAD") or isinstance(self, WebSocketHandler):
            # local browsers are checked too, because any page that is open in them could send requests to this one
            if not is_same_origin(request.headers.get("Origin"), request.protocol, request.host):
                raise web.HTTPError(403)
        if self.role < self.NEEDS:
            raise web.HTTPError(403 if self.role else 401)

    def _identify(self) -> Tuple[Role, str]:
        if self.page.sessions is not None:
            return self.page.sessions.find(self.get_cookie(access_control.COOKIE))
        # a request that names another host, or that came through a proxy, is not from this computer
        is_direct = not any(name in self.request.headers for name in _PROXY_HEADERS)
        hosts = (parse_host(self.request.host), self.request.remote_ip or "")
        is_local = is_direct and all(map(is_loopback, hosts))
        role = Role.OPERATOR if is_local else Role.NOBODY
        return role, ""

    def write_error(self, status_code: int, **_kwargs: Any) -> None:
        self.set_header("Content-Type", "application/json")
        self.set_header("Cache-Control", "no-store")
        self.finish(json.dumps({"ok": False, "status": status_code}))

    def log_exception(self, kind: Any, value: Any, trace: Any) -> None:
        if not isinstance(value, web.HTTPError):
            super().log_exception(kind, value, trace)


@web.stream_request_body
class _Handler(_GuardedHandler):
    """Reads bodies as bytes: Tornado's form and multipart parsers are never reached."""

    def data_received(self, chunk: bytes) -> None:
        self.body += chunk
        if len(self.body) > MAX_BODY:
            raise web.HTTPError(413)

    def send(self, data: bytes, kind: str, keep: str = "no-store") -> None:
        """Answers with bytes. Tornado adds an ETag, by which the browser can ask whether they have changed."""
        self.set_header("Content-Type", kind)
        self.set_header("Cache-Control", keep)
        self.finish(data)


class _FileHandler(_Handler):
    NEEDS = Role.NOBODY  # the page's files reveal nothing about the house

    def get(self, name: str) -> None:
        file = self.page.files.get(name or "index.html")
        if file is None:
            raise web.HTTPError(404)
        self.send(*file, keep="no-cache")


class _ImageHandler(_Handler):
    def get(self, kind: str, name: str) -> None:
        image = self.page.images.get(kind, name)
        if image is None:
            raise web.HTTPError(404)
        self.send(image.encoded, "image/png", keep="private, max-age=31536000, immutable")


class _CameraHandler(_Handler):
    """Sends a camera's image, or an image of the floor as all cameras see it. Both are made when they are requested."""

    NEEDS = Role.OPERATOR

    async def get(self, camera: Optional[str]) -> None:
        images = self.page.cameras
        make_image = partial(images.camera_jpeg, camera) if camera else images.floor_webp
        data = await self.page.run_in_turn(self.session, make_image)
        if data is None:
            raise web.HTTPError(404)
        self.send(data, "image/jpeg" if camera else "image/webp")


class _SessionHandler(_Handler):
    """Tells a browser its role (GET), which a refused WebSocket cannot; logs in with a code (POST) and out (DELETE)."""

    NEEDS = Role.NOBODY

    def get(self) -> None:
        status = {"role": self.role.name.lower(), "login": self.page.sessions is not None}
        self.send(json.dumps(status).encode("ascii"), "application/json")

    async def post(self) -> None:
        sessions = self.page.sessions
        if sessions is None:
            raise web.HTTPError(404)
        if not self.page.login_limiter.allows(self.request.remote_ip or "", time.monotonic()):
            raise web.HTTPError(429)
        try:
            fields = json.loads(self.body.decode("utf-8"))
            has_code = set(fields) == {"code"} and isinstance(fields["code"], str)
            code = fields["code"] if has_code else ""
        except (ValueError, TypeError, RecursionError):
            raise web.HTTPError(400) from None
        cookie = await asyncio.get_event_loop().run_in_executor(self.page.pool, sessions.open, code)
        if cookie is None:
            raise web.HTTPError(401)
        self.set_cookie(
            access_control.COOKIE,
            cookie,
            expires_days=access_control.COOKIE_DAYS,
            httponly=True,
            secure=self.request.protocol == "https",
            samesite="Strict",
        )
        self.send(b'{"ok":true}', "application/json")

    async def delete(self) -> None:
        if self.session and self.page.sessions is not None:
            await asyncio.get_event_loop().run_in_executor(self.page.pool, self.page.sessions.end, self.session)
            logged_out = [browser for browser in self.page.browsers if browser.session == self.session]
            for browser in logged_out:
                browser.close(1008)
        self.clear_cookie(access_control.COOKIE)
        self.send(b'{"ok":true}', "application/json")


class _LinkHandler(_GuardedHandler, WebSocketHandler):
    """The WebSocket of one browser."""

    def check_origin(self, origin: str) -> bool:
        return True  # `prepare` has checked the origin, and has refused a request without one

    def open(self, *_args: str) -> None:
        self.set_nodelay(True)
        self._refused = 0  # messages so far
        self._unanswered = 0  # requests that are being carried out
        self._message_limiter = RateLimiter(rate=10.0, burst=40.0)
        self.page.browsers.add(self)
        self._write_json({"hello": self.page.hello(self.role)})
        asyncio.ensure_future(self._send_view())

    def on_close(self) -> None:
        self.page.browsers.discard(self)

    async def _send_view(self) -> None:
        """Sends this browser the changes that it has not received yet, at most one message per _SEND_PERIOD.

        Each viewer is served at a random moment within the period. If all were served at once, an operator's answer
        would have to wait for them.
        """
        revision = 0
        delay = 0.0 if self.role == Role.OPERATOR else random.uniform(0.0, _SEND_PERIOD)
        with contextlib.suppress(WebSocketClosedError):
            while self in self.page.browsers:
                view_changed = self.page.view_changed
                revision, text = self.page.view.changes_since(revision)
                if text:
                    await self.write_message(text)
                    await asyncio.sleep(_SEND_PERIOD - delay)
                else:
                    await view_changed.wait()
                    await asyncio.sleep(delay)

    def _write_json(self, message: Dict[str, Any]) -> None:
        with contextlib.suppress(WebSocketClosedError):
            self.write_message(compact_json(message))

    def on_message(self, message: Any) -> None:
        """Carries out the request in a message, or refuses it. A browser that is refused too often is disconnected."""
        request_id = ""  # is sent with the refusal, if the request has a usable id
        try:
            if not self._message_limiter.allows("", time.monotonic()):
                raise CodedError("page_too_fast")
            request_id, fields = action_parser.parse(message)
            request = action_parser.check(request_id, fields, self.page.find_bounds())
            if self.role < Role.OPERATOR:
                raise CodedError("page_viewer_only")
        except CodedError as error:
            self._refused += 1
            self._write_json({"re": request_id, **answer_from_error(error)})
            if self._refused >= _MAX_REFUSED:
                self.close(1008)
            return
        if self._unanswered >= _MAX_UNANSWERED and request.values.get("command") != "stop":
            self._write_json({"re": request.id, **answer_from_error(CodedError("page_too_fast"))})
            return
        self._unanswered += 1
        # a callback instead of an await, after which this browser would have to wait for all others again
        future = self.page.carry_out(request, self.session)
        future.add_done_callback(partial(self._answer, request))

    def _answer(self, request: action_parser.ActionRequest, future: asyncio.Future) -> None:
        self._unanswered -= 1
        try:
            answer = future.result()
        except Exception:
            self._write_json({"re": request.id, **answer_from_error(CodedError("internal_error"))})
            raise
        self._write_json({"re": request.id, **answer})
