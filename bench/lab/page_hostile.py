#!/usr/bin/env python3
"""The page under attack: how soon an operator's *stop* is answered, over its open link and from a phone that connects.

Every attack runs in a process of its own, against the page's real nodes with codes and https; attackers come from other
addresses (127.0.x.y) than the operator. What is not answered within 5 s counts as lost.

python3 bench/lab/page_hostile.py [--seconds 10] [--only NAME ...]
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import multiprocessing
import os
import sys
import time

import numpy as np
import yaml
from tornado.httpclient import AsyncHTTPClient

from bench.frame import Table, arguments
from bench.lab.page_client import Page, answer
from bench.lab.page_lab import start

LIMIT = 5.0  # [s] then a stop counts as lost


def address(number):
    """The address of an attacker's machine."""
    return f"127.0.{1 + number // 200}.{1 + number % 200}"


# ------------------------------------------------------------------ attacks: each goes on until it is killed
async def nothing(_page):
    await asyncio.sleep(1e6)


async def for_ever(opens):
    """Keeps connections open: `opens` make one each, again as soon as it has ended."""

    async def hold(make):
        while True:
            with contextlib.suppress(OSError, asyncio.IncompleteReadError):
                reader = (await make())[0]
                while await reader.read(65536):
                    pass
            await asyncio.sleep(0.2)

    await asyncio.gather(*(hold(make) for make in opens))


async def slow_headers(page):
    async def make():
        reader, writer = await page.connect(address(0))
        writer.write(b"GET / HTTP/1.1\r\nHost: x\r\n")
        return reader, writer

    await for_ever([make] * 250)


async def hanging_handshakes(page):
    await for_ever([lambda number=number: page.connect(address(number % 5), None) for number in range(300)])


async def one_viewers_links(page):
    _, cookie = await page.log_in(page.codes["viewer"], address(0))
    await for_ever([lambda: page.hold_link(cookie, address(0))] * 60)


async def many_viewers(page):
    cookies = [(await page.log_in(page.codes["viewer"], address(number)))[1] for number in range(50)]
    await for_ever([lambda n=number % 50: page.hold_link(cookies[n], address(n)) for number in range(500)])


async def wrong_codes(page):
    for number in itertools.count(0, 20):
        await asyncio.gather(*(page.log_in("guess2345", address(number + more)) for more in range(20)))
        await asyncio.sleep(0.2)


ATTACKS = (nothing, slow_headers, hanging_handshakes, one_viewers_links, many_viewers, wrong_codes)


def run_attack(attack, page):
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(attack(page))


# ------------------------------------------------------------------ the operator
async def timed(work):
    """Runs work; returns how long it took [s], infinite for what failed."""
    began = time.monotonic()
    try:
        await asyncio.wait_for(work, LIMIT)
    except Exception:  # whatever it was: the person has no answer
        return np.inf
    return time.monotonic() - began


async def measure(page, cookie, link, seconds, number):
    """Times *stop* over a link that is open, *stop* from a new one, another command, and a new phone's login."""
    found = {"link": [], "new_link": [], "command": [], "login": []}
    stop = {"do": "command", "command": "stop", "seen_stop": "", "age": 0}

    async def new_link():
        new = await page.link(cookie)
        await answer(new, **stop)
        new.close()

    async def log_in():
        if (await page.log_in(page.codes["operator"], f"127.99.{number}.{len(found['login']) + 1}"))[0] != 200:
            raise OSError("not let in")

    end = time.monotonic() + seconds
    while time.monotonic() < end:
        found["link"].append(await timed(answer(link, **stop)))
        found["new_link"].append(await timed(new_link()))
        found["command"].append(await timed(answer(link, **{**stop, "command": "cancel"})))
        found["login"].append(await timed(log_in()))
        await asyncio.sleep(0.3)
    return found


async def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each attack")
    parser.add_argument("--only", nargs="+", metavar="NAME", default=[attack.__name__ for attack in ATTACKS])
    given = parser.parse_args()
    table = Table(given.csv)
    with contextlib.ExitStack() as stack:
        port, folder = start(stack, network=True)
        page = Page(port, yaml.safe_load((folder / "page_codes.yaml").read_text()))
        AsyncHTTPClient.configure(None, max_clients=50)
        for number, attack in enumerate(ATTACKS):
            if attack.__name__ not in given.only:
                continue
            _, cookie = await page.log_in(page.codes["operator"])
            link = await page.link(cookie)
            attacker = multiprocessing.get_context("spawn").Process(target=run_attack, args=(attack, page), daemon=True)
            attacker.start()
            await asyncio.sleep(6.0)
            found = await measure(page, cookie, link, given.seconds, number)
            attacker.terminate()
            attacker.join()
            link.close()
            row = {"attack": attack.__name__, "asked": len(found["link"])}
            for what, times in found.items():
                row[f"{what}_median"], row[f"{what}_worst"] = float(np.median(times)), float(max(times))
                row[f"{what}_lost"] = int(np.isinf(times).sum())
            table.add(**row, load=os.getloadavg()[0])
            await asyncio.sleep(1.0)
    return 0


if __name__ == "__main__":
    sys.exit(asyncio.run(main()))
