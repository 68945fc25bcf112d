#!/usr/bin/env python3
"""Integration, commit, publication and store times over map sizes and numbers of borders.

    . scripts/env.sh && python3 bench/maps/integration.py [--only 320x200 4000x4000] [--no-node]

Writes out/bench/map_integration.json, where the sizes that were not asked for keep their figures, and prints a table.
The map is a house of many rooms with doors and table legs, which is harder for the fills than one room. Every time is a
median of several borders [ms]. The part with the node has its own ROS master: a real map_integrator, and a subscriber
that takes the time from the call of add_border to the whole map in its hands.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import platform
import queue
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Dict, List

import numpy as np
import rospy
from integration_scene import curve, house, polygon

from vb_core import names
from vb_core.grid_map import GridMap
from vb_core.ros import messages
from vb_evaluation.processes import free_port, spawn
from vb_map_integration.borders.border_messages import message_from_border
from vb_map_integration.integration import integrate
from vb_map_integration.integrator import IntegratorParams, MapIntegrator
from vb_map_integration.storage.database import FILE, Database, fingerprint
from vb_msgs.srv import AddBorder, AddBorderRequest

TOP = Path(__file__).resolve().parents[2]
SIZES = [(320, 200), (1000, 1000), (2000, 2000), (4000, 4000), (8000, 8000)]
COUNTS = [1, 10, 100, 500]
REPEATS = 9


def timed(action) -> float:
    """Measures the time [ms] that an action takes."""
    started = time.perf_counter()
    action()
    return 1e3 * (time.perf_counter() - started)


def median(times: List[float]) -> float:
    """Returns the median [ms], the first one left out: it pays for what is done once."""
    return round(float(np.median(times[1:] or times)), 3)


def serialize(grid: GridMap) -> None:
    """Does what publishing does up to the socket."""
    messages.message_from_grid(grid, rospy.Time(0)).serialize(io.BytesIO())


def integration_times(grid: GridMap, random: np.random.Generator) -> Dict[str, float]:
    """Times one border into the map, nothing else."""
    repeats = 20 * REPEATS if grid.data.size < 100_000 else REPEATS
    borders = {
        "small_polygon": [polygon(grid, random, 0.1) for _ in range(repeats)],
        "large_polygon": [polygon(grid, random, 0.7) for _ in range(repeats)],
        "curve": [curve(grid, random) for _ in range(repeats)],
    }
    return {
        f"integrate_{kind}_ms": median([timed(lambda: integrate(grid, one)) for one in some])
        for kind, some in borders.items()
    }


def keeper_times(grid: GridMap, random: np.random.Generator) -> Dict[str, Any]:
    """Commits as the node makes them: check, files, composition; by the number of borders that are there already."""
    result: Dict[str, Any] = {"serialise_ms": median([timed(lambda: serialize(grid)) for _ in range(4)]), "borders": []}
    small = [polygon(grid, random, 0.1) for _ in range(max(COUNTS) + REPEATS)]
    with tempfile.TemporaryDirectory() as folder:
        keeper = MapIntegrator(IntegratorParams(), Path(folder))
        result["take_map_ms"] = round(timed(lambda: keeper.set_map(grid)), 3)
        keeper.close()
        # the first borders are added one by one; the many are there to be in the way
        fast = MapIntegrator(IntegratorParams(check_reachability=False), Path(folder))
        added = 0
        for count in COUNTS:
            fast.set_map(grid)
            while added + REPEATS < count:
                fast.add(small[added], 1.0 + added)
                added += 1
            fast.close()
            keeper = MapIntegrator(IntegratorParams(), Path(folder))
            again = timed(lambda: keeper.set_map(grid))
            times = []
            for _ in range(min(REPEATS, count - added)):
                border = small[added]
                times.append(timed(lambda: keeper.add(border, 1.0 + added)))
                added += 1
            result["borders"].append(
                {
                    "borders": added,
                    "add_ms": median(times),
                    "undo_ms": round(timed(keeper.undo), 3),
                    "redo_ms": round(timed(keeper.redo), 3),
                    "start_with_them_ms": round(again, 3),
                    "store_file_bytes": (Path(folder) / FILE).stat().st_size,
                    "store_write_ms": median(store_times(keeper)),
                }
            )
            keeper.close()
            fast = MapIntegrator(IntegratorParams(check_reachability=False), Path(folder))
        fast.close()
    return result


def store_times(keeper: MapIntegrator) -> List[float]:
    """Times [ms] a change that touches no cell: what is left is the store's files."""
    last = keeper.borders[-1].id
    keeper.set_enabled(last, False, 1e5)
    times = [timed(lambda: keeper.rename(last, f"name {number}", 1e5)) for number in range(2 * REPEATS)]
    keeper.set_enabled(last, True, 1e5)
    return times


