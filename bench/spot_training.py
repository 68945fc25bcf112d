#!/usr/bin/env python3
"""Trains the spot classifier on rendered scenes, labelled clips and recordings of one's own cameras.

    bench/spot_training.py --scenes 0.2 [--clips DIR ...] [--recording BAG TOPIC ...] --out FILE
    bench/spot_training.py --scenes 0.2 --keep scenes.npz       keeps the examples, for
    bench/spot_training.py --from scenes.npz [...] --out FILE

Without clips or recordings it learns from rendered scenes alone, says so in the file, and is the worse for it on real
pictures. Validates on clips and scenes that were left out, each as a whole. DIR as bench/spot_clips.py takes it.

A recording holds the images TOPIC and clicks TOPIC_mouse_left, which rqt_image_view publishes. Until 3 s before the first
click there must be no laser: people may walk, lights be switched. Then hold the spot still on some places, and click on it
in the image each time. What is seen within half a second of a click counts; the rest says nothing.
"""
from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any, Iterator, List

import cv2
import numpy as np

TOP = Path(__file__).resolve().parent.parent
for package in ("vb_core", "vb_laser_detect", "vb_sim"):
    sys.path.insert(0, str(TOP / "src" / package / "src"))
sys.path.insert(0, str(TOP / "bench"))
sys.path.insert(0, str(TOP / "src" / "vb_laser_detect" / "test"))

import spot_clips  # noqa: E402
from scenes import GREEN, RED, Scene, tinted  # noqa: E402
from vb_laser_detect.detector import DetectorParams  # noqa: E402
from vb_laser_detect.detection.training import Examples, Frame, collect, fit, load_examples, save, save_examples, validate  # noqa: E402

VARIANTS = {"stationary": ("plain",), "window": ("plain",)}
NEAR_FRAMES, FIRST_FRAMES = 8, 60  # of long clips those near a shot, and the first ones, tell enough
SCENE_REACH_PX = 14.0


def from_clip(folder: Path, name: str, video: dict, role: str, variant: str) -> Examples:
    """Examples of one clip in a role; see spot_clips."""
    size = spot_clips.VARIANTS[variant][1] * max(1.0, video["width"] / 640.0)
    skipped, step = spot_clips.UNLABELLED.get(name, ()), spot_clips.VARIANTS[variant][2]

    def frames() -> Iterator[Frame]:
        shots = np.array([one["frame"] for one in video["labels"]])
        for number, (stamp, image, labels) in enumerate(spot_clips.frames_of(folder / "clips" / name, video, role, variant)):
            if len(shots) and number > FIRST_FRAMES and np.abs(shots - number).min() > NEAR_FRAMES:
                continue
            here = [(one["x"], one["y"]) for one in labels if not one["near"]]
            near = [(one["x"], one["y"]) for one in labels if one["near"]]
            if number * step in skipped:
                near += [(u, v) for u in range(0, 1280, 8) for v in range(0, 720, 8)]
            yield Frame(stamp, image, here, near)

    preset = DetectorParams.stationary if role == "stationary" else DetectorParams.mobile
    return collect(frames(), preset(confirm_frames=1), name, spot_clips.REACH_PX * size)


def from_recording(bag_file: str, topic: str) -> Examples:
    """Examples of a camera's recorded images, with clicks on the spot; see above."""
    import rosbag
    from vb_core.ros.images import image_array
    from vb_laser_detect.detection.image_format import PixelReader

    with rosbag.Bag(bag_file) as bag:
        clicks = [(stamp.to_sec(), message.x, message.y)
                  for _, message, stamp in bag.read_messages(topics=[topic + "_mouse_left"])]
        encoding = next((message.encoding for _, message, _ in bag.read_messages(topics=[topic])), "")
        if not clicks or not encoding:
            raise SystemExit(f"{bag_file}: there are no images {topic}, or no clicks {topic}_mouse_left")
        reader = PixelReader()

        def frames() -> Iterator[Frame]:
            for _, message, stamp in bag.read_messages(topics=[topic]):
                image, now = reader.read(image_array(message), message.encoding), stamp.to_sec()
                nearest = min(clicks, key=lambda click: abs(click[0] - now))
                spots, unclear = [], []
                if abs(nearest[0] - now) <= 0.5:
                    spots = [nearest[1:]]
                elif now > clicks[0][0] - 3.0:
                    unclear = [(u, v) for u in range(0, image.shape[1], 8) for v in range(0, image.shape[0], 8)]
                yield Frame(message.header.stamp.to_sec(), image, spots, unclear)

        preset = DetectorParams.stationary(confirm_frames=1)
        return collect(frames(), preset, f"recording: {Path(bag_file).name}", SCENE_REACH_PX, encoding)


