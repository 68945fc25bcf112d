"""The server over real sockets: access, answers, hostile messages."""

import asyncio
import contextlib
import json
import socket
import subprocess
import threading

import pytest
from tornado.websocket import WebSocketClosedError

from hostile import GOOD_DRAFT
from refusals import refused
from running_server import CODES, Running, cookie, log_in, serving
from vb_core.errors import ParameterError
from vb_core.rate_limiter import RateLimiter
from vb_web.access_control import ConnectionSlots, Role, Sessions
from vb_web.server import PageParams, page_urls

PREVIEW = {"do": "preview", "draft": GOOD_DRAFT, "border": ""}
CERTIFICATE = "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2 -subj /CN=lab"
CERTIFICATE += " -addext subjectAltName=IP:127.0.0.1 -keyout page.key -out page.crt"


@pytest.fixture
def local():
    with serving(None) as running:
        yield running


@pytest.fixture
def network():
    with serving(Sessions(CODES)) as running:
        yield running


def test_certificate_makes_the_network_https_only(tmp_path):
    params = PageParams(address="0.0.0.0", port=0, codes_file=str(tmp_path / "page_codes.yaml"))
    assert page_urls(params, 8420, ["lab"]) == ["http://lab:8420/"]
    (tmp_path / "page.crt").write_text("")
    with pytest.raises(ParameterError, match="go together"):
        page_urls(params, 8420, ["lab"])
    subprocess.run(CERTIFICATE.split(), cwd=str(tmp_path), check=True, stderr=subprocess.DEVNULL)
    assert page_urls(params, 8420, ["lab"]) == ["https://lab:8420/"]
    local_params = PageParams(codes_file=params.codes_file)  # for the browsers of this computer
    assert page_urls(local_params, 8420, ["lab"]) == ["http://127.0.0.1:8420/"]
    with serving(Sessions(CODES), params) as running:
        trusted = {"ca_certs": str(tmp_path / "page.crt")}
        options = {"scheme": "https", "options": trusted, "Origin": f"https://{running.host}"}
        answer = log_in(running, CODES["viewer"], **options)
        assert answer.code == 200
        assert "Secure" in answer.headers["Set-Cookie"]
        assert "Strict-Transport-Security" in answer.headers
        with pytest.raises(OSError):  # plain http gets no answer
            running.ask("/session")


async def send(connection, **request):
    await connection.write_message(json.dumps({"id": "1", **request}))


async def answer_to(connection, **request):
    await send(connection, **request)
    while True:
        text = await asyncio.wait_for(connection.read_message(), 60.0)
        if text is None:
            raise WebSocketClosedError()
        message = json.loads(text)
        if message.get("re") == request.get("id", "1"):
            return message


async def closing_code(connection):
    """Waits until the server has closed a connection; returns the close code."""
    while await asyncio.wait_for(connection.read_message(), 60.0) is not None:
        pass
    return connection.close_code


async def stop(connection, **more):
    return await answer_to(connection, do="command", command="stop", seen_stop="", age=0.0, **more)


PRIVATE = ["/picture/map/aaaaaaaaaaaaaaaa.png", "/floor.webp", "/camera/red.jpg"]


def test_this_computer_needs_no_code(local):
    assert json.loads(local.ask("/session").body) == {"role": "operator", "login": False}
    assert [local.ask(path).code for path in PRIVATE] == [200, 200, 200]
    policy = local.ask("/").headers["Content-Security-Policy"]  # nothing is loaded from elsewhere
    assert {"default-src 'none'", "frame-ancestors 'none'"} <= set(policy.split("; "))
    assert "unsafe" not in policy


FOREIGN = [{"Host": "evil.example"}, {"Host": "localhost.evil.example:8420"}]
FOREIGN += [{"X_Forwarded_For": "127.0.0.1"}, {"Forwarded": "for=1.2.3.4"}, {"Via": "1.1 proxy"}]


