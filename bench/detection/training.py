#!/usr/bin/env python3
"""Trains the spot classifier on rendered scenes, labelled clips and recordings of one's own cameras.

    bench/detection/training.py --clips DIR --out FILE      makes the classifier that comes with the package, with DIR as
                                                       bench/detection/clips.py takes it; the clips are not part of the project
    bench/detection/training.py --out FILE                  from rendered scenes alone: says so in the file, and is the worse
                                                       for it on real pictures
    ... --recording BAG TOPIC                          with one's own camera; may be repeated
    ... --examples FOLDER                              where the examples of each scene, clip and recording are kept, a file
                                                       each (default: out/spot_examples): what is there is not rendered
                                                       again, so the command goes on where it was stopped. Delete the
                                                       folder when the detector has changed

Validates on clips, scenes and recordings that were left out, each as a whole. --compare FILE tells how far the result
is from another classifier's numbers: everything is seeded, so on one machine it is the same; another processor may
round rendered images differently.

A recording holds the images TOPIC and clicks TOPIC_mouse_left, which rqt_image_view publishes. Until 3 s before the
first
click there must be no laser: people may walk, lights be switched. Then hold the spot still on some places, and click on
it in the image each time. What is seen within half a second of a click counts; the rest says nothing.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from pathlib import Path
from typing import Any, Callable, Iterator, List, Tuple

import cv2
import numpy as np

TOP = Path(__file__).resolve().parents[2]
for package in ("vb_core", "vb_laser_detect", "vb_sim"):
    sys.path.insert(0, str(TOP / "src" / package / "src"))

import clips  # noqa: E402

from vb_evaluation.result_table import append_rows  # noqa: E402
from vb_laser_detect.detection import classifier  # noqa: E402
from vb_laser_detect.detection.training import (  # noqa: E402
    Examples,
    LabeledFrame,
    collect,
    fit,
    load_examples,
    logits,
    save,
    save_examples,
    validate,
)
from vb_laser_detect.detector import DetectorParams  # noqa: E402

SCENES_SHARE, SCENES_SEED = 0.2, 7  # of each scene's time; other rooms than frames.py's
NEAR_FRAMES, FIRST_FRAMES = 8, 60  # of long clips those near a shot, and the first ones, tell enough
SCENE_REACH_PX = 14.0


def from_clip(folder: Path, name: str, video: dict) -> Examples:
    """Examples of one clip, seen by a camera that stands still: what it sees moving is only judged by."""
    size, skipped = max(1.0, video["width"] / 640.0), clips.UNLABELED.get(name, ())

    def frames() -> Iterator[LabeledFrame]:
        shots = np.array([one["frame"] for one in video["labels"]])
        for number, (stamp, image, labels) in enumerate(
            clips.frames_of(folder / "clips" / name, video, "stationary", "plain")
        ):
            if len(shots) and number > FIRST_FRAMES and np.abs(shots - number).min() > NEAR_FRAMES:
                continue
            here = [(one["x"], one["y"]) for one in labels if not one["near"]]
            near = [(one["x"], one["y"]) for one in labels if one["near"]]
            if number in skipped:
                near += [(u, v) for u in range(0, 1280, 8) for v in range(0, 720, 8)]
            yield LabeledFrame(stamp, image, here, near)

    return collect(frames(), DetectorParams.stationary(confirm_frames=1), name, clips.REACH_PX * size)


def from_recording(bag_file: str, topic: str) -> Examples:
    """Examples of a camera's recorded images, with clicks on the spot; see above."""
    import rosbag

    from vb_core.ros.images import array_from_image
    from vb_laser_detect.detection.image_format import PixelReader

    with rosbag.Bag(bag_file) as bag:
        clicks = [
            (stamp.to_sec(), message.x, message.y)
            for _, message, stamp in bag.read_messages(topics=[topic + "_mouse_left"])
        ]
        encoding = next((message.encoding for _, message, _ in bag.read_messages(topics=[topic])), "")
        if not clicks or not encoding:
            raise SystemExit(f"{bag_file}: there are no images {topic}, or no clicks {topic}_mouse_left")
        reader = PixelReader()

        def frames() -> Iterator[LabeledFrame]:
            for _, message, stamp in bag.read_messages(topics=[topic]):
                image, now = reader.read(array_from_image(message), message.encoding), stamp.to_sec()
                nearest = min(clicks, key=lambda click: abs(click[0] - now))
                spots, unclear = [], []
                if abs(nearest[0] - now) <= 0.5:
                    spots = [nearest[1:]]
                elif now > clicks[0][0] - 3.0:
                    unclear = [(u, v) for u in range(0, image.shape[1], 8) for v in range(0, image.shape[0], 8)]
                yield LabeledFrame(message.header.stamp.to_sec(), image, spots, unclear)

        preset = DetectorParams.stationary(confirm_frames=1)
        return collect(frames(), preset, f"recording: {Path(bag_file).name}", SCENE_REACH_PX, encoding)


