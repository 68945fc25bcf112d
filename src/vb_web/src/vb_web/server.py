"""The web server: one page, its images, and one WebSocket that carries everything else.

The idea: browsers get the view's sections as they change and send requests that `requests.parse` has to accept. No
request
names a file: dictionaries hold what can be fetched. No ROS here; `Backend` carries requests out.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import ssl
import threading
import time
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Set, Tuple

from tornado import web
from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from vb_core import sentences
from vb_core.errors import CodedError, ParameterError
from vb_core.parameters import Parameters, param
from vb_web import access, action_requests
from vb_web.access import AccessCodes, Limiter, LoginLimiter, Role
from vb_web.images import ImageCache
from vb_web.view import View

STATIC = Path(__file__).resolve().parent / "static"
_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
    ".json": "application/json; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".webmanifest": "application/manifest+json",
}
# [s] between two messages to a browser: 25 a second look fluid, and cost 20 browsers little
_SEND_PERIOD = 0.04
_MAX_BROWSERS = 60
_MAX_CONNECTIONS = 250  # below the usual limit of open files, with room for ROS
_MAX_BODY = 2048  # [B] the only body is a code
_MAX_UNDERWAY = 4  # requests of one browser
_TIMEOUT = 5.0  # [s] a command waits so long for the one before it
_MAX_FAULTS = 20  # messages that are no request; then the browser is disconnected


@dataclass(frozen=True)
class ServerParams(Parameters):
    """The server's parameters; config/page.yaml explains them."""

    address: str = param("127.0.0.1")
    port: int = param(8420, "", low=0, high=65535)
    codes_file: str = param("~/.ros/virtual_borders/page_codes.yaml")

    @property
    def certificate(self) -> Optional[Tuple[Path, Path]]:
        """The files page.crt and page.key beside the codes, for https towards a network; None if there are none.

        Raises:
            ParameterError: if there is only one of the two: a person who made one does not want http.
        """
        if access.is_loopback(self.address):
            return None
        files = tuple(Path(self.codes_file).expanduser().with_name(name) for name in ("page.crt", "page.key"))
        there = [path.exists() for path in files]
        if any(there) and not all(there):
            raise ParameterError("codes_file", f"{files[0]} and {files[1]} go together: one of them is missing")
        return files if all(there) else None  # type: ignore[return-value]

    @property
    def scheme(self) -> str:
        """Scheme of the page's address: http or https."""
        return "https" if self.certificate else "http"


@dataclass(frozen=True)
class Backend:
    """The functions that the server calls; called from threads, they may take seconds.

    Attributes:
        act: carries a request of somebody out; its answer has ok, code, values, message. A `CodedError` is the
            same as an answer that is not ok.
        bounds: where points may be; None without a map.
        camera_jpeg: the newest image of a camera with its detections; None if there is none. The name is not checked.
        floor_webp: the floor as the ceiling cameras see it; None if none does.
    """

    act: Callable[[action_requests.Request, str], Dict[str, Any]]
    bounds: Callable[[], Optional[action_requests.Bounds]]
    camera_jpeg: Callable[[str], Optional[bytes]]
    floor_webp: Callable[[], Optional[bytes]]


def _refusal(error: CodedError) -> Dict[str, Any]:
    values = {key: str(value) for key, value in error.values.items()}
    return {"ok": False, "code": error.code, "values": values, "message": error.message}


