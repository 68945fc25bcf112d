"""The web server: its thread, its connections, and the thread pools that do the work of `http_handlers`. No ROS.

An attacker must not be able to prevent an operator's *stop*. Therefore each role has its own slots for connections
(`access_control.ConnectionSlots`), and a connection that reads or writes too slowly is closed. Slow work has its own
pool, and each person's pieces of slow work are done one after another.
"""

from __future__ import annotations

import asyncio
import json
import socket
import ssl
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Set, Tuple
from weakref import WeakValueDictionary

from tornado import web
from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets

from vb_core import interaction_tables, sentences, zones
from vb_core.errors import CodedError, ParameterError
from vb_core.rate_limiter import RateLimiter
from vb_core.parameters import Parameters, param
from vb_core.request_origin import is_loopback
from vb_web import action_parser, http_handlers
from vb_web.access_control import ConnectionSlots, Role, Sessions
from vb_web.page_images import ImageCache
from vb_web.page_view import PageView, answer_from_error

STATIC = Path(__file__).resolve().parent / "static"
_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
    ".json": "application/json; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".webmanifest": "application/manifest+json",
}
# numbers of connections; their sum is below the usual limit of open files, and leaves room for those of ROS
_SLOTS = {Role.NOBODY: 64, Role.VIEWER: 80, Role.OPERATOR: 60}
_PATIENCE = 10.0  # [s] for a request's headers, a handshake, or the next request
_SEND_PATIENCE = 20  # [s] for a browser to receive sent data


@dataclass(frozen=True)
class PageParams(Parameters):
    """Parameters of the page; config/page.yaml explains them."""

    address: str = param("127.0.0.1")
    port: int = param(8420, "", low=0, high=65535)
    codes_file: str = param("~/.ros/virtual_borders/page_codes.yaml")
    cameras: list = param([])
    image_transport: str = param("raw", choices=("raw", "compressed"))

    def __post_init__(self) -> None:
        super().__post_init__()
        if not all(isinstance(name, str) and name for name in self.cameras):
            raise ParameterError("cameras", f"expected names, got {self.cameras!r}")

    @property
    def certificate(self) -> Optional[Tuple[Path, Path]]:
        """The files page.crt and page.key beside the codes, for https in a network, or None if there are none.

        Raises:
            ParameterError: if only one of them exists: whoever created it does not want to serve the page by http.
        """
        if is_loopback(self.address):
            return None
        codes_file = Path(self.codes_file).expanduser()
        certificate = codes_file.with_name("page.crt")
        key = codes_file.with_name("page.key")
        if certificate.exists() != key.exists():
            raise ParameterError("codes_file", f"{certificate} and {key} go together: one of them is missing")
        return (certificate, key) if certificate.exists() else None


