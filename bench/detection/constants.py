#!/usr/bin/env python3
"""Which numbers of the detector's stages matter: each is halved and doubled, and judged on cameras that were left out.

    python3 bench/detection/constants.py --clips DIR --left-out EXAMPLES --csv FILE [--only WORD ...]

DIR and EXAMPLES as clips.py takes them. A row for each constant (varied.py) has the first difference that halving and
doubling it make: spots found and false ones of a few frames of each clip, taken again set dark (augmentation.py) by a camera
that stands still, and as they are through the panning window, each by a classifier that was fitted without the clip's camera
and room. Spots count once the tracker has confirmed them, as in the node. Nothing here has a pose or depth: projection's
limits are not varied.
"""

from __future__ import annotations

import itertools
import json
import sys
import zlib
from pathlib import Path
from typing import Any, Dict, List, Optional, Tuple

import cv2
import numpy as np

from bench import varied
from bench.detection.augmentation import takes
from bench.detection.clip_frames import frames_near_shots, reach_in
from bench.detection.clips import Count
from bench.detection.finder import Finder
from bench.detection.fitting import judges_of_clips
from bench.frame import Table, arguments

FRAMES = 40, 100  # of those that frames_near_shots yields of a clip: the quiet before, and the first two or three shots
STAGES = ("detector.py", *(f"detection/{name}.py" for name in "blocks proposals features tracking".split()))
STAGES += ("detection/image_registration.py",)


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
    for row in varied.rows("vb_laser_detect", STAGES, given.only, compare):
        table.add(**row)
    return 0


if __name__ == "__main__":
    sys.exit(main())