class PageServer:
    """Serves the page from its own thread.

    Args:
        keys: None only for loopback addresses: every user of this computer is an operator.
        on_fault: called once with the error that ended the server's thread.
    """

    def __init__(
        self,
        params: ServerParams,
        keys: Optional[AccessCodes],
        view: View,
        images: ImageCache,
        backend: Backend,
        on_fault: Callable[[BaseException], None],
    ) -> None:
        self.params, self.keys, self.view, self.images, self.backend = params, keys, view, images, backend
        self.logins = LoginLimiter()
        self.requests = Limiter(rate=40.0, burst=120.0)
        self.browsers: Set[_LinkHandler] = set()
        self.pool = ThreadPoolExecutor(max_workers=4, thread_name_prefix="page")
        self.image_pool = ThreadPoolExecutor(max_workers=2, thread_name_prefix="page_images")
        self.stop_pool = ThreadPoolExecutor(max_workers=2, thread_name_prefix="page_stop")  # stop does not wait
        self.answers: "OrderedDict[Tuple[str, str], asyncio.Future]" = OrderedDict()
        self.files = {path.name: (path.read_bytes(), _TYPES[path.suffix]) for path in STATIC.iterdir()}
        for language in sentences.languages():
            words = {**sentences.catalog(), **sentences.catalog(language)}
            self.files[f"words/{language}.json"] = (
                json.dumps(words, ensure_ascii=False).encode("utf-8"),
                _TYPES[".json"],
            )
        self.port = 0
        self._on_fault = on_fault
        self._started = threading.Event()
        self._failure: Optional[BaseException] = None
        self._loop: Optional[IOLoop] = None
        self._asked = threading.Event()
        self._flushed = 0.0
        self._thread = threading.Thread(target=self._run, name="page_server", daemon=True)

    def start(self) -> None:
        """Begins to listen.

        Raises:
            CodedError: "page_no_address" if the address or port is not available.
        """
        self._thread.start()
        self._started.wait()
        if self._failure is not None:
            raise CodedError(
                "page_no_address", address=self.params.address, port=self.params.port, reason=self._failure
            ) from self._failure
        self.view.on_change = self._ask_for_flush

    def close(self) -> None:
        """Ends the thread and tells the browsers that the server shuts down."""
        self.view.on_change = lambda: None
        if self._loop is not None and self._thread.is_alive():
            self._loop.add_callback(self._loop.stop)
            self._thread.join(timeout=5.0)
        for pool in (self.pool, self.image_pool, self.stop_pool):
            pool.shutdown(wait=False)

    def application(self) -> web.Application:
        """Makes the application with all handlers; also for tests."""
        given = {"page": self}
        routes = [
            (r"/picture/(map|restricted)/([0-9a-f]{16})\.png", _ImageHandler, given),
            (r"/floor\.webp", _FloorHandler, given),
            (r"/camera/([A-Za-z0-9_]{1,40})\.jpg", _CameraHandler, given),
            (r"/session", _SessionHandler, given),
            (r"/login", _LoginHandler, given),
            (r"/logout", _LogoutHandler, given),
            (r"/link", _LinkHandler, given),
            (r"/(|[a-z_.]{1,40}|words/[a-z]{2}\.json)", _FileHandler, given),
        ]
        return web.Application(
            routes,
            default_handler_class=_NotFoundHandler,
            default_handler_args=given,
            log_function=lambda _handler: None,
            websocket_max_message_size=action_requests.MAX_BYTES,
            websocket_ping_interval=15,
            websocket_ping_timeout=45,
        )

    # ------------------------------------------------------------- thread
    def _run(self) -> None:
        asyncio.set_event_loop(asyncio.new_event_loop())
        try:
            loop = IOLoop.current()
            server = self._listen()
            self._loop = loop
        except Exception as error:  # the caller of start raises it
            self._failure = error
            return
        finally:
            self._started.set()
        try:
            loop.start()
            server.stop()
            for browser in list(self.browsers):
                browser.close(1001)
            loop.run_sync(lambda: asyncio.sleep(0.05))
        except BaseException as error:
            self._on_fault(error)
            raise

    def _listen(self) -> HTTPServer:
        context = None
        certificate = self.params.certificate
        if certificate is not None:
            context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
            context.load_cert_chain(*map(str, certificate))
        server = _BoundedServer(
            self.application(),
            page=self,
            ssl_options=context,
            max_header_size=16384,
            max_body_size=_MAX_BODY,
            idle_connection_timeout=30.0,
            body_timeout=5.0,
        )
        server.listen(self.params.port, self.params.address)
        self.port = next(iter(server._sockets.values())).getsockname()[1]
        return server

    # ------------------------------------------------------------- view to browsers
    def _ask_for_flush(self) -> None:
        if self._asked.is_set() or self._loop is None:
            return
        self._asked.set()
        self._loop.add_callback(self._plan_flush)

    def _plan_flush(self) -> None:
        wait = max(0.0, self._flushed + _SEND_PERIOD - time.monotonic())
        self._loop.call_later(wait, self._flush)  # type: ignore[union-attr]

    def _flush(self) -> None:
        self._flushed = time.monotonic()
        self._asked.clear()
        for browser in list(self.browsers):
            browser.pump()

    # ------------------------------------------------------------- browsers' requests
    async def carry_out(self, request: action_requests.Request, browser: str) -> Dict[str, Any]:
        """Carries out a request and returns its answer; a repeated request gets the answer that it got before."""
        key = (browser, request.id)
        answer = self.answers.get(key)
        if answer is None:
            pool = self.stop_pool if request.values.get("command") == "stop" else self.pool
            answer = asyncio.get_event_loop().run_in_executor(pool, self._act, request, f"page {browser[:4]}".strip())
            self.answers[key] = answer
            while len(self.answers) > 300:
                self.answers.popitem(last=False)
        return await asyncio.shield(answer)

    def _act(self, request: action_requests.Request, source: str) -> Dict[str, Any]:
        try:
            return self.backend.act(request, source)
        except CodedError as error:
            return _refusal(error)