class PageServer:
    """Serves the page from its own thread.

    Args:
        sessions: None only for loopback addresses, where every user of this computer is an operator.
        actions: an `action_executor.ActionExecutor`. Its methods may take seconds, and are called in the pools' threads.
        cameras: a `camera_images.CameraImages`. Its methods may take seconds too.
        find_bounds: returns the map's bounds, for checking points, or None if there is no map.
        on_fault: called once with the error that ended the server's thread.
    """

    def __init__(
        self,
        params: PageParams,
        sessions: Optional[Sessions],
        view: PageView,
        images: ImageCache,
        actions: Any,
        cameras: Any,
        find_bounds: Callable[[], Optional[action_parser.Bounds]],
        on_fault: Callable[[BaseException], None],
    ) -> None:
        self.params = params
        self.sessions = sessions
        self.view = view
        self.images = images
        self.actions = actions
        self.cameras = cameras
        self.find_bounds = find_bounds
        self.login_limiter = RateLimiter(rate=5.0 / 60.0, burst=5.0)
        self.request_limiter = RateLimiter(rate=40.0, burst=120.0)
        self.connection_limiter = RateLimiter(rate=5.0, burst=100.0)
        self.slots = {role: ConnectionSlots(size, yields=role == Role.NOBODY) for role, size in _SLOTS.items()}
        self.browsers: Set[Any] = set()  # the open WebSockets' handlers
        self.pool = ThreadPoolExecutor(max_workers=16, thread_name_prefix="page")
        self.slow_pool = ThreadPoolExecutor(max_workers=2, thread_name_prefix="page_slow")
        self._turns: "WeakValueDictionary[str, asyncio.Lock]" = WeakValueDictionary()  # by person
        self._answers: Dict[Tuple[str, str], asyncio.Future] = {}  # by (person, request's id), the oldest first
        self.files = {path.name: (path.read_bytes(), _TYPES[path.suffix]) for path in STATIC.iterdir()}
        for language in sentences.languages():
            words = json.dumps({**sentences.catalog(), **sentences.catalog(language)}, ensure_ascii=False)
            self.files[f"words/{language}.json"] = (words.encode("utf-8"), _TYPES[".json"])
        self.port = 0
        self._on_fault = on_fault
        self._started: "Future[int]" = Future()  # gets the port
        self._thread = threading.Thread(target=self._run, name="page_server", daemon=True)

    def hello(self, role: Role) -> Dict[str, Any]:
        """Returns the first message to a browser: its role, and the tables of states, commands and zones."""
        return {
            "role": role.name.lower(),
            "languages": sentences.languages(),
            "login": self.sessions is not None,
            **interaction_tables.tables(),
            "zones": zones.table(),
        }

    def start(self) -> None:
        """Starts the thread and waits until it listens. Raises CodedError "page_no_address" if the port is not free."""
        self._thread.start()
        try:
            self.port = self._started.result()
        except Exception as error:
            address, port = self.params.address, self.params.port
            raise CodedError("page_no_address", address=address, port=port, reason=error) from error
        self.view.on_change = lambda: self._loop.call_soon_threadsafe(self._announce)

    def close(self) -> None:
        """Tells the browsers that the server shuts down, and ends the thread."""
        self.view.on_change = lambda: None
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._closing.set)
            self._thread.join(timeout=5.0)
        for pool in (self.pool, self.slow_pool):
            pool.shutdown(wait=False)

    # ------------------------------------------------------------- thread
    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except BaseException as error:
            if not self._started.done():
                self._started.set_exception(error)  # the caller of start raises it
                return
            self._on_fault(error)
            raise

    async def _serve(self) -> None:
        self._loop = asyncio.get_event_loop()
        self._closing = asyncio.Event()
        self.view_changed = asyncio.Event()
        context = None
        certificate = self.params.certificate
        if certificate is not None:
            context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
            context.load_cert_chain(*map(str, certificate))
        application = web.Application(
            http_handlers.routes(self),
            log_function=lambda _handler: None,
            websocket_max_message_size=action_parser.MAX_BYTES,
            websocket_ping_interval=15,
            websocket_ping_timeout=45,
        )
        server = _BoundedServer(
            application,
            page=self,
            ssl_options=context,
            max_header_size=16384,
            max_body_size=http_handlers.MAX_BODY,
            idle_connection_timeout=_PATIENCE,
            body_timeout=_PATIENCE,
        )
        sockets = bind_sockets(self.params.port, self.params.address)
        for listener in sockets:
            self._loop.add_reader(listener, server.accept, listener)
        self._started.set_result(sockets[0].getsockname()[1])
        await self._closing.wait()
        for listener in sockets:
            self._loop.remove_reader(listener)
            listener.close()
        for browser in list(self.browsers):
            browser.close(1001)
        await asyncio.sleep(0.05)

    def _announce(self) -> None:
        """Wakes the tasks that send the view to browsers, because it has changed."""
        self.view_changed.set()
        self.view_changed = asyncio.Event()

    # ------------------------------------------------------------- browsers' requests
    def assign_slot(self, stream: Any, role: Role, *holders: str) -> bool:
        """Gives a connection one of its role's slots, and closes another connection if needed. Returns whether it got one."""
        for slots in self.slots.values():
            slots.release(stream)
        displaced = self.slots[role].assign_slot(stream, *holders)
        if displaced is not None and displaced is not stream:
            displaced.close()
        return displaced is not stream

    async def run_in_turn(self, person: str, work: Callable[..., Any], *args: Any) -> Any:
        """Does slow work, but only one piece at a time for each person, so that nobody can occupy the whole pool."""
        turn = self._turns.setdefault(person, asyncio.Lock())
        async with turn:
            return await asyncio.get_event_loop().run_in_executor(self.slow_pool, work, *args)

    def carry_out(self, request: action_parser.ActionRequest, person: str) -> "asyncio.Future[Dict[str, Any]]":
        """Carries out a request and returns its answer. A repeated request gets the same answer."""
        key = (person, request.id)
        source = f"page {person[:4]}".strip()
        if key not in self._answers:
            if request.action == "command":
                self._answers[key] = self.actions.command(request, source)
            else:
                self._answers[key] = asyncio.ensure_future(self._carry_out(request, person, source))
            if len(self._answers) > 300:
                del self._answers[next(iter(self._answers))]
        return self._answers[key]

    async def _carry_out(self, request: action_parser.ActionRequest, person: str, source: str) -> Dict[str, Any]:
        try:
            if request.action == "preview":
                return await self.run_in_turn(person, self.actions.carry_out, request, source)
            return await asyncio.get_event_loop().run_in_executor(self.pool, self.actions.carry_out, request, source)
        except CodedError as error:
            return answer_from_error(error)


class _BoundedServer(HTTPServer):
    """Gives each new connection a slot of `Role.NOBODY`. Closes connections that come too fast or read too slowly."""

    def initialize(self, *args: Any, page: PageServer, **kwargs: Any) -> None:
        super().initialize(*args, **kwargs)
        self._page = page

    def accept(self, listener: socket.socket) -> None:
        """Accepts one new connection in each iteration of the event loop.

        Tornado's own handler accepts up to 128 waiting connections at once. Their TLS handshakes, which take longer than
        any other work, would then run in the same iteration, and open connections would have to wait for them.
        """
        try:
            connection, address = listener.accept()
        except (BlockingIOError, ConnectionError):
            return  # the peer has closed it
        if self._page.connection_limiter.allows(address[0], time.monotonic()):
            self._handle_connection(connection, address)
        else:
            connection.close()

    def handle_stream(self, stream: Any, address: Any) -> None:
        # unlike other timeouts, this one also closes a connection whose peer keeps confirming a window of zero
        stream.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _SEND_PATIENCE * 1000)
        self._page.assign_slot(stream, Role.NOBODY, address[0])
        super().handle_stream(stream, address)


def page_urls(params: PageParams, port: int, own_addresses: List[str]) -> List[str]:
    """Returns the page's URLs, the most useful first, given this computer's own addresses in the network."""
    hosts = own_addresses if params.address in ("0.0.0.0", "::", "") else [params.address]
    scheme = "https" if params.certificate else "http"
    bracketed_hosts = [f"[{host}]" if ":" in host else host for host in hosts]  # IPv6 addresses need brackets
    return [f"{scheme}://{host}:{port}/" for host in bracketed_hosts]
