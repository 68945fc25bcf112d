#!/usr/bin/env python3
"""Which numbers of the detector's stages matter: each is halved and doubled, and judged on cameras that were left out.

    python3 bench/detection/constants.py --clips DIR --left-out EXAMPLES --csv FILE [--only WORD ...]

DIR and EXAMPLES as clips.py takes them. A row for each constant (varied.py) has the first difference that halving and
doubling it make: spots found and false ones of the clips' frames near shots, of the same through the panning window, of the
same set dark (augmentation.py), each by a classifier that was fitted without the clip's camera and room, and of every third
rendered scene (--share of its time; 0: none), which alone tell of tracking and projection.
"""

from __future__ import annotations

import itertools
import json
import math
import sys
import zlib
from pathlib import Path
from typing import Any, Dict, Optional, Sequence, Tuple

import cv2
import numpy as np

from bench import varied
from bench.detection.augmentation import takes
from bench.detection.clip_frames import is_clip, left_out_with, reach_in
from bench.detection.finder import Finder
from bench.detection.examples import load_examples
from bench.detection.fitting import fit_without, judges_of_clips
from bench.detection.hard_scenes import Camera, Outcome, course
from bench.detection.rooms import Rooms, lab
from bench.detection.scene_list import ceiling_scenes, mobile_scenes
from bench.detection.training import LEARN_S, frames_near_shots
from bench.frame import Table, arguments

WITHOUT_SHOTS, EVERY, SEED = 100, 3, 1  # frames of clips without labels; scene; rooms as frames.py's


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


def in_words(found: Tuple[int, int]) -> str:
    return f"{found[0]} found, {found[1]} false"


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
        examples = load_examples(sorted(given.left_out.glob("*.csv")))
        left_out = left_out_with(sorted(set(examples.index)))
        of_scenes = fit_without(examples, {group: out for group, out in left_out.items() if not is_clip(group)})
        judges = {**judges_of_clips(examples), **of_scenes}
    inputs = {
        "clips": Clips(given.clips, judges),
        "panning": Clips(given.clips, judges, "window"),
        "set dark": Clips(given.clips, judges, dark=True),
        **({"scenes": Scenes(judges, given.share)} if given.share else {}),
    }
    before = {kind: one.count(None) for kind, one in inputs.items()}
    print("as it is:", {kind: in_words(found) for kind, found in before.items()}, flush=True)

    def compare(source: Path) -> str:
        counts = ((kind, one.count(source)) for kind, one in inputs.items())
        return next((f"{kind}: {in_words(found)}" for kind, found in counts if found != before[kind]), "no difference")

    table = Table(given.csv)
    for row in varied.rows("vb_laser_detect", ("detector.py", "detection/*.py"), given.only, compare):
        table.add(**row)
    return 0


if __name__ == "__main__":
    sys.exit(main())
