#!/usr/bin/env python3
"""Tests whether a crash ever loses a border: random kills and damaged bytes.

    python3 bench/maps/crashes.py --crashes 1000 --seed 1

In each crash, a child process opens the database, makes random changes, reports each to the parent once it is answered,
and is killed at a random instant; after half of the kills up to three bytes, or a block of 512, of one of its files are
changed (flip). The parent starts an integrator on what is left, and compares all borders with the acknowledged ones; a
change under way may have been made or not. Exits non-zero after a loss or a failed start. Unit tests cover a full disk.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any, Dict, List

import numpy as np

from bench.harness import Table, arguments
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_map_integration.border import VirtualBorder
from vb_map_integration.geojson import border_to_feature
from vb_map_integration.map_integrator import MapIntegrator

KINDS = ("kill", "flip")
BAD = ("LOST OR MOVED", "did not start")
# for each kind of change, whether the one border that it concerns exists before and after it
ADDED, REMOVED, CHANGED = (False, True), (True, False), (True, True)
EFFECTS = {
    "": (),
    "add": (ADDED,),
    "remove": (REMOVED,),
    **dict.fromkeys(("rename", "enable", "update"), (CHANGED,)),
    **dict.fromkeys(("undo", "redo"), (ADDED, REMOVED, CHANGED)),
}
GRID = GridMap(np.pad(np.zeros((118, 158), np.int8), 1, constant_values=100), 0.05, (-1.0, -1.0, 0.2))


def start(folder: Path) -> MapIntegrator:
    keeper = MapIntegrator(folder)
    keeper.set_map(GRID)
    return keeper


def state(keeper: MapIntegrator) -> str:
    """Serialises every border, to the last bit."""
    return json.dumps([border_to_feature(border) for border in keeper.borders])


def change(keeper: MapIntegrator, random: np.random.Generator, now: float, out: int) -> None:
    """Announces and makes a random change; a refused one changes nothing."""
    ids = [border.id for border in keeper.borders]
    some = str(random.choice(ids)) if ids else "b0"
    column, row = random.uniform(3, 130), random.uniform(3, 90)
    corners = GRID.grid_to_world([(column, row), (column + 20, row), (column + 20, row + 20), (column, row + 20)])
    border = VirtualBorder(corners, corners.mean(axis=0), closed=True)
    name, enabled = f"name {random.integers(1e6)}", bool(random.random() < 0.5)
    changes = {
        "add": (0.42, lambda: keeper.add(border, now)),
        "rename": (0.13, lambda: keeper.rename(some, name, now)),
        "enable": (0.13, lambda: keeper.set_enabled(some, enabled, now)),
        "update": (0.1, lambda: keeper.update(border.replace(id=some), now)),
        "remove": (0.1, lambda: keeper.remove(some)),
        "undo": (0.08, lambda: keeper.undo()),
        "redo": (0.04, lambda: keeper.redo()),
    }
    kind = str(random.choice(list(changes), p=[share for share, _ in changes.values()]))
    os.write(out, f"try {kind}\n".encode())
    changes[kind][1]()


def child(folder: Path, out: int, seed: int) -> None:
    """Reports the state, makes a change, and reports the state again, until it is killed."""
    random = np.random.default_rng(seed)
    keeper = start(folder)
    os.write(out, f"{state(keeper)}\n".encode())
    for number in range(100_000):
        with contextlib.suppress(CodedError):
            change(keeper, random, 1.0 + number, out)
        os.write(out, f"{state(keeper)}\n".encode())


def flip(folder: Path, random: np.random.Generator) -> None:
    """Damages one of the files; does nothing if a start was killed before it wrote any."""
    where = folder.glob("borders*") if random.random() < 0.7 else folder.rglob("*")
    files = [path for path in sorted(where) if path.is_file() and path.stat().st_size]
    if not files:
        return
    path = files[random.integers(len(files))]
    content = bytearray(path.read_bytes())
    if random.random() < 0.3:
        place = int(random.integers(len(content)))
        content[place : place + 512] = random.bytes(min(512, len(content) - place))
    else:
        for _ in range(random.integers(1, 4)):
            content[random.integers(len(content))] ^= int(random.integers(1, 256))
    path.write_bytes(bytes(content))


def crash(kind: str, folder: Path, seed: int, before: str) -> Dict[str, Any]:
    """Crashes once on a folder, which the next crash goes on with; returns what happened."""
    random = np.random.default_rng(seed)
    reader, writer = os.pipe()
    process = os.fork()
    if process == 0:
        os.close(reader)
        try:
            child(folder, writer, seed)
        finally:
            os._exit(0)
    os.close(writer)
    said: List[bytes] = []
    with os.fdopen(reader, "rb") as stream:
        # one in ten is killed while it starts, the others after some changes, anywhere within one
        for _ in range(0 if random.random() < 0.1 else random.integers(1, 30)):
            said.append(stream.readline())
        time.sleep(random.uniform(0.0, 0.01))
        os.kill(process, signal.SIGKILL)
        said += stream.read().splitlines(keepends=True)
    os.waitpid(process, 0)
    if kind == "flip":
        flip(folder, random)
    whole = [line.decode().strip() for line in said if line.endswith(b"\n")]
    states = [line for line in whole if line.startswith("[")]
    changes = sum(one != other for one, other in zip(states, states[1:]))
    return {
        "kind": kind,
        "changes": changes,
        "acknowledged": states[-1] if states else before,
        "under_way": whole[-1][4:] if whole and whole[-1].startswith("try") else "",
    }


def judge(row: Dict[str, Any], folder: Path, before: str) -> str:
    """Compares the restored borders with the acknowledged ones; returns the present state."""
    acknowledged = row.pop("acknowledged")
    try:
        keeper = start(folder)
    except Exception as error:  # the node would not have come up
        row.update(outcome="did not start", said=repr(error))
        return before
    said = (f"{one.code} {one.values.get('reason', '')}".strip() for one in keeper.notices)
    now, row["said"] = state(keeper), " ".join(said)
    keeper.close()
    if now == acknowledged:
        row["outcome"] = "same"
        return now
    old = {one["properties"]["id"]: one for one in json.loads(acknowledged)}
    new = {one["properties"]["id"]: one for one in json.loads(now)}
    different = [(key in old, key in new) for key in {*old, *new} if old.get(key) != new.get(key)]
    made = len(different) == 1 and different[0] in EFFECTS[row["under_way"]]
    row["outcome"] = "change under way was made" if made else "LOST OR MOVED"
    return now


def main() -> int:
    parser = arguments(__doc__, seed=1)
    parser.add_argument("--crashes", type=int, default=1000)
    given = parser.parse_args()
    rows, root = [], Path(tempfile.mkdtemp(prefix="border_crashes_"))
    folder, before = root / "0", "[]"
    for number in range(given.crashes):
        if number % 60 == 0:  # starts from an empty folder now and then
            shutil.rmtree(str(folder), ignore_errors=True)
            folder, before = root / str(number), "[]"
        folder.mkdir(exist_ok=True)
        rows.append(crash(KINDS[number % 2], folder, given.seed * 1_000_000 + number, before))
        before = judge(rows[-1], folder, before)
        if rows[-1]["outcome"] in BAD:
            print(number, rows[-1], flush=True)
            shutil.copytree(str(folder), f"{tempfile.gettempdir()}/border_crash_{number}", dirs_exist_ok=True)
    shutil.rmtree(str(root))
    table = Table(given.csv, given.seed)
    for kind in (*KINDS, "all"):
        some = [row for row in rows if kind in (row["kind"], "all")]
        outcomes, said = Counter(row["outcome"] for row in some), Counter(row["said"] or "nothing" for row in some)
        ends = {end.lower().replace(" ", "_"): outcomes[end] for end in ("same", "change under way was made", *BAD)}
        table.add(
            kind=kind,
            crashes=len(some),
            changes=sum(row["changes"] for row in some),
            **ends,
            said_at_start=str(dict(said)),
        )
    return int(any(row["outcome"] in BAD for row in rows))


if __name__ == "__main__":
    sys.exit(main())
