#!/usr/bin/env python3
"""Measures the spot detector's accuracy in the rendered scenes of scene_list.py (for clips: clip_accuracy.py).

    python3 bench/detection/scene_accuracy.py [WORD ...] [--share PART] [--jpeg] [--other REVISION|SRC] [--csv FILE]

Runs only scenes with a WORD in their name, and this PART of each scene's time. Another version sees the same images.
With --jpeg, the ceiling cameras are webcams that the detector reads directly.
"""

from __future__ import annotations

import cv2

from bench.detection.detector_under_test import DetectionScore, DetectorRunner, figures
from bench.detection.scene_rendering import NEAR_MM, Rooms, floor_place, frames, lab
from bench.detection.scene_list import ceiling_scenes, mobile_scenes
from bench.harness import ResultTable, arguments, versions
from bench.lab.camera_clip import webcam_jpeg


def main() -> None:
    parser = arguments(__doc__, seed=1, other=True)
    parser.add_argument("scenes", nargs="*", default=[""], metavar="WORD")
    parser.add_argument("--share", type=float, default=1.0)
    parser.add_argument("--jpeg", action="store_true")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    table = ResultTable(options.csv, options.seed)
    room, rooms = lab(), Rooms(options.seed)
    scores_by_version = {}
    scenes = ceiling_scenes(room)
    if not options.jpeg:
        scenes += mobile_scenes(room)
    for scene in scenes:
        if any(word in scene.title for word in options.scenes):
            runners = {version: DetectorRunner(scene.role, source) for version, source in versions(options).items()}
            scores = {version: DetectionScore(runner, NEAR_MM, floor_place) for version, runner in runners.items()}
            for frame in frames(scene, rooms, options.share):
                if options.jpeg:
                    frame = frame._replace(image=webcam_jpeg(frame.image, frame.encoding), encoding="jpeg")
                for score in scores.values():
                    score.add_frame(frame)
            for version, score in scores.items():
                result = {**figures([score], "mm"), "false_at": score.false_spots[:12]}
                table.add(scene=scene.title, version=version, share=options.share, **result)
                scores_by_version.setdefault(version, []).append(score)
    for version, all_scores in scores_by_version.items():
        table.add(scene="all", version=version, share=options.share, **figures(all_scores, "mm"))


if __name__ == "__main__":
    main()
