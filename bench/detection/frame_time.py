#!/usr/bin/env python3
"""How long the search of an image takes, beside another version of the packages in the same run.

    bench/detection/frame_time.py [--other SRC] [--rounds 6] [--cases WORD ...]

Two processes search the same rendered images in turn, ten at a time, each on one thread; times are the thread's own, so
that what else runs disturbs both alike. Prints the median per image [ms], and the median of the ratios of paired rounds.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

from vb_evaluation.result_table import append_rows

TOP = Path(__file__).resolve().parents[2]
IMAGES = 10
CASES = (
    "ceiling bgr8 1080p",
    "ceiling bayer 1080p",
    "ceiling bgr8 4K",
    "robot 640x480, standing",
    "robot 640x480, turning",
)


def pictures(case: str) -> list:
    """Images of a case: the first two without a spot."""
    sys.path.insert(0, str(TOP / "src/vb_laser_detect/test"))
    from scenes import RED, Scene

    width, height = (640, 480) if "robot" in case else (3840, 2160) if "4K" in case else (1920, 1080)
    bayer = "bayer" in case
    scene = Scene(width + 200, height + 100)
    whole, images = scene.floor, []
    for i in range(2 + IMAGES):
        shift = 3 * i if "turning" in case else 0
        floor = np.ascontiguousarray(whole[shift : shift + height, 4 * shift : 4 * shift + width])
        spots = [(0.3 * width + 20.0 * i, 0.4 * height + 6.0 * i)] if i >= 2 else []
        images.append(scene.render(spots, color=RED, floor=floor, bayer=bayer, smear=(8.0, 3.0)))
    return images


def work(source: Path, folder: Path) -> None:
    """Searches on command: a case's name comes in, the milliseconds of each image go out."""
    cv2.setNumThreads(1)
    for package in ("vb_core", "vb_laser_detect"):
        sys.path.insert(0, str(source / package / "src"))
    from vb_laser_detect.detector import DetectorParams, SpotDetector

    detectors, images, stamps = {}, {}, {}
    for line in sys.stdin:
        case = line.strip()
        if case not in detectors:
            preset = DetectorParams.mobile if "robot" in case else DetectorParams.stationary
            detectors[case], stamps[case] = SpotDetector(preset()), 0.0
            detectors[case].encoding = "bayer_rggb8" if "bayer" in case else "bgr8"
            images[case] = np.load(folder / f"{CASES.index(case)}.npy")
            for image in images[case][:2]:
                stamps[case] += 0.04
                detectors[case].detect(image, stamps[case])
        times, order = [], list(images[case][2:])
        for image in order + order[::-1]:
            stamps[case] += 0.04
            began = time.thread_time()
            detectors[case].detect(image, stamps[case])
            times.append(1e3 * (time.thread_time() - began))
        print(json.dumps(times), flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--other", type=Path, help="folder of another version's packages")
    parser.add_argument("--cases", nargs="+", default=[""], metavar="WORD", help="only cases with a WORD in their name")
    parser.add_argument("--rounds", type=int, default=6)
    parser.add_argument("--csv", type=Path, help="append rows")
    parser.add_argument("--work", nargs=2, type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.work:
        work(*given.work)
        return 0
    sources = {"this": TOP / "src", **({"other": given.other} if given.other else {})}
    result = {}
    with tempfile.TemporaryDirectory() as folder:
        cases = [case for case in CASES if any(word in case for word in given.cases)]
        for case in cases:
            np.save(Path(folder) / f"{CASES.index(case)}.npy", np.array(pictures(case)))
        workers = {
            name: subprocess.Popen(
                [sys.executable, __file__, "--work", str(source), folder],
                text=True,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
            )
            for name, source in sources.items()
        }
        for case in cases:
            times = {name: [] for name in workers}
            for _ in range(given.rounds + 1):
                for name, worker in workers.items():
                    worker.stdin.write(case + "\n")
                    worker.stdin.flush()
                    times[name].append(json.loads(worker.stdout.readline()))
            medians = {name: np.median(rounds[1:], axis=1) for name, rounds in times.items()}
            result[case] = {f"{name}_ms": round(float(np.median(values)), 3) for name, values in medians.items()}
            if given.other:
                result[case]["this_over_other"] = round(float(np.median(medians["this"] / medians["other"])), 3)
            print(case, result[case], flush=True)
            if given.csv:
                append_rows(given.csv, [{"case": case, "rounds": given.rounds, **result[case]}])
        for worker in workers.values():
            worker.stdin.close()
            worker.wait()
    return 0


if __name__ == "__main__":
    sys.exit(main())
