#!/usr/bin/env python3
"""Measures how soon an operator's *stop* is answered while the page is attacked, over an open link and a new one.

Each attack (attackers.py) runs in a separate process, against the page's real nodes with codes and https. A request
without an answer within 5 s counts as lost.

python3 bench/lab/stop_under_attack.py [--seconds 10] [--only NAME ...]
"""

from __future__ import annotations

import asyncio
import contextlib
import multiprocessing
import os
import time

import numpy as np
import yaml

from bench.harness import ResultTable, arguments
from bench.lab.attackers import ATTACKS, Page, answer, run_attack
from bench.lab.page_nodes import start_page

LIMIT = 5.0  # [s] after which a stop counts as lost


async def measure_duration(work):
    """Awaits work; returns its duration [s], or infinity if it failed."""
    start = time.monotonic()
    try:
        await asyncio.wait_for(work, LIMIT)
    except Exception:  # with any error, the person has no answer
        return np.inf
    return time.monotonic() - start


async def measure_operator(page, cookie, link, seconds, number):
    """Times *stop* over the open link, *stop* over a new link, another command, and a new phone's login."""
    results = {"link": [], "new_link": [], "command": [], "login": []}
    stop = {"do": "command", "command": "stop", "seen_stop": "", "age": 0}

    async def stop_from_a_new_link():
        new_link = await page.link(cookie)
        await answer(new_link, **stop)
        new_link.close()

    async def log_in():
        status, _ = await page.log_in(page.codes["operator"], f"127.99.{number}.{len(results['login']) + 1}")
        if status != 200:
            raise OSError("not let in")

    end = time.monotonic() + seconds
    while time.monotonic() < end:
        cancel = answer(link, **{**stop, "command": "cancel"})
        requests = (answer(link, **stop), stop_from_a_new_link(), cancel, log_in())
        for times, request in zip(results.values(), requests):
            times.append(await measure_duration(request))
        await asyncio.sleep(0.3)
    return results


async def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each attack")
    parser.add_argument("--only", nargs="+", metavar="NAME", default=[attack.__name__ for attack in ATTACKS])
    options = parser.parse_args()
    table = ResultTable(options.csv)
    with contextlib.ExitStack() as stack:
        port, folder = start_page(stack, network=True)
        page = Page(port, yaml.safe_load((folder / "page_codes.yaml").read_text()))
        for number, attack in enumerate(ATTACKS):
            if attack.__name__ not in options.only:
                continue
            _, cookie = await page.log_in(page.codes["operator"])
            link = await page.link(cookie)
            attacker = multiprocessing.get_context("spawn").Process(target=run_attack, args=(attack, page), daemon=True)
            attacker.start()
            await asyncio.sleep(6.0)
            results = await measure_operator(page, cookie, link, options.seconds, number)
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