class _BoundedServer(HTTPServer):
    """Accepts no more connections than the process can serve."""

    def initialize(self, *args: Any, page: PageServer, **kwargs: Any) -> None:
        super().initialize(*args, **kwargs)
        self._page = page

    def handle_stream(self, stream: Any, address: Any) -> None:
        if len(self._connections) + len(self._page.browsers) >= _MAX_CONNECTIONS:
            stream.close()
            return
        super().handle_stream(stream, address)


# ----------------------------------------------------------------- handlers
class _Guarded:
    """Checks every request before a handler does anything."""

    NEEDS = Role.VIEWER
    page: PageServer
    role: Role
    browser: str

    def initialize(self, page: PageServer) -> None:
        self.page = page
        self.body = b""

    def set_default_headers(self) -> None:
        self.set_header("Server", "virtual_borders")  # type: ignore[attr-defined]
        secure = self.request.protocol == "https"  # type: ignore[attr-defined]
        for name, value in access.security_headers(secure).items():
            self.set_header(name, value)  # type: ignore[attr-defined]

    def prepare(self) -> None:
        request = self.request  # type: ignore[attr-defined]
        if not self.page.requests.allows(request.remote_ip or "", time.monotonic()):
            raise web.HTTPError(429)
        self.role, self.browser = self._identify()
        if request.method not in ("GET", "HEAD") or isinstance(self, WebSocketHandler):
            # also for this computer's own browsers: any page that they show could ask
            if not access.same_origin(request.headers.get("Origin"), request.protocol, request.host):
                raise web.HTTPError(403)
        if self.role < self.NEEDS:
            raise web.HTTPError(403 if self.role else 401)

    def _identify(self) -> Tuple[Role, str]:
        request = self.request  # type: ignore[attr-defined]
        if self.page.keys is not None:
            cookies = request.cookies
            morsel = cookies.get(access.COOKIE)
            return self.page.keys.read_cookie(morsel.value if morsel else None)
        headers = request.headers
        # another host's name that leads here, or a proxy on this computer, is not this computer
        direct = not any(name in headers for name in ("Forwarded", "X-Forwarded-For", "X-Real-Ip", "Via"))
        local = access.is_loopback(access.host_of(request.host)) and access.is_loopback(request.remote_ip or "")
        return (Role.OPERATOR, "") if direct and local else (Role.NOBODY, "")

    def write_error(self, status_code: int, **_kwargs: Any) -> None:
        self.set_header("Content-Type", "application/json")  # type: ignore[attr-defined]
        self.set_header("Cache-Control", "no-store")  # type: ignore[attr-defined]
        self.finish(json.dumps({"ok": False, "status": status_code}))  # type: ignore[attr-defined]

    def log_exception(self, kind: Any, value: Any, trace: Any) -> None:
        if not isinstance(value, web.HTTPError):
            super().log_exception(kind, value, trace)  # type: ignore[misc]


