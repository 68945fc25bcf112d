#!/usr/bin/env python3
"""Trains the spot classifier on rendered scenes and labelled clips.

    python3 bench/detection/training.py --clips DIR --out FILE    trains the packaged classifier
    python3 bench/detection/training.py --out FILE                trains on rendered scenes only: worse on real pictures

DIR is as for clip_accuracy.py. The examples are stored in the folder --examples (default: out/spot_examples), one file for
each scene and clip. Existing files are used, so delete the folder when the detector has changed.

Each clip is also augmented as other cameras would record it (augmentation.py). The classifier is validated on held-out
examples: with a clip, all clips of its camera and room are held out; with a scene, a fifth of all scenes. The same
examples calibrate its probabilities. Everything is seeded, so the file can be reproduced on one machine; another
processor may round rendered images differently.
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

from bench.detection import clip_frames, classifier_examples
from bench.detection.augmentation import CameraSettings, draw_augmentations
from bench.detection.detector_under_test import DetectorRunner, LabeledFrame
from bench.detection.scene_rendering import Rooms, Scene, frames, lab
from bench.detection.scene_list import ceiling_scenes, mobile_scenes, training_scenes
from bench.harness import TOP, ResultTable, arguments, share
from vb_laser_detect.detection.classifier_fitting import write_classifier
from vb_laser_detect.detection.features import Blob, SpotClassifier

SCENES_SHARE = 0.2  # of each scene's time
SCENES_SEED = 7  # of the rooms, which differ from those of scene_accuracy.py
LEARN_S = 0.5  # [s] with the empty room
SCENE_REACH_PX = 14.0  # [px] from a spot's position, below which a blob is the spot
CLEAR = 0.7  # share of its light at which a spot becomes an example


class Oracle(SpotClassifier):
    """Takes the classifier's place: answers with the current frame's labels, and records the candidates.

    The detector finds and measures blobs as usual, and its background learns those that a perfect classifier would
    reject. In an image with a labelled spot only the spot is recorded, because the other blobs hardly change.
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


def collect(labeled_frames: Iterable[LabeledFrame], role: str, group: str, reach: float) -> pandas.DataFrame:
    """Collects the examples of one clip or scene.

    Args:
        reach: [px] from a spot's position, below which a blob is the spot.
        group: the name of the clip or scene; validation leaves whole groups out.

    Returns:
        A row for each blob: its features, NaN if unknown, and its truth; the group is the index.
    """
    oracle = Oracle(reach)
    runner = DetectorRunner(role, None, oracle, confirm_frames=1)
    for frame in labeled_frames:
        oracle.frame = frame
        runner.find(frame)
    # rounds, because OpenCV's sums in single precision depend on memory alignment in their last digits
    values = np.round(np.array([list(row.values()) for row in oracle.rows], float), 5)
    names = list(oracle.rows[0]) if oracle.rows else None
    return pandas.DataFrame(values, index=[group] * len(values), columns=names).assign(truth=oracle.truth)


def collect_from_clip(
    folder: Path, name: str, video: dict, group: str, settings: Optional[CameraSettings] = None
) -> pandas.DataFrame:
    """Collects the examples of one clip for a stationary camera; moving cameras are used for evaluation only."""
    labeled_frames = clip_frames.frames_near_shots(folder, name, video, group, settings)
    return collect(labeled_frames, "stationary", group, clip_frames.reach_in(video))


def collect_from_scene(scene: Scene, rooms: Rooms) -> pandas.DataFrame:
    """Collects the examples of the first part of a rendered scene."""
    shown = frames(scene, rooms, SCENES_SHARE, LEARN_S, CLEAR, on_floor=False)
    return collect(shown, scene.role, scene.title, SCENE_REACH_PX)


def list_sources(clips: Optional[Path], words: Sequence[str]) -> Iterator[Tuple[str, Callable[[], pandas.DataFrame]]]:
    """Yields the names of the selected scenes and clips, and functions that collect their examples."""
    room, rooms = lab(), Rooms(SCENES_SEED)
    for scene in ceiling_scenes(room) + mobile_scenes(room) + training_scenes(room):
        if any(word in scene.title for word in words):
            yield scene.title, partial(collect_from_scene, scene, rooms)
    if clips:
        for name, video in sorted(json.loads((clips / "labels.json").read_text())["videos"].items()):
            yield name, partial(collect_from_clip, clips, name, video, name)
            random = np.random.default_rng(zlib.crc32(name.encode()))
            for group, settings in draw_augmentations(name, random):
                yield group, partial(collect_from_clip, clips, name, video, group, settings)


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--clips", type=Path, metavar="DIR")
    parser.add_argument("--scenes", nargs="+", default=[""], metavar="WORD", help="only scenes with a WORD in the name")
    parser.add_argument("--examples", type=Path, metavar="FOLDER", default=TOP / "out" / "spot_examples")
    parser.add_argument("--out", type=Path, help="write the classifier")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    options.examples.mkdir(parents=True, exist_ok=True)
    files = []
    for name, make in list_sources(options.clips, options.scenes):
        file = options.examples / (re.sub(r"\W+", "_", name) + ".csv")
        if not file.exists():
            unfinished = file.with_suffix(".part")  # the file appears only once it is complete
            make().to_csv(unfinished)
            unfinished.replace(file)
            print(f"made {file.name}", flush=True)
        files.append(file)
    examples = classifier_examples.load_examples(files)
    names = sorted(set(examples.index))
    print(f"{len(examples.truth)} examples, {examples.truth.sum()} spots, {len(names)} clips and scenes")
    table = ResultTable(options.csv)
    left_out = classifier_examples.leave_out(examples)
    for group, (_, truth, score) in left_out.items():
        found, false_spots = (int((score[selected] > 0).sum()) for selected in (truth, ~truth))
        spots, others = (int(selected.sum()) for selected in (truth, ~truth))
        table.add(left_out=group, spots=spots, found=found, others=others, taken_for_spots=false_spots)
    groups = pandas.DataFrame(table.rows)
    for kind, rows in groups.groupby(groups.left_out.map(classifier_examples.kind_of)):
        spots, found, others, false_spots = rows[["spots", "found", "others", "taken_for_spots"]].sum()
        table.add(left_out=f"each {kind}", found=share(found, spots), taken_for_spots=share(false_spots, others))
    if options.out:
        kinds = [classifier_examples.kind_of(name) for name in names]
        sources = ", ".join(f"{kinds.count(kind)} of kind '{kind}'" for kind in sorted(set(kinds)))
        classifier = classifier_examples.calibrate_classifier(classifier_examples.fit(examples), left_out.values())
        note = "" if "clip" in kinds else "; without clips of real cameras"
        write_classifier(classifier, options.out, sources + note)


if __name__ == "__main__":
    main()