@pytest.mark.parametrize("headers", FOREIGN)
def test_a_foreign_name_or_a_proxy_is_not_this_computer(local, headers):
    assert json.loads(local.ask("/session", **headers).body)["role"] == "nobody"
    assert [local.ask(path, **headers).code for path in PRIVATE] == [401, 401, 401]


def test_in_a_network_nothing_is_shown_without_a_code(network):
    assert [network.ask(path).code for path in PRIVATE] == [401, 401, 401]
    with pytest.raises(Exception, match="401"):
        network.link(stop)
    # the page itself and its words are not secret: it asks for the code
    assert [network.ask(path).code for path in ("/", "/words/de.json")] == [200, 200]


def test_viewers_look_and_operators_command(network):
    assert [network.ask(path, Cookie=cookie(network, Role.VIEWER)).code for path in PRIVATE] == [200, 403, 403]
    assert [network.ask(path, Cookie=cookie(network, Role.OPERATOR)).code for path in PRIVATE] == [200, 200, 200]
    assert network.link(stop, Cookie=cookie(network, Role.VIEWER))["code"] == "page_viewer_only"
    assert network.backend.done == []
    assert network.link(stop, Cookie=cookie(network, Role.OPERATOR))["ok"]
    assert network.backend.done == [("command", {"command": "stop", "seen_stop": "", "age": 0.0})]


def test_a_code_gives_a_protected_cookie(network):
    answer = log_in(network, "VIEW ER22")
    cookie_header = answer.headers["Set-Cookie"]
    assert answer.code == 200
    assert {"HttpOnly", "SameSite=Strict"} <= set(cookie_header.split("; "))
    assert json.loads(network.ask("/session", Cookie=cookie_header.split(";")[0]).body)["role"] == "viewer"
    assert log_in(network, "oper-at33", Origin="http://evil.example").code == 403
    assert log_in(network, "wrong").code == 401


def test_codes_cannot_be_tried_fast(network):
    codes = [log_in(network, typed).code for typed in [*["guess"] * 4, *[CODES["operator"]] * 4]]
    assert [*codes[:5], codes[-1]] == [401] * 4 + [200, 429]


@pytest.mark.parametrize("headers", [{"Origin": "http://evil.example"}, {"Origin": "null"}, {"Origin": ""}])
def test_a_page_from_elsewhere_gets_no_link(local, headers):
    with pytest.raises(Exception, match="403"):
        local.link(stop, **headers)
    assert local.backend.done == []


# paths out of the folder and to files of the program, and names of no camera or file
HIDDEN = ["/../../etc/passwd", "/static/../server.py", "/%2e%2e/server.py", "/server.py", "/picture/map/../../x.png"]
HIDDEN += ["/camera/rosout.jpg", "/camera/..%2f..%2fx.jpg", "/words/xx.json", "/" + "a" * 60]


@pytest.mark.parametrize("path", HIDDEN)
def test_only_what_is_listed_can_be_fetched(local, path):
    assert local.ask(path).code == 404


@pytest.mark.parametrize("path, method, body", [("/", "DELETE", None), ("/", "PUT", "x"), ("/session", "POST", "{")])
def test_other_methods_and_malformed_logins_are_refused(local, path, method, body):
    assert local.ask(path, method, body).code == 403


def test_a_body_that_is_large_or_a_form_is_never_parsed(network):
    big = network.ask("/session", "POST", "x" * 100000, Origin=f"http://{network.host}")
    assert big.code in (400, 413, 599)
    form_headers = {"Origin": f"http://{network.host}", "Content_Type": "multipart/form-data; boundary=b"}
    assert network.ask("/session", "POST", "--b\r\n\r\nx\r\n--b--", **form_headers).code == 400


def test_browsers_cache_pictures_and_revalidate_pages(local):
    assert "immutable" in local.ask(PRIVATE[0]).headers["Cache-Control"]
    first = local.ask("/page.js")
    assert local.ask("/page.js", If_None_Match=first.headers["Etag"]).code == 304