@web.stream_request_body
class _Handler(_Guarded, web.RequestHandler):
    """Reads bodies as bytes: Tornado's form and multipart parsers are never reached."""

    def data_received(self, chunk: bytes) -> None:
        self.body += chunk
        if len(self.body) > _MAX_BODY:
            raise web.HTTPError(413)

    def send(self, data: bytes, kind: str, keep: str = "no-store", tag: bool = False) -> None:
        """Answers with bytes; `tag` lets the browser ask whether they are still the same."""
        self.set_header("Content-Type", kind)
        self.set_header("Cache-Control", keep)
        if tag:
            self.set_header("ETag", f'"{hashlib.blake2b(data, digest_size=8).hexdigest()}"')
            if self.check_etag_header():
                self.set_status(304)
                self.finish()
                return
        self.finish(data)

    def compute_etag(self) -> None:
        return None


class _NotFoundHandler(_Handler):
    NEEDS = Role.NOBODY

    def prepare(self) -> None:
        super().prepare()
        raise web.HTTPError(404)


class _FileHandler(_Handler):
    NEEDS = Role.NOBODY  # the page itself says nothing about the house

    def get(self, name: str) -> None:
        found = self.page.files.get(name or "index.html")
        if found is None:
            raise web.HTTPError(404)
        self.send(*found, keep="no-cache", tag=True)


class _ImageHandler(_Handler):
    def get(self, kind: str, name: str) -> None:
        image = self.page.images.get(kind, name)
        if image is None:
            raise web.HTTPError(404)
        self.send(image.data, "image/png", keep="private, max-age=31536000, immutable")


class _Slow(_Handler):
    """Serves images that have to be made first."""

    NEEDS = Role.OPERATOR

    async def answer(self, kind: str, make: Callable[..., Optional[bytes]], *args: str) -> None:
        data = await asyncio.get_event_loop().run_in_executor(self.page.image_pool, make, *args)
        if data is None:
            raise web.HTTPError(404)
        self.send(data, kind)


class _FloorHandler(_Slow):
    async def get(self) -> None:
        await self.answer("image/webp", self.page.backend.floor_webp)


class _CameraHandler(_Slow):
    async def get(self, camera: str) -> None:
        await self.answer("image/jpeg", self.page.backend.camera_jpeg, camera)


class _LoginHandler(_Handler):
    NEEDS = Role.NOBODY

    def post(self) -> None:
        if self.page.keys is None:
            raise web.HTTPError(404)
        if not self.page.logins.allows(self.request.remote_ip or "", time.monotonic()):
            raise web.HTTPError(429)
        try:
            given = json.loads(self.body.decode("utf-8"))
            code = given["code"] if set(given) == {"code"} and isinstance(given["code"], str) else ""
        except (ValueError, TypeError, RecursionError):
            raise web.HTTPError(400) from None
        role = self.page.keys.role_of(code)
        if role == Role.NOBODY:
            raise web.HTTPError(401)
        self.set_cookie(
            access.COOKIE,
            self.page.keys.make_cookie(role),
            expires_days=access.COOKIE_DAYS,
            httponly=True,
            secure=self.request.protocol == "https",
            samesite="Strict",
        )
        self.send(b'{"ok":true}', "application/json")


