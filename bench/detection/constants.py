#!/usr/bin/env python3
"""Which numbers of the detector's stages matter: each is halved and doubled, and judged on cameras that were left out.

    python3 bench/detection/constants.py --clips DIR --left-out EXAMPLES --csv FILE [--only WORD ...]

DIR and EXAMPLES as clips.py takes them. A row for each number and factor: spots found and false ones of the clips' frames near
shots, of the same through the panning window, of the same set dark (augmentation.py), each by a classifier that was fitted
without the clip's camera and room, and of every third rendered scene (--share of its time; 0: none). What comes after the
first difference is left out. Numbers that only tell time and place (tracking, projection) are judged by the scenes. Numbers
are those with a name of their own, and others but indices, guards against division by zero, and what is given by arithmetic
or by pixels (halves, two, three channels, bytes, neighbours); parameters are not among them.
--only goes on with modules with a WORD in their name.
"""

from __future__ import annotations

import ast
import itertools
import json
import math
import multiprocessing
import shutil
import sys
import tempfile
import zlib
from pathlib import Path
from typing import Any, Dict, Iterator, NamedTuple, Optional, Sequence, Tuple

import cv2
import numpy as np

from bench.detection.augmentation import takes
from bench.detection.clip_frames import is_clip, left_out_with, reach_in
from bench.detection.finder import Finder
from bench.detection.fitting import fit_without, judges_of_clips, load_examples
from bench.detection.hard_scenes import Camera, Outcome, course
from bench.detection.rooms import Rooms, lab
from bench.detection.scene_list import ceiling_scenes, mobile_scenes
from bench.detection.training import LEARN_S, frames_near_shots
from bench.frame import TOP, Table, arguments

PACKAGE = Path("vb_laser_detect/src/vb_laser_detect")
STAGES = ("proposals", "background", "image_registration", "features", "tracking", "projection")
TIMED = ("tracking", "projection")
STRUCTURE = (0, 0.5, 1, 2, 3, 255, 1000)
STRUCTURED = "connectivity", "np.zeros", "slice(", "12.0", "50.0", "BLOCK:"  # as lines without a name tell
WITHOUT_SHOTS, EVERY, SEED = 100, 3, 1  # frames of clips without labels; scene; rooms as frames.py's


class Number(NamedTuple):
    """A number in a module's source: its name, or the line that holds it."""

    module: str
    name: str
    value: float
    line: int
    column: int
    text: str

    def vary(self, factor: float) -> str:
        """Returns what stands there instead."""
        varied = self.value * factor
        return repr(max(1, math.floor(varied + 0.5)) if isinstance(self.value, int) else varied)


def numbers_of(source: Path, module: str) -> Iterator[Number]:
    """Yields the numbers of a module that are worth varying."""
    text = (source / PACKAGE / f"{module}.py").read_text()
    tree, lines, names = ast.parse(text), text.splitlines(), {}
    for node in (node for node in tree.body if isinstance(node, ast.Assign)):
        names.update({id(one): ast.unparse(node.targets[0]) for one in ast.walk(node.value)})
        if isinstance(node.targets[0], ast.Tuple):
            names.update({id(one): name.id for one, name in zip(node.value.elts, node.targets[0].elts)})
        named = {id(one) for one in getattr(node.value, "elts", [node.value])}
        names.update({one: f"{names[one]} " for one in named})
    skipped = {id(one) for node in ast.walk(tree) if isinstance(node, ast.Subscript) for one in ast.walk(node.slice)}
    skipped |= {id(one) for node in ast.walk(tree) if isinstance(node, ast.AnnAssign) for one in ast.walk(node)}
    for node in ast.walk(tree):
        if not isinstance(node, ast.Constant) or type(node.value) not in (int, float) or id(node) in skipped:
            continue
        name = names.get(id(node), lines[node.lineno - 1].strip())
        if name.startswith("(") or any(word in name for word in STRUCTURED):  # rows of a block
            continue
        if name.endswith(" ") or abs(node.value) not in STRUCTURE and 1e-3 < abs(node.value) < 1e6:
            yield Number(
                module, name.strip(), node.value, node.lineno, node.col_offset, ast.get_source_segment(text, node)
            )


def varied(folder: Path, number: Number, factor: float) -> Path:
    """Makes a folder `src` of a version in which one number is another one."""
    shutil.copytree(TOP / "src/vb_laser_detect", folder / "vb_laser_detect", ignore=shutil.ignore_patterns("test"))
    file = folder / PACKAGE / f"{number.module}.py"
    lines = file.read_text().splitlines(keepends=True)
    line = lines[number.line - 1]
    end = number.column + len(number.text)
    lines[number.line - 1] = line[: number.column] + number.vary(factor) + line[end:]
    file.write_text("".join(lines))
    return folder