def test_a_browser_gets_the_whole_view_and_then_what_changes(local):
    async def work(connection):
        received = {}
        while "view" not in received:
            received.update(json.loads(await asyncio.wait_for(connection.read_message(), 60.0)))
        local.view.put("spots", {"red": [1, 2, 0, 3.0]})
        return received, json.loads(await asyncio.wait_for(connection.read_message(), 60.0))

    received, update = local.link(work)
    assert received["hello"]["role"] == "operator"
    assert received["view"] == {"state": {"name": "default"}}
    assert update == {"view": {"spots": {"red": [1, 2, 0, 3.0]}}}


def test_a_request_that_is_sent_again_is_carried_out_once(local):
    async def work(connection):
        return [await answer_to(connection, do="add", id="same", draft=GOOD_DRAFT) for _ in range(3)]

    answers = local.link(work)
    assert all(answer["ok"] for answer in answers)
    assert len(local.backend.done) == 1


def test_refusals_come_as_codes(local):
    async def work(connection):
        requests = ({"do": "remove", "border": "b", "revision": 1}, {"do": "reboot"})
        return [(await answer_to(connection, **request))["code"] for request in requests]

    assert local.link(work) == ["page_no_border", "page_bad_request"]


def test_stop_does_not_wait_for_what_takes_long(local):
    local.backend.gate.clear()

    async def work(connection):
        for number in range(12):  # more than there are threads, and more than one browser may have pending
            await send(connection, **PREVIEW, id=f"p{number}")
        answer = await stop(connection, id="stop")
        local.backend.gate.set()
        return answer

    assert local.link(work)["ok"]


def test_previews_wait_only_for_those_of_the_same_person(network):
    network.backend.gate.clear()

    async def work(first):
        second_connection = await network.connect(Cookie=cookie(network, Role.OPERATOR))
        for number in range(4):
            await send(first, **PREVIEW, id=f"p{number}")
        await answer_to(second_connection, do="invite")  # all four have arrived
        await send(second_connection, **PREVIEW, id="q")
        for _ in range(2):
            assert await asyncio.get_event_loop().run_in_executor(None, network.backend.arrived.acquire, True, 60.0)
        sources = list(network.backend.previews)
        network.backend.gate.set()
        return sources

    first, second = network.link(work, Cookie=cookie(network, Role.OPERATOR))
    assert first != second


def test_logout_ends_connections_and_cookie(network):
    cookie_text = cookie(network, Role.OPERATOR)

    async def work(connection):
        await answer_to(connection, do="invite")
        loop = asyncio.get_event_loop()
        headers = {"Cookie": cookie_text, "Origin": f"http://{network.host}"}
        answer = await loop.run_in_executor(None, lambda: network.ask("/session", "DELETE", **headers))
        await closing_code(connection)
        return answer.code

    assert network.link(work, Cookie=cookie_text) == 200
    assert json.loads(network.ask("/session", Cookie=cookie_text).body)["role"] == "nobody"


def test_strangers_who_hold_connections_keep_nobody_out(network):
    """Slow headers occupy the same slots as hanging handshakes."""
    with contextlib.ExitStack() as stack:
        connections = [stack.enter_context(network.socket(source_address=("127.0.5.5", 0))) for _ in range(150)]
        for connection in connections:
            connection.sendall(b"GET / HTTP/1.1\r\nHost: x\r\n")
        assert network.ask("/session").code == 200
        assert log_in(network, CODES["operator"]).code == 200
        for connection in connections[:50]:  # closed by the server
            connection.settimeout(60.0)
            with contextlib.suppress(ConnectionResetError):
                while connection.recv(4096):
                    pass


