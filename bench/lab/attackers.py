"""The attacks of stop_under_attack.py, and the requests that people and attackers send.

Each attack runs until it is killed. Attackers' addresses (127.0.x.y) differ from the operator's.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import os
import ssl
from functools import partial

from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.websocket import WebSocketClosedError, websocket_connect

HUNG_UP = OSError, HTTPClientError, WebSocketClosedError, ValueError  # the last one is raised by tornado during TLS
ANY = ssl.create_default_context()
ANY.check_hostname, ANY.verify_mode = False, ssl.CERT_NONE


class Page:
    """The page, and the requests that a person or an attacker sends from a machine's address."""

    def __init__(self, port, codes):
        self.port, self.codes = port, codes

    def request(self, scheme, path, address, cookie="", **options):
        host = f"127.0.0.1:{self.port}"
        headers = {"Origin": f"https://{host}", "Cookie": cookie}
        url = f"{scheme}://{host}/{path}"
        return HTTPRequest(url, headers=headers, network_interface=address, ssl_options=ANY, **options)

    async def log_in(self, code, address="127.0.0.1"):
        """Returns the answer's status and the cookie."""
        request = self.request("https", "session", address, method="POST", body=json.dumps({"code": code}))
        answer = await AsyncHTTPClient().fetch(request, raise_error=False)
        return answer.code, answer.headers.get("Set-Cookie", "").split(";")[0]

    async def link(self, cookie, address="127.0.0.1"):
        return await websocket_connect(self.request("wss", "link", address, cookie, connect_timeout=5.0))

    async def connect(self, address, secure=ANY):
        """Opens a connection; returns its reader and writer."""
        return await asyncio.open_connection("127.0.0.1", self.port, ssl=secure, local_addr=(address, 0))


async def answer(link, **request):
    """Sends a request and returns its answer."""
    request = {"id": os.urandom(6).hex(), **request}
    await link.write_message(json.dumps(request))
    while True:
        text = await link.read_message()
        if text is None:
            raise OSError("the server hung up")
        reply = json.loads(text)
        if reply.get("re") == request["id"]:
            return reply


def address(number):
    """Returns the address of an attacker's machine."""
    return f"127.0.{1 + number // 200}.{1 + number % 200}"


# ------------------------------------------------------------------ attacks
async def nothing(_page):
    await asyncio.sleep(1e6)


async def keep_open(opens):
    """Keeps connections open. Each function in `opens` opens one and waits for its end; it is then called again."""

    async def hold(open_connection):
        while True:
            with contextlib.suppress(*HUNG_UP):
                await open_connection()
            await asyncio.sleep(0.2)

    await asyncio.gather(*(hold(make) for make in opens))


async def slow_headers(page):
    async def make():
        reader, writer = await page.connect(address(0))
        writer.write(b"GET / HTTP/1.1\r\nHost: x\r\n")
        await reader.read()

    await keep_open([make] * 250)


async def hanging_handshakes(page):
    async def make(number):
        reader, _writer = await page.connect(address(number % 5), None)
        await reader.read()

    await keep_open([partial(make, number) for number in range(300)])


async def hold_link(page, cookie, address):
    link = await page.link(cookie, address)
    while await link.read_message() is not None:
        pass


async def one_viewers_links(page):
    _, cookie = await page.log_in(page.codes["viewer"], address(0))
    await keep_open([partial(hold_link, page, cookie, address(0))] * 60)


async def many_viewers(page):
    cookies = [(await page.log_in(page.codes["viewer"], address(number)))[1] for number in range(50)]
    await keep_open([partial(hold_link, page, cookies[n % 50], address(n)) for n in range(500)])


async def wrong_codes(page):
    for number in itertools.count(0, 20):
        guesses = [page.log_in("guess2345", address(number + offset)) for offset in range(20)]
        await asyncio.gather(*guesses, return_exceptions=True)
        await asyncio.sleep(0.2)


ATTACKS = (nothing, slow_headers, hanging_handshakes, one_viewers_links, many_viewers, wrong_codes)


def run_attack(attack, page):
    AsyncHTTPClient.configure(None, max_clients=50)
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(attack(page))
