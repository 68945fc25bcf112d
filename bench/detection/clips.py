#!/usr/bin/env python3
"""How right the spot detector is on labelled clips, in each role that a camera can have.

    python3 bench/detection/clips.py DIR [--roles stationary mobile window] [--left-out EXAMPLES]
                                     [--other REVISION|SRC] [--csv FILE]

DIR holds labels.json and clips/. Roles: a camera that stands still; the same pictures as a robot's camera sees them
while it stands; and as a robot sees them that looks around, through a window that pans, tilts and rolls over the
pictures by a few pixels per image. Detectors know neither focal length nor pose.

All versions see the same pictures in turn, and confirm nothing: the detector as it comes; with `--left-out` (examples
that training.py kept) one whose classifier was fitted without all clips of its camera and of its room.

A spot is right within 10 px (of 640 x 480) of a label of its frame. False spots are counted strictly, and *off fringe*:
without those close to a label up to 2 frames earlier or later, where a pulse's first or last light is seen, and without those
in frames with pulses that nobody labelled. Frames are not independent: Wilson's intervals are too narrow.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any, Dict, List, Sequence, Tuple

import cv2
import numpy as np

from bench.detection.clip_frames import ROLES, LabeledFrame, frames_of, reach_in
from bench.detection.finder import Finder
from bench.detection.fitting import judges_of_clips
from bench.frame import Table, arguments
from vb_evaluation.statistics import proportion

COUNTED = ("frames", "labels", "found", "shots", "shots_found", "false", "false_off_fringe")


class Count:
    """What a detector makes of one clip."""

    def __init__(self, finder: Finder, reach: float) -> None:
        self._finder, self._reach = finder, reach
        self.sums = dict.fromkeys(COUNTED, 0)
        self._shots, self._hit = set(), set()
        self.errors: List[float] = []
        self.places: List[Tuple[int, float, float]] = []
        self.missed: List[Tuple[int, float, float]] = []

    def look(self, frame: LabeledFrame, index: int) -> None:
        """Searches a frame and counts."""
        matched = set()
        for spot in self._finder.find(frame.image, frame.stamp):
            if spot.stamp != frame.stamp:
                continue
            apart, near = ([math.dist((spot.u, spot.v), one) for one in some] for some in (frame.spots, frame.unclear))
            if min(apart, default=math.inf) < self._reach:
                matched.add(int(np.argmin(apart)))
                self.errors.append(min(apart))
                continue
            self.sums["false"] += 1
            self.sums["false_off_fringe"] += min(near, default=math.inf) >= self._reach
            self.places.append((index, round(spot.u, 1), round(spot.v, 1)))
        self.missed += [(index, round(x), round(y)) for i, (x, y) in enumerate(frame.spots) if i not in matched]
        self._shots |= set(frame.shots)
        # painted spots belong to no shot
        self._hit |= {frame.shots[i] for i in matched if i < len(frame.shots)}
        for key, value in (("found", len(matched)), ("labels", len(frame.spots)), ("frames", 1)):
            self.sums[key] += value
        self.sums.update(shots=len(self._shots), shots_found=len(self._hit))


def figures(counts: Sequence[Count]) -> Dict[str, Any]:
    """Computes the figures of one clip, or of several."""
    sums = {key: sum(one.sums[key] for one in counts) for key in COUNTED}
    errors = [error for one in counts for error in one.errors]
    recall, false = proportion(sums["found"], sums["labels"]), proportion(sums["false"], sums["frames"]).scaled(1e3)
    return {
        **sums,
        "recall": sums["found"] / max(1, sums["labels"]),
        "recall_95": f"{recall.low:.3f} to {recall.high:.3f}",
        "false_per_1000": false.estimate,
        "false_95": f"{false.low:.2f} to {false.high:.2f}",
        "median_error_px": float(np.median(errors)) if errors else "",
    }


def main() -> int:
    parser = arguments(__doc__, other=True)
    parser.add_argument("folder", type=Path, metavar="DIR")
    parser.add_argument("--roles", nargs="+", default=list(ROLES), choices=ROLES)
    parser.add_argument("--left-out", type=Path, metavar="EXAMPLES")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    videos = json.loads((given.folder / "labels.json").read_text())["videos"]
    judges = judges_of_clips(given.left_out) if given.left_out else {}
    table = Table(given.csv)
    for role in given.roles:
        preset, counts = "stationary" if role == "stationary" else "mobile", {}
        for name, video in sorted(videos.items()):
            finders = {"as it comes": Finder(preset, confirm_frames=1)}
            if judges:
                finders["left out"] = Finder(preset, None, judges[name], confirm_frames=1)
            if given.other:
                finders["other"] = Finder(preset, given.other, confirm_frames=1)
            here = {version: Count(one, reach_in(video)) for version, one in finders.items()}
            for number, frame in enumerate(frames_of(given.folder / "clips" / name, video, role)):
                for count in here.values():
                    count.look(frame, number)
            for version, count in here.items():
                counts.setdefault(version, []).append(count)
                table.add(
                    role=role,
                    version=version,
                    clip=name,
                    **figures([count]),
                    false_at=count.places[:12],
                    missed_at=count.missed,
                )
        for version, some in counts.items():
            table.add(role=role, version=version, clip="all", **figures(some))
    return 0


if __name__ == "__main__":
    sys.exit(main())
