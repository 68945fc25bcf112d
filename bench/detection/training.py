#!/usr/bin/env python3
"""Trains the spot classifier on rendered scenes and labelled clips.

    python3 bench/detection/training.py --clips DIR --out FILE     makes the packaged classifier, with DIR as
                                                        clip_accuracy.py takes it; the clips are not part of the project
    python3 bench/detection/training.py --out FILE                  from rendered scenes alone: the file says so,
                                                        and it is worse on real pictures
    ... --examples FOLDER                               where the examples of each scene and clip are kept, a file
                                                        each (default: out/spot_examples); existing ones are not made
                                                        again. Delete the folder when the detector has changed

Each clip is also taken again as other cameras would have taken it (augmentation.py). Validates on held-out examples:
with a clip all of its camera and all of its room, with a scene a fifth of all. Probabilities are calibrated on the same
examples. Everything is seeded, so that on one machine the same file is made; another processor may round rendered
images differently.
"""

from __future__ import annotations

import json
import math
import re
import zlib
from functools import partial
from pathlib import Path
from typing import Callable, Dict, Iterable, Iterator, List, Optional, Sequence, Tuple

import cv2
import numpy as np
import pandas

from bench.detection import clip_frames, curve_fitting
from bench.detection.augmentation import CameraSettings, takes
from bench.detection.detector_under_test import Finder, LabeledFrame
from bench.detection.scene_rendering import Scene, frames
from bench.detection.scene_rooms import Rooms, lab
from bench.detection.scene_list import ceiling_scenes, mobile_scenes, training_scenes
from bench.harness import TOP, Table, arguments, share
from vb_laser_detect.detection.features import Blob, SpotClassifier

SCENES_SHARE, SCENES_SEED, LEARN_S = 0.2, 7, 0.5  # of each scene's time; other rooms than scene_accuracy.py's
SCENE_REACH_PX, CLEAR = 14.0, 0.7  # [px], and how much of a spot's light must arrive for an example


class Oracle(SpotClassifier):
    """Stands in for the classifier: answers from the current frame's labels, and records the candidates.

    The detector itself proposes and measures, and the background adopts what a right classifier would leave to it. In
    images with a labelled spot nothing else is recorded: it is much the same in each, and would count many times.
    """

    def __init__(self, reach: float) -> None:
        super().__init__({}, 0.0)
        self.reach = reach
        self.frame: Optional[LabeledFrame] = None
        self.rows: List[Dict[str, float]] = []
        self.truth: List[bool] = []

    def classify(self, blob: Blob, expected: bool) -> Tuple[float, str]:
        """Returns the truth as a probability."""
        right = self._near(blob, self.frame.spots)
        if right or not (self.frame.spots or self._near(blob, self.frame.unclear)):
            self.rows.append(blob.features)
            self.truth.append(right)
        return float(right), "known"

    def _near(self, blob: Blob, places: Iterable[Tuple[float, float]]) -> bool:
        return any(math.hypot(blob.u - u, blob.v - v) < self.reach for u, v in places)


def collect(shown: Iterable[LabeledFrame], role: str, group: str, reach: float) -> pandas.DataFrame:
    """Collects the examples of one clip or scene.

    Args:
        reach: [px] a blob nearer than this to a spot's position is the spot.
        group: its name; validation leaves whole groups out.

    Returns:
        A row for each blob: its features, NaN where unknown, and its truth; the group is the index.
    """
    oracle = Oracle(reach)
    finder = Finder(role, None, oracle, confirm_frames=1)
    for frame in shown:
        oracle.frame = frame
        finder.find(frame)
    # OpenCV's sums in single precision depend on memory alignment, far beyond these digits
    values = np.round(np.array([list(row.values()) for row in oracle.rows], float), 5)
    names = list(oracle.rows[0]) if oracle.rows else None
    return pandas.DataFrame(values, index=[group] * len(values), columns=names).assign(truth=oracle.truth)


def from_clip(
    folder: Path, name: str, video: dict, group: str, taken: Optional[CameraSettings] = None
) -> pandas.DataFrame:
    """Collects the examples of one clip, seen by a camera that stands still; moving ones are for evaluation only."""
    shown = clip_frames.frames_near_shots(folder, name, video, group, taken)
    return collect(shown, "stationary", group, clip_frames.reach_in(video))


def from_scene(scene: Scene, rooms: Rooms) -> pandas.DataFrame:
    """Collects the examples of the first part of a rendered scene."""
    shown = frames(scene, rooms, SCENES_SHARE, LEARN_S, CLEAR, on_floor=False)
    return collect(shown, scene.role, scene.title, SCENE_REACH_PX)


def parts_of(clips: Optional[Path], words: Sequence[str]) -> Iterator[Tuple[str, Callable[[], pandas.DataFrame]]]:
    """Yields the names of the scenes and clips that are asked for, and functions that collect their examples."""
    room, rooms = lab(), Rooms(SCENES_SEED)
    for scene in ceiling_scenes(room) + mobile_scenes(room) + training_scenes(room):
        if any(word in scene.title for word in words):
            yield scene.title, partial(from_scene, scene, rooms)
    if clips:
        for name, video in sorted(json.loads((clips / "labels.json").read_text())["videos"].items()):
            yield name, partial(from_clip, clips, name, video, name)
            for group, taken in takes(name, np.random.default_rng(zlib.crc32(name.encode()))):
                yield group, partial(from_clip, clips, name, video, group, taken)


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--clips", type=Path, metavar="DIR")
    parser.add_argument(
        "--scenes", nargs="+", default=[""], metavar="WORD", help="only those with a WORD in their name"
    )
    parser.add_argument("--examples", type=Path, metavar="FOLDER", default=TOP / "out" / "spot_examples")
    parser.add_argument("--out", type=Path, help="write the classifier")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    given.examples.mkdir(parents=True, exist_ok=True)
    files = []
    for name, make in parts_of(given.clips, given.scenes):
        file = given.examples / (re.sub(r"\W+", "_", name) + ".csv")
        if not file.exists():
            part = file.with_suffix(".part")  # the file appears only once it is complete
            make().to_csv(part)
            part.replace(file)
            print(f"made {file.name}", flush=True)
        files.append(file)
    examples = curve_fitting.load_examples(files)
    names = sorted(set(examples.index))
    print(f"{len(examples.truth)} examples, {examples.truth.sum()} spots, {len(names)} clips and scenes")
    table = Table(given.csv)
    left_out = curve_fitting.leave_out(examples)
    for group, (_, truth, score) in left_out.items():
        found, taken = int((score[truth] > 0).sum()), int((score[~truth] > 0).sum())
        table.add(
            left_out=group, spots=int(truth.sum()), found=found, others=int((~truth).sum()), taken_for_spots=taken
        )
    groups = pandas.DataFrame(table.rows)
    for kind, part in groups.groupby(groups.left_out.map(curve_fitting.kind_of)):
        spots, found, others, taken = part[["spots", "found", "others", "taken_for_spots"]].sum()
        table.add(left_out=f"each {kind}", found=share(found, spots), taken_for_spots=share(taken, others))
    if given.out:
        kinds = [curve_fitting.kind_of(name) for name in names]
        trained_on = ", ".join(f"{kinds.count(kind)} of kind '{kind}'" for kind in sorted(set(kinds)))
        made = curve_fitting.calibrate(curve_fitting.fit(examples), left_out.values())
        curve_fitting.save(made, given.out, trained_on + ("" if "clip" in kinds else "; without clips of real cameras"))


if __name__ == "__main__":
    main()
