#!/usr/bin/env python3
"""Measures how soon an operator's *stop* is answered while the page is attacked, over an open link and a new one.

Each attack runs in a separate process, against the page's real nodes with codes and https. Attackers have other
addresses (127.0.x.y) than the operator. A request without an answer within 5 s counts as lost.

python3 bench/lab/page_under_attack.py [--seconds 10] [--only NAME ...]
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import multiprocessing
import os
import ssl
import time
from functools import partial

import numpy as np
import yaml
from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.websocket import WebSocketClosedError, websocket_connect

from bench.harness import Table, arguments
from bench.lab.page_lab import start

LIMIT = 5.0  # [s] after which a stop counts as lost
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


# ------------------------------------------------------------------ attacks, each of which runs until it is killed
async def nothing(_page):
    await asyncio.sleep(1e6)


async def for_ever(opens):
    """Keeps connections open. Each of `opens` opens one and waits for its end, and is then called again."""

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

    await for_ever([make] * 250)


async def hanging_handshakes(page):
    async def make(number):
        reader, _writer = await page.connect(address(number % 5), None)
        await reader.read()

    await for_ever([partial(make, number) for number in range(300)])


async def hold_link(page, cookie, address):
    link = await page.link(cookie, address)
    while await link.read_message() is not None:
        pass


async def one_viewers_links(page):
    _, cookie = await page.log_in(page.codes["viewer"], address(0))
    await for_ever([partial(hold_link, page, cookie, address(0))] * 60)


async def many_viewers(page):
    cookies = [(await page.log_in(page.codes["viewer"], address(number)))[1] for number in range(50)]
    await for_ever([partial(hold_link, page, cookies[n % 50], address(n)) for n in range(500)])


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


# ------------------------------------------------------------------ the operator
async def timed(work):
    """Awaits work; returns its duration [s], infinity if it failed."""
    start = time.monotonic()
    try:
        await asyncio.wait_for(work, LIMIT)
    except Exception:  # with any error, the person has no answer
        return np.inf
    return time.monotonic() - start


async def measure(page, cookie, link, seconds, number):
    """Times *stop* over the open link, *stop* over a new link, another command, and a new phone's login."""
    results = {"link": [], "new_link": [], "command": [], "login": []}
    stop = {"do": "command", "command": "stop", "seen_stop": "", "age": 0}

    async def stop_from_a_new_link():
        new_link = await page.link(cookie)
        await answer(new_link, **stop)
        new_link.close()

    async def log_in():
        if (await page.log_in(page.codes["operator"], f"127.99.{number}.{len(results['login']) + 1}"))[0] != 200:
            raise OSError("not let in")

    end = time.monotonic() + seconds
    while time.monotonic() < end:
        cancel = answer(link, **{**stop, "command": "cancel"})
        for times, work in zip(results.values(), (answer(link, **stop), stop_from_a_new_link(), cancel, log_in())):
            times.append(await timed(work))
        await asyncio.sleep(0.3)
    return results


async def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each attack")
    parser.add_argument("--only", nargs="+", metavar="NAME", default=[attack.__name__ for attack in ATTACKS])
    options = parser.parse_args()
    table = Table(options.csv)
    with contextlib.ExitStack() as stack:
        port, folder = start(stack, network=True)
        page = Page(port, yaml.safe_load((folder / "page_codes.yaml").read_text()))
        for number, attack in enumerate(ATTACKS):
            if attack.__name__ not in options.only:
                continue
            _, cookie = await page.log_in(page.codes["operator"])
            link = await page.link(cookie)
            attacker = multiprocessing.get_context("spawn").Process(target=run_attack, args=(attack, page), daemon=True)
            attacker.start()
            await asyncio.sleep(6.0)
            results = await measure(page, cookie, link, options.seconds, number)
            if not attacker.is_alive():
                raise SystemExit(f"{attack.__name__} ended by itself")
            attacker.terminate()
            attacker.join()
            link.close()
            row = {"attack": attack.__name__, "asked": len(results["link"])}
            for kind, times in results.items():
                row[f"{kind}_median"], row[f"{kind}_worst"] = float(np.median(times)), float(max(times))
                row[f"{kind}_lost"] = int(np.isinf(times).sum())
            table.add(**row, load=os.getloadavg()[0])
            await asyncio.sleep(1.0)


if __name__ == "__main__":
    asyncio.run(main())