def test_a_browser_that_takes_nothing_is_ended_by_the_system(network):
    with network.socket() as connection:
        connection.sendall(b"GET /session HTTP/1.1\r\nHost: x\r\n\r\n")
        assert connection.recv(4096)
        streams = [stream for slots in network.server.slots.values() for stream in slots._holders]
        limits = [stream.socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) for stream in streams]
    assert limits == [20000]


def test_viewers_take_no_operators_slot(network):
    for role in network.server.slots:
        network.server.slots[role] = ConnectionSlots(3, yields=role == Role.NOBODY)
    viewer = cookie(network, Role.VIEWER)

    async def work(operator):
        links = [await network.connect(Cookie=viewer) for _ in range(6)]
        for link in links[:3]:  # the viewers' older connections give way
            await closing_code(link)
        return await stop(operator)

    assert network.link(work, Cookie=cookie(network, Role.OPERATOR))["ok"]


def test_a_person_who_finds_no_slot_is_informed(network):
    network.server.slots[Role.VIEWER] = ConnectionSlots(0, yields=False)
    assert network.ask("/session", Cookie=cookie(network, Role.VIEWER)).code == 503
    assert network.ask("/session", Cookie=cookie(network, Role.OPERATOR)).code == 200


def test_one_browser_cannot_ask_without_end(local):
    async def work(connection):
        for number in range(200):
            await send(connection, do="command", id=f"c{number}", command="undo", seen_stop="", age=0)
        return await closing_code(connection)

    assert local.link(work) == 1008
    assert len(local.backend.done) <= 60


def test_garbage_on_the_socket_ends_only_itself(local):
    garbage = [
        b"\x00" * 2000,
        b"GET / HTTP/9.9\r\n\r\n",
        b"GET " + b"a" * 40000 + b" HTTP/1.1\r\n\r\n",
        b"POST /session HTTP/1.1\r\nContent-Length: -5\r\n\r\n",
        b"GET /link HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\r\n",
        b"POST /session HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\nZZZ\r\n",
    ]
    for data in garbage:
        # the server may close before everything is sent
        with local.socket(timeout=60.0) as connection, contextlib.suppress(ConnectionError):
            connection.sendall(data)
            connection.shutdown(socket.SHUT_WR)
            while connection.recv(4096):
                pass
    assert local.ask("/session").code == 200


def test_one_newcomer_is_let_in_at_each_turn_of_the_loop(local):
    loop = local.server._loop
    slots = local.server.slots[Role.NOBODY]
    counts = []
    entered, gate, finished = threading.Event(), threading.Event(), threading.Event()

    def count_connections():
        counts.append(len(slots._holders))
        loop.call_soon(finished.set if counts[-1] == 6 else count_connections)

    def block_loop():
        entered.set()
        gate.wait(60.0)
        count_connections()

    loop.call_soon_threadsafe(block_loop)
    assert entered.wait(60.0)
    with contextlib.ExitStack() as stack:
        for _ in range(6):
            stack.enter_context(local.socket())
        gate.set()
        assert finished.wait(60.0)
    assert max(later - earlier for earlier, later in zip(counts, counts[1:])) == 1


def test_too_many_requests_are_refused(local):
    local.server.request_limiter = RateLimiter(rate=0.0, burst=3.0)
    assert [local.ask("/session").code for _ in range(4)] == [200, 200, 200, 429]


def test_address_that_connects_too_often_is_disconnected(local):
    local.server.connection_limiter = RateLimiter(rate=0.0, burst=3.0)
    for number in range(8):
        with local.socket(source_address=("127.0.5.5", 0)) as connection:
            connection.sendall(b"GET /session HTTP/1.0\r\nHost: localhost\r\n\r\n")
            with contextlib.suppress(ConnectionResetError):
                assert bool(connection.recv(4096)) == (number < 3)
    assert local.ask("/session").code == 200


def test_a_port_that_is_taken_is_reported(local):
    with refused("page_no_address"):
        Running(None, PageParams(port=local.server.port))
