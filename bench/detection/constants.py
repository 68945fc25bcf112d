#!/usr/bin/env python3
"""Which numbers of the detector's stages matter: each is halved and doubled, and judged on cameras that were left out.

    python3 bench/detection/constants.py --clips DIR --left-out EXAMPLES --csv FILE [--only WORD ...]

DIR and EXAMPLES as clips.py takes them. A row for each constant has the first difference that halving and
doubling it make: spots found and false ones of a few frames of each clip, taken again set dark (augmentation.py) by a camera
that stands still, and as they are through the panning window, each by a classifier that was fitted without the clip's camera
and room. Spots count once the tracker has confirmed them, as in the node. Nothing here has a pose or depth: projection's
limits are not varied. Constants are all numbers that modules name, and all decimal numbers within their expressions, but
those that only keep a division from failing.
"""

from __future__ import annotations

import ast
import copy
import itertools
import json
import multiprocessing
import shutil
import sys
import tempfile
import zlib
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Optional, Sequence, Tuple

import cv2
import numpy as np

from bench.detection.augmentation import takes
from bench.detection.clip_frames import frames_near_shots, reach_in
from bench.detection.clips import Count
from bench.detection.finder import Finder
from bench.detection.fitting import judges_of_clips
from bench.frame import TOP, Table, arguments, import_from

FRAMES = 40, 100  # of those that frames_near_shots yields of a clip: the quiet before, and the first two or three shots
STAGES = ("detector.py", *(f"detection/{name}.py" for name in "blocks proposals features tracking".split()))
STAGES += ("detection/image_registration.py",)
FACTORS = (0.5, 2.0)
NO_DIVISOR = 1e-4  # and below it: keeps a division from failing


class Clips:
    """Some frames of the clips, set dark or through the window, and who judges each."""

    def __init__(self, folder: Path, judges: Dict[str, Any], role: str) -> None:
        self._preset, self._clips = "stationary" if role == "stationary" else "mobile", []
        for name, video in sorted(json.loads((folder / "labels.json").read_text())["videos"].items()):
            group, taken = name, None
            if role == "stationary":
                group, taken = takes(name, np.random.default_rng(zlib.crc32(name.encode())))[1]
            frames = frames_near_shots(folder, name, video, group, taken, role)
            self._clips.append((judges.get(group), reach_in(video), list(itertools.islice(frames, *FRAMES))))

    def count(self, source: Optional[Path]) -> Tuple[int, int]:
        """Returns how many labelled spots a version finds and confirms, and how many false ones."""
        counts = []
        for judge, reach, frames in self._clips:
            counts.append(Count(Finder(self._preset, source, judge), reach))
            for index, frame in enumerate(frames):
                counts[-1].look(frame, index)
        return sum(one.sums["found"] for one in counts), sum(one.sums["false_off_fringe"] for one in counts)


def in_words(counts: List[Tuple[int, int]]) -> str:
    return ", ".join(f"{kind} {found} and {false}" for kind, (found, false) in zip(("set dark", "panning"), counts))


def varied(only: Sequence[str], judge: Callable[[Path], str]) -> Iterator[Dict[str, Any]]:
    """Yields a row for each constant of the stages: what is judged of the versions in which it is another one.

    Args:
        only: constants with one of these in the name of their module, or in their lines.
        judge: says what a version's folder `src` does; in a process of its own.
    """
    folder = TOP / "src/vb_laser_detect/src"
    for path in sorted(folder / "vb_laser_detect" / stage for stage in STAGES):
        lines = path.read_text(encoding="utf-8").splitlines()
        for name, line, value, make in constants(path, ".".join(path.relative_to(folder).with_suffix("").parts)):
            text = f"{path.stem}: " + lines[line - 1].split("  #")[0].strip()
            if not any(part in text for part in only):
                continue
            row = {"constant": name or "within", "value": value, "line": text}
            for factor in FACTORS:
                with tempfile.TemporaryDirectory() as other:
                    copied = Path(other) / "vb_laser_detect"
                    shutil.copytree(folder, copied / "src", ignore=shutil.ignore_patterns("__pycache__"))
                    shutil.copy(folder.parent / "package.xml", copied)
                    (copied / "src" / path.relative_to(folder)).write_text(ast.unparse(make(factor)))
                    row[f"times {factor:g}"] = _in_process(judge, Path(other))
            yield row


def constants(path: Path, module: str) -> Iterator[Tuple[str, int, float, Callable[[float], ast.Module]]]:
    """Yields a file's constants: what it is called, its line and value, and a function that makes the file with another."""
    tree = ast.parse(path.read_text(encoding="utf-8"))

    def changed(index: int, factor: float) -> ast.Module:
        new = copy.deepcopy(tree)
        node = list(ast.walk(new))[index]
        if isinstance(node, ast.Assign):
            number = ast.parse(f"type(_)(max(1, round(_ * {factor}))) if type(_) is int else _ * {factor}", mode="eval")
            node.value = ast.parse(f"(lambda _: {ast.unparse(number)})({ast.unparse(node.value)})", mode="eval").body
        else:
            node.value *= factor  # type: ignore[attr-defined]
        return ast.fix_missing_locations(new)

    named = {
        statement: statement.targets[0].id
        for statement in tree.body
        if isinstance(statement, ast.Assign)
        and isinstance(statement.targets[0], ast.Name)
        and statement.targets[0].id.isupper()
    }
    outside = (statement for statement in tree.body if isinstance(statement, (ast.Assign, ast.ClassDef)))
    inside = {one for statement in outside for one in ast.walk(statement)}
    values = import_from(None, module)[0]
    for index, node in enumerate(ast.walk(tree)):
        if node in named and isinstance(getattr(values, named[node]), (int, float)):
            yield named[node], node.lineno, float(getattr(values, named[node])), lambda f, i=index: changed(i, f)
        elif isinstance(node, ast.Constant) and type(node.value) is float and node not in inside:
            if NO_DIVISOR < abs(node.value) and node.value != 1.0:
                yield "", node.lineno, node.value, lambda f, i=index: changed(i, f)


def _in_process(judge: Callable[[Path], str], source: Path) -> str:
    """Judges a version in a child; what a senseless number leads to is told too."""
    receive, send = multiprocessing.Pipe(duplex=False)

    def work() -> None:
        try:
            send.send(judge(source))
        except Exception as error:
            send.send(f"fails: {type(error).__name__}")

    child = multiprocessing.get_context("fork").Process(target=work)
    child.start()
    found = receive.recv()
    child.join()
    return found


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--clips", type=Path, metavar="DIR", required=True)
    parser.add_argument("--left-out", type=Path, metavar="EXAMPLES", help="else the packaged classifier judges")
    parser.add_argument("--only", nargs="+", default=[""], metavar="WORD")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    judges = judges_of_clips(given.left_out) if given.left_out else {}
    inputs = [Clips(given.clips, judges, role) for role in ("stationary", "window")]
    before = [one.count(None) for one in inputs]
    print("as it is:", in_words(before), flush=True)

    def compare(source: Path) -> str:
        counts: List[Tuple[int, int]] = []
        for one in inputs:
            counts.append(one.count(source))
            if counts != before[: len(counts)]:
                return in_words(counts)
        return "no difference"

    table = Table(given.csv)
    for row in varied(given.only, compare):
        table.add(**row)
    return 0


if __name__ == "__main__":
    sys.exit(main())