def scene_parts(share: float, seed: int) -> Iterator[Tuple[str, Callable[[], Examples]]]:
    """Names of rendered scenes, and what makes their examples from so much of each one's time.

    Other floors, noise and ways than frames.py's.
    """
    import hard_scenes as scenes

    scenes.LEARN_S, scenes.QUIET_S, scenes.DRAW_S = 0.5, 8.0 * share, 10.0 * share
    room, rooms = scenes.lab(), scenes.Rooms(scenes.CameraModels(), seed)
    for scene in scenes.ceiling_scenes(room) + scenes.mobile_scenes(room) + scenes.training_scenes(room):
        name = ("robot: " if scene.mobile else "ceiling: ") + scene.name
        yield name, lambda scene=scene, name=name: collect(*_rendered(scenes, scene, rooms, share, name))


def _rendered(scenes: Any, scene: Any, rooms: Any, share: float, name: str) -> Any:
    camera = scenes.Camera(scene, rooms)
    encoding = {"encoding": "bgr8" if scene.mobile else scene.worlds[0].camera(scene.camera).encoding}

    def frames() -> Iterator[LabeledFrame]:
        for t, image, frame, view, snapshot in camera.pictures(scene, 8.0 * share, 10.0 * share):
            places: List[Any] = []
            if snapshot.laser is not None:
                spot = view.spot(snapshot, frame.pose) if scene.mobile else view.spot(snapshot)
                places = [tuple(spot.center)] if spot is not None else []
            clear = places and view.spot_share(snapshot) >= 0.7
            yield LabeledFrame(t, image, places if clear else [], [] if clear else places, (frame.to_floor, None))

    preset = DetectorParams.mobile if scene.mobile else DetectorParams.stationary
    return frames(), preset(confirm_frames=1), name, SCENE_REACH_PX, encoding["encoding"]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=Path, metavar="DIR")
    parser.add_argument("--recording", nargs=2, action="append", default=[], metavar=("BAG", "TOPIC"))
    parser.add_argument("--examples", type=Path, metavar="FOLDER", default=TOP / "out" / "spot_examples")
    parser.add_argument("--out", type=Path, help="write the classifier")
    parser.add_argument("--compare", type=Path, help="with a classifier of an earlier run")
    parser.add_argument("--csv", type=Path, help="append a row for each clip and scene that was left out")
    parser.add_argument("--no-validation", action="store_true")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    given.examples.mkdir(parents=True, exist_ok=True)
    files = []
    for name, make in parts_of(given):
        file = given.examples / (re.sub(r"\W+", "_", name) + ".npz")
        if not file.exists():
            save_examples(make(), file)
            print(f"made {file.name}", flush=True)
        files.append(file)
    examples = load_examples(files)
    print(
        f"{len(examples.truth)} examples, {examples.truth.sum()} spots, {len(np.unique(examples.groups))} clips and scenes"
    )
    if not given.no_validation:
        rows = []
        for group, truth, score in validate(examples):
            rows.append(
                {
                    "left_out": group,
                    "spots": int(truth.sum()),
                    "found": int((score[truth] > 0).sum()),
                    "others": int((~truth).sum()),
                    "taken_for_spots": int((score[~truth] > 0).sum()),
                }
            )
            print(
                f"left out: {group:56s} spots found {int((score[truth] > 0).sum()):5d} of {int(truth.sum()):5d}, "
                f"others taken for one {int((score[~truth] > 0).sum()):4d} of {int((~truth).sum()):5d}",
                flush=True,
            )
        if given.csv:
            append_rows(given.csv, rows)
    if given.out:
        names = [str(name) for name in np.unique(examples.groups)]
        kinds = [name.split(":")[0] if ":" in name else "clip" for name in names]
        trained_on = ", ".join(f"{kinds.count(kind)} of kind '{kind}'" for kind in sorted(set(kinds)))
        save(fit(examples), given.out, trained_on + ("" if "clip" in kinds else "; without clips of real cameras"))
        print(f"written to {given.out}")
        if given.compare:
            compare(classifier.load(str(given.out)), classifier.load(str(given.compare)), examples)
    return 0


def parts_of(given: argparse.Namespace) -> Iterator[Tuple[str, Callable[[], Examples]]]:
    """Names of the scenes, clips and recordings that the command asks for, and what makes their examples."""
    yield from scene_parts(SCENES_SHARE, SCENES_SEED)
    if given.clips:
        for name, video in sorted(json.loads((given.clips / "labels.json").read_text())["videos"].items()):
            yield name, lambda name=name, video=video: from_clip(given.clips, name, video)
    for bag, topic in given.recording:
        yield f"recording: {Path(bag).name}", lambda bag=bag, topic=topic: from_recording(bag, topic)


def compare(made: classifier.SpotClassifier, other: classifier.SpotClassifier, examples: Examples) -> None:
    """Prints how much two classifiers differ."""
    same = (
        made.intercept == other.intercept
        and set(made.curves) == set(other.curves)
        and all(
            np.array_equal(made.curves[name][part], other.curves[name][part]) for name in made.curves for part in (0, 1)
        )
    )
    scores = logits(made, examples), logits(other, examples)
    print(
        f"{'the same numbers' if same else 'other numbers'} as the one compared with: logits differ by up to "
        f"{np.abs(scores[0] - scores[1]).max():.3f}, {int(((scores[0] > 0) != (scores[1] > 0)).sum())} of "
        f"{len(scores[0])} examples are judged otherwise"
    )


if __name__ == "__main__":
    sys.exit(main())
