#!/usr/bin/env python3
"""What the page costs: browsers' links while somebody draws, and how soon a spot is told.

    python3 bench/lab/page.py                     1 and 20 browsers' links: share of a core, stamp of a spot to the message

Roscore and nodes are on free ports of loopback. The browsers' links are a process of their own: what they cost is not the
page's. Hostile messages: page_hostile.py.
"""

from __future__ import annotations

import asyncio
import json
import multiprocessing
import os
import sys
import time
from contextlib import ExitStack
from typing import List, Tuple

from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

from bench.frame import Table, arguments, quantiles
from bench.lab.page_lab import Pointer, node_process, start
from vb_core.ros.commands import make_request, send


async def listen(port, until, stamps, sizes):
    request = HTTPRequest(f"ws://127.0.0.1:{port}/link", headers={"Origin": f"http://127.0.0.1:{port}"})
    link = await websocket_connect(request)
    seen = {}
    while time.monotonic() < until:
        try:
            text = await asyncio.wait_for(link.read_message(), max(0.05, until - time.monotonic()))
        except asyncio.TimeoutError:
            break
        if text is None:
            raise OSError("the page hung up")
        now = time.time()
        sizes.append(len(text))
        for camera, spot in json.loads(text).get("view", {}).get("spots", {}).items():
            if spot[3] > seen.get(camera, 0.0):
                seen[camera] = spot[3]
                stamps.append(now - spot[3])
    link.close()


def listen_many(port: int, count: int, seconds: float) -> Tuple[List[float], List[int]]:
    """Runs in a separate process; returns delays [s], and the size of each message."""
    stamps, sizes, until = [], [], time.monotonic() + seconds

    async def run() -> None:
        await asyncio.gather(*(listen(port, until, stamps, sizes) for _ in range(count)))

    asyncio.run(run())
    return stamps, sizes


def cost(table: Table, port: int, counts: List[int], seconds: float) -> None:
    """Measures what so many browsers' links cost while somebody draws."""
    send(make_request("define_border", "bench", 10.0))  # lines are shown in that state
    pointer, process, ears = Pointer(), node_process(), multiprocessing.get_context("spawn").Pool(1)
    for count in counts:
        heard = ears.apply_async(listen_many, (port, count, seconds + 2))
        time.sleep(2.0)
        before, began = sum(process.cpu_times()[:2]), time.monotonic()
        pointer.run(seconds)
        used = (sum(process.cpu_times()[:2]) - before) / (time.monotonic() - began)
        delays, sizes = heard.get(60)
        each = {"kB_per_s": sum(sizes) / count / seconds / 1000, "messages_per_s": len(sizes) / count / seconds}
        table.add(what="links", browsers=count, cores=used, **quantiles(delays), **each, load=os.getloadavg()[0])


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--browsers", type=int, nargs="+", default=[1, 20], help="how many links")
    parser.add_argument("--seconds", type=float, default=30.0, help="of drawing")
    given = parser.parse_args()
    table = Table(given.csv)
    with ExitStack() as stack:
        port, _ = start(stack)
        cost(table, port, given.browsers, given.seconds)
    return 0


if __name__ == "__main__":
    sys.exit(main())