def many_times(count: int = 10_000) -> Dict[str, Any]:
    """Measures a database of many borders on 20 maps: its size, how long it takes to start, and a change with them there."""
    random = np.random.default_rng(2)
    with tempfile.TemporaryDirectory() as folder:
        database = Database(Path(folder))
        for floor in range(20):
            grid = house(320 + floor, 200)
            place = database.add_map(grid, fingerprint(grid))
            borders = [polygon(grid, random, 0.1).replace(id=f"b{floor * count + k + 1}") for k in range(count // 20)]
            database.import_legacy(place, borders, f"floor {floor}")
        database.close()
        started = time.perf_counter()
        keeper = MapIntegrator(IntegratorParams(check_reachability=False), Path(folder))
        opened = time.perf_counter()
        keeper.set_map(grid)
        shown = time.perf_counter()
        adds = [timed(lambda: keeper.add(polygon(grid, random, 0.1), 1.0)) for _ in range(REPEATS)]
        result = {
            "borders": count,
            "maps": 20,
            "borders_on_the_map": count // 20,
            "open_and_check_s": round(opened - started, 2),
            "map_and_regions_s": round(shown - opened, 2),
            "add_ms": median(adds),
            "rename_ms": median(store_times(keeper)),
            "database_mb": round((Path(folder) / FILE).stat().st_size / 1e6, 1),
        }
        keeper.close()
    return result


def node_times(grid: GridMap, random: np.random.Generator) -> Dict[str, float]:
    """Times add_border from its call to its answer, and to the whole map with borders at a subscriber."""
    arrived: "queue.Queue[float]" = queue.Queue()
    started_at = time.monotonic()
    subscriber = rospy.Subscriber(
        names.MAP_WITH_BORDERS, messages.OccupancyGridArray, lambda _: arrived.put(time.perf_counter()), buff_size=2**24
    )
    with tempfile.TemporaryDirectory() as folder:
        script = TOP / "src" / "vb_map_integration" / "scripts" / "map_integrator"
        node = spawn(
            [sys.executable, str(script), f"_database_dir:={folder}", f"__name:=integrator_{grid.shape[1]}"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            maps = rospy.Publisher(names.PHYSICAL_MAP, messages.OccupancyGridArray, queue_size=1, latch=True)
            maps.publish(messages.message_from_grid(grid, rospy.Time.now()))
            arrived.get(timeout=60.0)
            first = time.monotonic() - started_at
            add = rospy.ServiceProxy(names.ADD_BORDER, AddBorder, persistent=True)
            answers, published = [], []
            for _ in range(REPEATS):
                border = message_from_border(polygon(grid, random, 0.3))
                called = time.perf_counter()
                response = add(AddBorderRequest(border=border, source="bench"))
                answers.append(1e3 * (time.perf_counter() - called))
                assert response.success, response.message
                published.append(1e3 * (arrived.get(timeout=60.0) - called))
            maps.unregister()
        finally:
            node.terminate()
            node.wait(20.0)
            subscriber.unregister()
    return {
        "node_start_to_first_map_s": round(first, 2),
        "node_add_to_answer_ms": median(answers),
        "node_add_to_received_map_ms": median(published),
    }


def start_master() -> subprocess.Popen:
    """Starts a ROS master of this bench's own."""
    port = free_port()
    os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{port}"
    master = spawn(["roscore", "-p", str(port)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while subprocess.run(["rosparam", "list"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode:
        time.sleep(0.2)
    rospy.init_node("bench_map_integration", disable_signals=True)
    return master


def table(sizes: List[Dict[str, Any]]) -> str:
    """Writes the figures as Markdown."""
    columns = ["cells", "small polygon", "large polygon", "curve"] + [f"add, {count} there" for count in COUNTS]
    columns += [f"store, {COUNTS[0]} / {COUNTS[-1]}", "add to answer", "add to received map"]
    lines = ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
    for size in sizes:
        there = {entry["borders"]: entry for entry in size["borders"]}
        row = [f"{size['width_cells']} x {size['height_cells']}"]
        row += [f"{size[f'integrate_{kind}_ms']:.2f}" for kind in ("small_polygon", "large_polygon", "curve")]
        row += [f"{there[count]['add_ms']:.1f}" for count in COUNTS]
        row.append(" / ".join(f"{there[count]['store_write_ms']:.1f}" for count in (COUNTS[0], COUNTS[-1])))
        seen = ("node_add_to_answer_ms", "node_add_to_received_map_ms")
        row += [f"{size[key]:.0f}" if key in size else "" for key in seen]
        lines.append("| " + " | ".join(row) + " |")
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", metavar="WxH", help="only these sizes")
    parser.add_argument("--no-node", action="store_true", help="without the part that needs a ROS master")
    arguments = parser.parse_args()
    wanted = [size for size in SIZES if not arguments.only or f"{size[0]}x{size[1]}" in arguments.only]
    path = TOP / "out" / "bench" / "map_integration.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    known = json.loads(path.read_text()).get("sizes", []) if path.exists() else []
    sizes = {(entry["width_cells"], entry["height_cells"]): entry for entry in known if "load_1min" in entry}
    master = None if arguments.no_node else start_master()
    try:
        for width, height in wanted:
            random = np.random.default_rng(1)
            grid = house(width, height)
            entry = {"width_cells": width, "height_cells": height, **integration_times(grid, random)}
            entry.update(keeper_times(grid, random))
            if master is not None:
                entry.update(node_times(grid, random))
            entry["load_1min"] = os.getloadavg()[0]
            sizes[width, height] = entry
            print(table([entry]).splitlines()[-1], flush=True)
    finally:
        if master is not None:
            rospy.signal_shutdown("done")
            master.terminate()
            master.wait(20.0)
    in_order = [sizes[key] for key in sorted(sizes)]
    many = many_times() if len(wanted) == len(SIZES) else {}
    print(many)
    document = {"python": platform.python_version(), "cores": os.cpu_count(), "sizes": in_order, "many": many}
    path.write_text(json.dumps(document, indent=2) + "\n")
    print(f"\n{table(in_order)}\n\nwrote {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
