#!/usr/bin/env python3
"""Measures the spot detector's accuracy on labelled clips, in each role of a camera.

    python3 bench/detection/clip_accuracy.py DIR [--roles stationary mobile window] [--left-out EXAMPLES]
                                     [--other REVISION|SRC] [--csv FILE]

DIR contains labels.json and clips/. There are three roles: stationary, a fixed camera; mobile, a robot's camera that
sees the same pictures while the robot stands; and window, a robot's camera that looks about. A window that pans, tilts
and rolls over the pictures by a few pixels per image simulates the last one. Detectors know neither focal length nor pose.

All versions see the same pictures in turns, and spots need no confirmation by a second image. With `--left-out`
(examples stored by training.py), a detector whose classifier was fitted without clips of the same camera or room is
measured too.

A spot within 10 px (of 640 x 480) of a label of its frame is right; others are false. The *fringe* is where unlabelled
light may be seen: the first or last light of a pulse, near a label of up to 2 frames earlier or later, and all of a
frame with an unlabelled pulse. False spots are counted in all, and *off fringe*, that is, without those on the fringe.
Frames are not independent, so Wilson's intervals are too narrow.
"""

from __future__ import annotations

import json
from pathlib import Path

import cv2

from bench.detection.clip_frames import ROLES, frames_of, reach_in
from bench.detection.detector_under_test import DetectionScore, DetectorRunner, figures
from bench.detection.classifier_examples import classifiers_of_clips
from bench.harness import ResultTable, arguments


def main() -> None:
    parser = arguments(__doc__, other=True)
    parser.add_argument("folder", type=Path, metavar="DIR")
    parser.add_argument("--roles", nargs="+", default=list(ROLES), choices=ROLES)
    parser.add_argument("--left-out", type=Path, metavar="EXAMPLES")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    videos = json.loads((options.folder / "labels.json").read_text())["videos"]
    classifiers = classifiers_of_clips(options.left_out) if options.left_out else {}
    table = ResultTable(options.csv)
    for role in options.roles:
        preset = "stationary" if role == "stationary" else "mobile"
        scores = {}
        for name, video in sorted(videos.items()):
            runners = {"packaged": DetectorRunner(preset, confirm_frames=1)}
            if classifiers:
                runners["left out"] = DetectorRunner(preset, None, classifiers[name], confirm_frames=1)
            if options.other:
                runners["other"] = DetectorRunner(preset, options.other, confirm_frames=1)
            clip_scores = {}
            for version, runner in runners.items():
                clip_scores[version] = DetectionScore(runner, reach_in(video), counts_late_spots=False)
            for frame in frames_of(options.folder / "clips" / name, video, role):
                for score in clip_scores.values():
                    score.add_frame(frame)
            for version, score in clip_scores.items():
                scores.setdefault(version, []).append(score)
                places = {"false_at": score.false_spots[:12], "missed_at": score.missed()}
                table.add(role=role, version=version, clip=name, **figures([score]), **places)
        for version, role_scores in scores.items():
            table.add(role=role, version=version, clip="all", **figures(role_scores))


if __name__ == "__main__":
    main()
