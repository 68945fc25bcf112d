#!/usr/bin/env python3
"""Tests whether a crash ever loses a border, by random kills and damaged bytes.

    python3 bench/maps/crashes.py --crashes 1000 --seed 1

In each crash, a child process opens the database and makes random changes. It reports each acknowledged change to the
parent, until it is killed at a random instant. After half of the kills, up to three bytes or a block of 512 bytes of a
file are changed (flip). The parent starts an integrator on the files, and compares all borders with the acknowledged
ones; a change under way may or may not have been made. Exits non-zero after a loss or a failed start.
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

from bench.harness import ResultTable, arguments
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_map_integration.border import VirtualBorder, border_to_feature
from vb_map_integration.map_integrator import MapIntegrator

KINDS = ("kill", "flip")
BAD = ("LOST OR MOVED", "did not start")
# for each kind of change, whether its border exists before and after it
ADDED, REMOVED, CHANGED = (False, True), (True, False), (True, True)
EFFECTS = {
    "": (),
    "add": (ADDED,),
    "remove": (REMOVED,),
    **dict.fromkeys(("rename", "enable", "update"), (CHANGED,)),
    **dict.fromkeys(("undo", "redo"), (ADDED, REMOVED, CHANGED)),
}
GRID = GridMap(np.pad(np.zeros((118, 158), np.int8), 1, constant_values=100), 0.05, (-1.0, -1.0, 0.2))


def start_integrator(folder: Path) -> MapIntegrator:
    keeper = MapIntegrator(folder)
    keeper.set_map(GRID)
    return keeper


def state(keeper: MapIntegrator) -> str:
    """Serialises all borders without rounding."""
    return json.dumps([border_to_feature(border) for border in keeper.borders])


def change(keeper: MapIntegrator, random: np.random.Generator, now: float, writer: int) -> None:
    """Announces and makes a random change, which the integrator may refuse."""
    ids = [border.id for border in keeper.borders]
    some_id = str(random.choice(ids)) if ids else "b0"
    column, row = random.uniform(3, 130), random.uniform(3, 90)
    corners = GRID.grid_to_world([(column, row), (column + 20, row), (column + 20, row + 20), (column, row + 20)])
    border = VirtualBorder(corners, corners.mean(axis=0), closed=True)
    name, enabled = f"name {random.integers(1e6)}", bool(random.random() < 0.5)
    changes = {
        "add": (0.42, lambda: keeper.add(border, now)),
        "rename": (0.13, lambda: keeper.rename(some_id, name, now)),
        "enable": (0.13, lambda: keeper.set_enabled(some_id, enabled, now)),
        "update": (0.1, lambda: keeper.update(border.replace(id=some_id), now)),
        "remove": (0.1, lambda: keeper.remove(some_id)),
        "undo": (0.08, lambda: keeper.undo()),
        "redo": (0.04, lambda: keeper.redo()),
    }
    kind = str(random.choice(list(changes), p=[share for share, _ in changes.values()]))
    os.write(writer, f"try {kind}\n".encode())
    changes[kind][1]()


def child(folder: Path, writer: int, seed: int) -> None:
    """Reports the state, makes a change, and reports the state again, until it is killed."""
    random = np.random.default_rng(seed)
    keeper = start_integrator(folder)
    os.write(writer, f"{state(keeper)}\n".encode())
    for number in range(100_000):
        with contextlib.suppress(CodedError):
            change(keeper, random, 1.0 + number, writer)
        os.write(writer, f"{state(keeper)}\n".encode())


def flip(folder: Path, random: np.random.Generator) -> None:
    """Damages one of the files, if the child was not killed before it wrote any."""
    candidates = folder.glob("borders*") if random.random() < 0.7 else folder.rglob("*")
    files = [path for path in sorted(candidates) if path.is_file() and path.stat().st_size]
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
    """Crashes once in a folder, with which the next crash continues; returns the events."""
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
    output: List[bytes] = []
    with os.fdopen(reader, "rb") as stream:
        # a tenth of the children are killed while they start, the others at any time within a change
        for _ in range(0 if random.random() < 0.1 else random.integers(1, 30)):
            output.append(stream.readline())
        time.sleep(random.uniform(0.0, 0.01))
        os.kill(process, signal.SIGKILL)
        output += stream.read().splitlines(keepends=True)
    os.waitpid(process, 0)
    if kind == "flip":
        flip(folder, random)
    lines = [line.decode().strip() for line in output if line.endswith(b"\n")]
    states = [line for line in lines if line.startswith("[")]
    return {
        "kind": kind,
        "changes": sum(previous != current for previous, current in zip(states, states[1:])),
        "acknowledged": states[-1] if states else before,
        "under_way": lines[-1][4:] if lines and lines[-1].startswith("try") else "",
    }


def judge(row: Dict[str, Any], folder: Path, before: str) -> str:
    """Compares the restored borders with the acknowledged ones; returns the restored state."""
    acknowledged = row.pop("acknowledged")
    try:
        keeper = start_integrator(folder)
    except Exception as error:  # the node would not have started
        row.update(outcome="did not start", said=repr(error))
        return before
    notices = (f"{notice.code} {notice.values.get('reason', '')}".strip() for notice in keeper.notices)
    restored, row["said"] = state(keeper), " ".join(notices)
    keeper.close()
    if restored == acknowledged:
        row["outcome"] = "same"
        return restored
    old = {border["properties"]["id"]: border for border in json.loads(acknowledged)}
    new = {border["properties"]["id"]: border for border in json.loads(restored)}
    different = [(key in old, key in new) for key in {*old, *new} if old.get(key) != new.get(key)]
    is_under_way = len(different) == 1 and different[0] in EFFECTS[row["under_way"]]
    row["outcome"] = "change under way was made" if is_under_way else "LOST OR MOVED"
    return restored


def main() -> int:
    parser = arguments(__doc__, seed=1)
    parser.add_argument("--crashes", type=int, default=1000)
    options = parser.parse_args()
    rows = []
    root = Path(tempfile.mkdtemp(prefix="border_crashes_"))
    for number in range(options.crashes):
        if number % 60 == 0:  # starts again in an empty folder
            folder = root / str(number)
            folder.mkdir()
            before = "[]"
        rows.append(crash(KINDS[number % 2], folder, options.seed * 1_000_000 + number, before))
        before = judge(rows[-1], folder, before)
        if rows[-1]["outcome"] in BAD:
            print(number, rows[-1], flush=True)
            shutil.copytree(str(folder), f"{tempfile.gettempdir()}/border_crash_{number}", dirs_exist_ok=True)
    shutil.rmtree(str(root))
    table = ResultTable(options.csv, options.seed)
    for kind in (*KINDS, "all"):
        part = [row for row in rows if kind in (row["kind"], "all")]
        outcomes = Counter(row["outcome"] for row in part)
        notes = Counter(row["said"] or "nothing" for row in part)
        endings = {end.lower().replace(" ", "_"): outcomes[end] for end in ("same", "change under way was made", *BAD)}
        changes = sum(row["changes"] for row in part)
        table.add(kind=kind, crashes=len(part), changes=changes, **endings, said_at_start=str(dict(notes)))
    return int(any(row["outcome"] in BAD for row in rows))


if __name__ == "__main__":
    sys.exit(main())