class _SessionHandler(_Handler):
    """Sends a browser its role, which a failed WebSocket does not."""

    NEEDS = Role.NOBODY

    def get(self) -> None:
        found = {"role": self.role.name.lower(), "login": self.page.keys is not None}
        self.send(json.dumps(found).encode("ascii"), "application/json")


class _LogoutHandler(_Handler):
    NEEDS = Role.NOBODY

    def post(self) -> None:
        self.clear_cookie(access.COOKIE)
        self.send(b'{"ok":true}', "application/json")


class _LinkHandler(_Guarded, WebSocketHandler):
    """One browser."""

    def prepare(self) -> None:
        super().prepare()
        if len(self.page.browsers) >= _MAX_BROWSERS:
            raise web.HTTPError(503)

    def check_origin(self, origin: str) -> bool:
        return access.same_origin(origin, self.request.protocol, self.request.host)

    def open(self, *_args: str) -> None:
        self.set_nodelay(True)
        self._sent = 0
        self._sending = False
        self._faults = 0
        self._underway = 0
        self._command: Optional[asyncio.Future] = None
        self._asks = Limiter(rate=10.0, burst=40.0)
        self.page.browsers.add(self)
        hello = {
            "role": self.role.name.lower(),
            "languages": sentences.languages(),
            "login": self.page.keys is not None,
        }
        self._tell({"hello": hello})
        self.pump()

    def on_close(self) -> None:
        self.page.browsers.discard(self)

    def pump(self) -> None:
        """Sends what this browser has not seen, unless it is still receiving the previous message."""
        if not self._sending:
            self._sending = True
            asyncio.ensure_future(self._pump())

    async def _pump(self) -> None:
        try:
            while True:
                self._sent, text = self.page.view.since(self._sent)
                if not text:
                    return
                await self.write_message(text)
                await asyncio.sleep(_SEND_PERIOD)
        except WebSocketClosedError:
            pass
        finally:
            self._sending = False

    def _tell(self, message: Dict[str, Any]) -> None:
        try:
            self.write_message(json.dumps(message, ensure_ascii=False, allow_nan=False, separators=(",", ":")))
        except WebSocketClosedError:
            pass

    async def on_message(self, message: Any) -> None:
        request: Optional[action_requests.Request] = None
        try:
            if not self._asks.allows("", time.monotonic()):
                raise CodedError("page_too_fast")
            request = action_requests.parse(message, self.page.backend.bounds())
            if self.role < Role.OPERATOR:
                raise CodedError("page_viewer_only")
        except CodedError as error:
            self._faults += 1
            request_id = request.id if request else getattr(error, "request_id", "")
            self._tell({"re": request_id, **_refusal(error)})
            if self._faults >= _MAX_FAULTS:
                self.close(1008)
            return
        urgent = request.values.get("command") == "stop"
        if self._underway >= _MAX_UNDERWAY and not urgent:
            self._tell({"re": request.id, **_refusal(CodedError("page_too_fast"))})
            return
        # the next message is read meanwhile: stop does not wait, other commands only for this browser's last one
        before = self._command if request.action == "command" and not urgent else None
        answering = asyncio.ensure_future(self._answer(request, before))
        if request.action == "command":
            self._command = answering

    async def _answer(self, request: action_requests.Request, before: Optional[asyncio.Future]) -> None:
        self._underway += 1
        try:
            if before is not None:
                await asyncio.wait([before], timeout=_TIMEOUT)
            answer = await self.page.carry_out(request, self.browser)
        except Exception:
            self._tell({"re": request.id, **_refusal(CodedError("internal_error"))})
            raise
        finally:
            self._underway -= 1
        self._tell({"re": request.id, **answer})


def addresses(params: ServerParams, port: int, own: List[str]) -> List[str]:
    """Returns the page's addresses, the most useful first.

    Args:
        own: this computer's addresses in the network.
    """
    hosts = own if params.address in ("0.0.0.0", "::", "") else [params.address]
    return [f"{params.scheme}://{f'[{host}]' if ':' in host else host}:{port}/" for host in hosts]