class Clips:
    """The frames of the clips, taken in one way, and who judges each."""

    def __init__(self, folder: Path, judges: Dict[str, Any], role: str = "stationary", dark: bool = False) -> None:
        self._role, self._clips = role, []
        for name, video in sorted(json.loads((folder / "labels.json").read_text())["videos"].items()):
            group, taken = name, None
            if dark:
                group, taken = takes(name, np.random.default_rng(zlib.crc32(name.encode())))[1]
            frames = frames_near_shots(folder, name, video, group, taken, role)
            kept = list(itertools.islice(frames, None if video["labels"] else WITHOUT_SHOTS))
            self._clips.append((judges.get(group), reach_in(video), kept))

    def count(self, source: Optional[Path]) -> Tuple[int, int]:
        """Returns how many labelled spots a version finds, and how many false ones."""
        found = false = 0
        for judge, reach, frames in self._clips:
            finder = Finder("stationary" if self._role == "stationary" else "mobile", source, judge, confirm_frames=1)
            for frame in frames:
                spots = [(one.u, one.v) for one in finder.find(frame.image, frame.stamp)]
                found += sum(_is_near(place, spots, reach) for place in frame.spots)
                false += sum(not _is_near(one, [*frame.spots, *frame.unclear], reach) for one in spots)
        return found, false


def _is_near(place: Tuple[float, float], others: Sequence[Tuple[float, float]], reach: float) -> bool:
    return any(math.dist(place, other) < reach for other in others)


class Scenes:
    """The rendered scenes' images, and who judges each."""

    def __init__(self, judges: Dict[str, Any], share: float) -> None:
        room, rooms, self._scenes = lab(), Rooms(SEED), []
        for scene in (ceiling_scenes(room) + mobile_scenes(room))[::EVERY]:
            camera = Camera(scene, rooms)
            images = []
            for t, index, snapshot in course(scene, share, LEARN_S):
                image, frame, view = camera.picture(index, snapshot)
                images.append((t, image.copy(), frame, view))  # the view draws the next one into the same memory
            self._scenes.append((scene, camera, judges.get(scene.title), images))

    def count(self, source: Optional[Path]) -> Tuple[int, int]:
        """Returns as `Clips.count`."""
        total = Outcome()
        for scene, camera, judge, images in self._scenes:
            camera.finder = Finder("mobile" if scene.mobile else "stationary", source, judge)
            for t, image, frame, view in images:
                camera.look(t, image, frame, view, total)
        return total.found, len(total.false)


def measure(inputs: Dict[str, Any], number: Optional[Number], factor: float, before: Dict[str, Any]) -> Dict[str, Any]:
    """Counts for one version, in a process of its own: what differs from `before`, which is without a change."""
    with tempfile.TemporaryDirectory(prefix="varied_") as folder:
        source = varied(Path(folder), number, factor) if number else None
        found: Dict[str, Any] = {}
        for kind, given in inputs.items():
            if kind == "scenes" or number is None or number.module.split("/")[-1] not in TIMED:
                found[kind] = given.count(source)
            if before and kind in found and found[kind] != before[kind]:
                break
    return found


def in_process(*given: Any) -> Dict[str, Any]:
    """Measures in a child; a version that fails has no figures."""
    receive, send = multiprocessing.Pipe(duplex=False)

    def work() -> None:
        try:
            send.send(measure(*given))
        except Exception as error:  # what a senseless number leads to
            send.send({"failed": type(error).__name__})

    child = multiprocessing.get_context("fork").Process(target=work)
    child.start()
    found = receive.recv()
    child.join()
    return found


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--clips", type=Path, metavar="DIR", required=True)
    parser.add_argument("--left-out", type=Path, metavar="EXAMPLES", help="else the packaged classifier judges")
    parser.add_argument("--share", type=float, default=0.08)
    parser.add_argument("--only", nargs="+", default=[""], metavar="WORD")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    judges: Dict[str, Any] = {}
    if given.left_out:
        examples = load_examples(sorted(given.left_out.glob("*.npz")))
        left_out = left_out_with([str(group) for group in np.unique(examples.groups)])
        of_scenes = fit_without(examples, {group: out for group, out in left_out.items() if not is_clip(group)})
        judges = {**judges_of_clips(examples), **of_scenes}
    inputs = {
        "clips": Clips(given.clips, judges),
        "panning": Clips(given.clips, judges, "window"),
        "set dark": Clips(given.clips, judges, dark=True),
        **({"scenes": Scenes(judges, given.share)} if given.share else {}),
    }
    table, before = Table(given.csv), in_process(inputs, None, 1.0, {})
    table.add(module="as it is", number="", value="", factor="", **_row(before, before))
    modules = ["detector"] + sorted(
        f"detection/{one.stem}" for one in (TOP / "src" / PACKAGE / "detection").glob("*.py")
    )
    for module in (module for module in modules if any(word in module for word in given.only)):
        for number in numbers_of(TOP / "src", module):
            for factor in (0.5, 2.0):
                if number.vary(factor) != number.text:
                    found = in_process(inputs, number, factor, before)
                    table.add(
                        module=module, number=number.name, value=number.value, factor=factor, **_row(found, before)
                    )
    return 0


def _row(found: Dict[str, Any], before: Dict[str, Any]) -> Dict[str, Any]:
    changed = any(found[kind] != before[kind] for kind in before if kind in found)
    row = {kind: "{} and {}".format(*found[kind]) if kind in found else "" for kind in before}
    return {**row, "changed": found.get("failed") or ("yes" if changed else "no")}


if __name__ == "__main__":
    sys.exit(main())
