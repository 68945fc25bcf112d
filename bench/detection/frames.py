#!/usr/bin/env python3
"""How right and how fast the spot detector is on rendered images; labelled clips: clips.py.

    python3 bench/detection/frames.py --scenes [WORD ...]      every hard case (scene_list.py), or those with a WORD in the name
    python3 bench/detection/frames.py --times [WORD ...]       time of a search
    ... --other REVISION|SRC                                   also another version, on the same images in turns

Times are a thread's own, [ms] per image; only the ratios count on a busy computer.
"""

from __future__ import annotations

import sys
from typing import Any, List

import cv2
import numpy as np

from bench.detection.finder import Finder
from bench.detection.hard_scenes import RATE, Camera, play
from bench.detection.rooms import Rooms, lab
from bench.detection.scene_list import ceiling_scenes, mobile_scenes
from bench.frame import TOP, Table, arguments, in_turns

CASES = ("ceiling bgr8 1080p", "ceiling bayer_rggb8 1080p", "ceiling bgr8 4K", "robot, standing", "robot, turning")
IMAGES = 10


def images_of(case: str) -> List[np.ndarray]:
    """Renders the images of a case: the first two without a spot."""
    sys.path.insert(0, str(TOP / "src/vb_laser_detect/test"))
    import scenes

    width, height = (640, 480) if "robot" in case else (3840, 2160) if "4K" in case else (1920, 1080)
    scene, images = scenes.Scene(width + 200, height + 100), []
    for i in range(2 + IMAGES):
        shift = 3 * i if "turning" in case else 0
        floor = np.ascontiguousarray(scene.floor[shift : shift + height, 4 * shift : 4 * shift + width])
        spots = [(0.3 * width + 20.0 * i, 0.4 * height + 6.0 * i)] if i >= 2 else []
        images.append(scene.render(spots, color=scenes.RED, floor=floor, bayer="bayer" in case, smear=(8.0, 3.0)))
    return images


def time_searches(given: Any, table: Table) -> None:
    """Times ten images there and back, in turns."""
    for case in (case for case in CASES if any(word in case for word in given.times or [""])):
        role, encoding = "mobile" if "robot" in case else "stationary", "bayer_rggb8" if "bayer" in case else "bgr8"
        images, stamps = images_of(case), {}
        finders = {"this": Finder(role)}
        if given.other:
            finders["other"] = Finder(role, given.other)

        def search(name: str) -> None:
            for image in (images[:2] if name not in stamps else []) + images[2:] + images[:1:-1]:
                stamps[name] = stamps.get(name, 0.0) + 1.0 / RATE
                finders[name].find(image, stamps[name], encoding=encoding)

        found = in_turns({name: lambda name=name: search(name) for name in finders}, given.rounds)
        per_image = {key: value / (2 * IMAGES) if key.endswith("_ms") else value for key, value in found.items()}
        table.add(case=case, **per_image)


def play_scenes(given: Any, table: Table) -> None:
    """Plays the scenes, each to every version."""
    room, rooms = lab(), Rooms(given.seed)
    scenes = ceiling_scenes(room) + mobile_scenes(room)
    for scene in scenes:
        if given.scenes and not any(word in scene.title for word in given.scenes):
            continue
        cameras = {"this": Camera(scene, rooms)}
        if given.other:
            cameras["other"] = Camera(scene, rooms, given.other)
        for version, outcome in zip(cameras, play(scene, list(cameras.values()), given.share)):
            table.add(scene=scene.title, version=version, seed=given.seed, share=given.share, **outcome.summary())


def main() -> int:
    parser = arguments(__doc__, seed=1, other=True)
    parser.add_argument("--scenes", nargs="*", metavar="WORD")
    parser.add_argument("--share", type=float, default=1.0, help="of each scene's time")
    parser.add_argument("--times", nargs="*", metavar="WORD")
    parser.add_argument("--rounds", type=int, default=6, help="of --times")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    table = Table(given.csv)
    if given.times is not None:
        time_searches(given, table)
    if given.scenes is not None:
        play_scenes(given, table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