def from_sketches(seed: int, images: int = 60) -> Iterator[Examples]:
    """Examples of plain floors with things that are no spot, and in every second image a spot: cheap, and many kinds.

    White glints stand among Bayer images only: a webcam's spots look like them.
    """
    random = np.random.default_rng(seed)

    def walker(scene: Scene, floor: np.ndarray, i: int, way: np.ndarray) -> None:
        x = int(way[0] * 6 * i)
        floor[100 + int(60 * way[1]) : 230, x : x + 40 + int(40 * way[2])] = 90 * way[3:6]
        floor[150:190, x + 12 : x + 45] = 60 + 120 * way[6:9]

    def legs(scene: Scene, floor: np.ndarray, i: int, way: np.ndarray) -> None:
        for number in range(2):
            x = int(40 + 500 * way[number] + 30 * np.sin(0.3 * i + number))
            floor[40 + int(80 * way[2 + number]) :, x : x + 30] *= 0.15 + 0.2 * way[4]

    def papers(scene: Scene, floor: np.ndarray, i: int, way: np.ndarray) -> None:
        for number in range(6):
            x, y, size = int(40 + 540 * way[number]), int(30 + 280 * way[number + 1]), 5 + int(60 * way[number + 2] ** 2)
            if (i + 7 * number) % 24 < 12:
                floor[y : y + size, x : x + int(size * (0.8 + way[number + 3]))] = (20, 190, 240, 250)[number % 4]

    def nothing(scene: Scene, floor: np.ndarray, i: int, way: np.ndarray) -> None:
        pass

    for name, change in (("walker", walker), ("legs", legs), ("papers", papers), ("glints", nothing)):
        for bayer in (False, True):
            if name == "glints" and not bayer:
                continue
            scene = tinted(Scene(seed=seed, brightness=random.uniform(50, 160)))
            plain, glow, way = scene.floor.copy(), random.uniform(0.5, 4.0, 3), random.uniform(0, 1, 12)

            def frames() -> Iterator[Frame]:
                for i in range(images):
                    floor = plain.copy()
                    if i >= 6:
                        change(scene, floor, i, way)
                    spot = tuple(random.uniform((30, 30), (610, 330)))
                    lit = i >= 6 and i % 2 == 0
                    image = scene.render([spot] if lit else [], random.uniform(0.9, 4.0), random.uniform(150, 500),
                                         (RED, GREEN)[i // 2 % 2], floor=floor, bayer=bayer)
                    if name == "glints" and i >= 6:
                        for number in range(3):
                            place = (60 + 170 * number + 9.3 * i * way[number] % 160, 40 + 250 * way[3 + number] + 2.1 * i)
                            image = np.maximum(image, scene.render(
                                [place], glow[number], random.uniform(150, 900), (1.0, 1.0, 1.0), floor=floor, bayer=bayer))
                    yield Frame(0.04 * i, image, [spot] if lit else [])

            yield collect(frames(), DetectorParams.stationary(confirm_frames=1), f"sketch: {name}{' bayer' * bayer}", 6.0,
                          "bayer_rggb8" if bayer else "bgr8")


def from_scenes(share: float, seed: int) -> Iterator[Examples]:
    """Examples of rendered scenes, so much of each one's time; other floors, noise and ways than spot_detection's."""
    import spot_scenes as scenes

    scenes.LEARN_S, scenes.QUIET_S, scenes.DRAW_S = 0.5, 8.0 * share, 10.0 * share
    room, rooms = scenes.lab(), scenes.Rooms(scenes.CameraModels(), seed)
    for scene in scenes.ceiling_scenes(room) + scenes.mobile_scenes(room):
        yield collect(*_rendered(scenes, scene, rooms, share))


def _rendered(scenes: Any, scene: Any, rooms: Any, share: float) -> Any:
    camera = scenes.Camera(scene, rooms)
    name = ("robot: " if scene.mobile else "ceiling: ") + scene.name
    encoding = {"encoding": "bgr8" if scene.mobile else scene.worlds[0].camera(scene.camera).encoding}

    def frames() -> Iterator[Frame]:
        for t, image, frame, view, snapshot in camera.pictures(scene, 8.0 * share, 10.0 * share):
            places: List[Any] = []
            if snapshot.laser is not None:
                spot = view.spot(snapshot, frame.pose) if scene.mobile else view.spot(snapshot)
                places = [tuple(spot.center)] if spot is not None else []
            clear = places and view.spot_share(snapshot) >= 0.7
            yield Frame(t, image, places if clear else [], [] if clear else places, (frame.to_floor, None))

    preset = DetectorParams.mobile if scene.mobile else DetectorParams.stationary
    return frames(), preset(confirm_frames=1), name, SCENE_REACH_PX, encoding["encoding"]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=Path, nargs="*", default=[], metavar="DIR")
    parser.add_argument("--recording", nargs=2, action="append", default=[], metavar=("BAG", "TOPIC"))
    parser.add_argument("--scenes", type=float, default=0.0, metavar="SHARE", help="of each scene's time; 0: none")
    parser.add_argument("--sketches", type=int, default=0, metavar="N", help="so many rounds of plain floors with things on them")
    parser.add_argument("--seed", type=int, default=7, help="of the rendered rooms")
    parser.add_argument("--keep", type=Path, help="write the examples")
    parser.add_argument("--from", type=Path, nargs="*", default=[], dest="kept", help="examples that were kept")
    parser.add_argument("--out", type=Path, help="write the classifier")
    parser.add_argument("--no-validation", action="store_true")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    parts: List[Examples] = []
    if given.kept:
        parts.append(load_examples(given.kept))
    for folder in given.clips:
        videos = sorted(json.loads((folder / "labels.json").read_text())["videos"].items())
        for name, video in videos:
            for role, variants in VARIANTS.items():
                for variant in variants:
                    parts.append(from_clip(folder, name, video, role, variant))
                    print(f"{name:46s} {role:10s} {variant:14s} {parts[-1].truth.sum():5d} spots of {len(parts[-1].truth)}",
                          flush=True)
    for bag, topic in given.recording:
        parts.append(from_recording(bag, topic))
        print(f"{bag} {topic}: {parts[-1].truth.sum()} spots of {len(parts[-1].truth)}", flush=True)
    if given.sketches:
        for part in (part for number in range(given.sketches) for part in from_sketches(given.seed + number)):
            parts.append(part)
            print(f"{part.groups[0]:60s} {part.truth.sum():5d} spots of {len(part.truth)}", flush=True)
    if given.scenes:
        for part in from_scenes(given.scenes, given.seed):
            if len(part.truth):
                parts.append(part)
                print(f"{part.groups[0]:60s} {part.truth.sum():5d} spots of {len(part.truth)}", flush=True)
    examples = Examples.joined([part for part in parts if len(part.truth)])
    if given.keep:
        save_examples(examples, given.keep)
    print(f"{len(examples.truth)} examples, {examples.truth.sum()} spots, {len(np.unique(examples.groups))} clips and scenes")
    if not given.no_validation:
        for group, truth, score in validate(examples):
            print(f"left out: {group:56s} spots found {int((score[truth] > 0).sum()):5d} of {int(truth.sum()):5d}, "
                  f"others taken for one {int((score[~truth] > 0).sum()):4d} of {int((~truth).sum()):5d}", flush=True)
    if given.out:
        names = [str(name) for name in np.unique(examples.groups)]
        kinds = [name.split(":")[0] if ":" in name else "clip" for name in names]
        save(fit(examples), given.out, ", ".join(f"{kinds.count(kind)} of kind '{kind}'" for kind in sorted(set(kinds))))
        print(f"written to {given.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
