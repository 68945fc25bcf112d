#!/usr/bin/env python3
"""How fast and how right the spot detector is.

    bench/detection/frames.py                        time per frame, rendered 1080p, beside the authors' design
    bench/detection/frames.py --scenes [WORD ...]    also rendered scenes of every hard case (or those whose name has a WORD)
    bench/detection/frames.py --quiet MINUTES        also false spots without a laser, people walking under three cameras

Labelled clips: clips.py; another version's times: frame_time.py. Writes out/bench/spot_detection.json. Both
detectors see the same frames in turn, in one run on one thread, and the time is that of the thread, so that
other programs disturb both alike.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any, Dict, List, Optional, Tuple

import cv2
import numpy as np

TOP = Path(__file__).resolve().parents[2]
for package in ("vb_core", "vb_laser_detect"):
    sys.path.insert(0, str(TOP / "src" / package / "src"))
sys.path.insert(0, str(TOP / "src" / "vb_laser_detect" / "test"))

from scenes import RED, Scene  # noqa: E402

from vb_evaluation.result_table import append_rows  # noqa: E402
from vb_laser_detect.detector import DetectorParams, SpotDetector  # noqa: E402

PERIOD = 0.04
SCENE_FIGURES = (
    "recall",
    "false_spots_per_hour",
    "error_median_mm",
    "error_p95_mm",
    "error_with_pose_error_median_mm",
    "error_with_pose_error_p95_mm",
)


class AuthorsDesign:
    """The detector that the paper's authors released, written from its description alone.

    An adaptive threshold and a mixture-of-Gaussians foreground mask, both over the whole image, are combined;
    contours with an area in a fixed window [px] are spots.
    """

    def __init__(self, least_px: float = 80.0, most_px: float = 230.0) -> None:
        self._least_px, self._most_px = least_px, most_px
        self._foreground = cv2.createBackgroundSubtractorMOG2(detectShadows=False)

    def detect(self, image: np.ndarray) -> List[Tuple[float, float]]:
        """Returns (u, v) [px] of the spots."""
        gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        bright = cv2.adaptiveThreshold(gray, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY, 11, -20)
        moved = self._foreground.apply(image)
        contours, _ = cv2.findContours(cv2.bitwise_and(bright, moved), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        spots = []
        for contour in contours:
            moments = cv2.moments(contour)
            if self._least_px <= moments["m00"] <= self._most_px:
                spots.append((moments["m10"] / moments["m00"], moments["m01"] / moments["m00"]))
        return spots


def measure_time(frames: int) -> Dict[str, Any]:
    """Milliseconds per 1080p frame of each detector on the same pictures."""
    scene = Scene(1920, 1080)
    # 25 pictures are played to and fro: a spot at 1 m/s and 2 mm per pixel
    places = [(500 + 20.0 * i, 400 + 8.0 * i) for i in range(25)]
    order = list(range(25)) + list(range(24, -1, -1))
    color = [scene.render([place], smear=(10.0, 4.0), color=RED) for place in places]
    bayer = [scene.render([place], smear=(10.0, 4.0), color=RED, bayer=True) for place in places]
    authors = AuthorsDesign()
    ours = {"bgr8": SpotDetector(DetectorParams.stationary()), "bayer_rggb8": SpotDetector(DetectorParams.stationary())}
    for encoding, detector in ours.items():
        detector.encoding = encoding
    times: Dict[str, List[float]] = {"authors_bgr8": [], "bgr8": [], "bayer_rggb8": []}
    for i in range(frames):
        picture = order[i % len(order)]
        for name, images in (("bgr8", color), ("bayer_rggb8", bayer)):
            began = time.thread_time()
            ours[name].detect(images[picture], PERIOD * i)
            times[name].append(time.thread_time() - began)
        began = time.thread_time()
        authors.detect(color[picture])
        times["authors_bgr8"].append(time.thread_time() - began)
    warm = frames // 5
    result: Dict[str, Any] = {"frames": frames - warm}
    for name, values in times.items():
        result[name] = {
            "median_ms": 1e3 * float(np.median(values[warm:])),
            "p95_ms": 1e3 * float(np.percentile(values[warm:], 95)),
        }
    for name in ("bgr8", "bayer_rggb8"):
        pairs = np.array(times["authors_bgr8"][warm:]) / np.array(times[name][warm:])
        result[f"times_faster_{name}"] = float(np.median(pairs))
    return result


def measure_scenes(
    words: List[str],
    seed: int,
    other: Optional[Path],
    left_out: Optional[Path],
    share: float,
    without: List[str],
    table: Optional[Path],
) -> Dict[str, Any]:
    """Measures recall, false spots and errors on the floor in rendered scenes; prints each as it is done.

    Args:
        share: of each scene's time that is played.
        table: gets a row for each scene and version.
        without: no scenes with one of these words in their names.
        other: folder of another version's packages, which see the same pictures.
        left_out: folder of the examples that training.py kept: the scenes are also searched with classifiers
            fitted without them, a fifth of all at once.
    """
    from hard_scenes import Camera, CameraModels, Rooms, ceiling_scenes, lab, mobile_scenes, play

    from vb_laser_detect.detection.training import fit_without, load_examples

    result: Dict[str, Any] = {}
    room, rooms = lab(), Rooms(CameraModels(), seed)
    print(f"{'scene':52s} recall  false/h  error on the floor [mm]: median, 95 % (and with pose errors)")
    scenes = ceiling_scenes(room) + mobile_scenes(room)
    groups = [("robot: " if scene.mobile else "ceiling: ") + scene.name for scene in scenes]
    judges = fit_without(load_examples(sorted(left_out.glob("*.npz"))), groups, 5) if left_out else {}
    for scene, group in zip(scenes, groups):
        name = ("robot's camera: " if scene.mobile else "") + scene.name
        if words and not any(word in name for word in words) or any(word in name for word in without):
            continue
        cameras = {"this": Camera(scene, rooms)}
        if judges:
            cameras["left out"] = Camera(scene, rooms, judge=judges[group])
        if other is not None:
            cameras["other"] = Camera(scene, rooms, other)
        for version, outcome in zip(cameras, play(scene, list(cameras.values()), share)):
            figures = outcome.summary()
            if table is not None:
                append_rows(
                    table,
                    [
                        {
                            "scene": name,
                            "version": version,
                            "seed": seed,
                            "share": share,
                            **{
                                key: figures[key] for key in ("frames", "visible_frames", "false_spots", *SCENE_FIGURES)
                            },
                            "missed_because": " ".join(f"{code}:{n}" for code, n in figures["missed_because"].items()),
                        }
                    ],
                )
            result.setdefault(name, {})[version] = figures
            numbers = [np.nan if figures[key] is None else figures[key] for key in SCENE_FIGURES]
            print(
                "{:52s} {:6.3f} {:8.0f} {:8.1f} {:6.1f} ({:.1f}, {:.1f})".format(
                    name if version == "this" else f"    {version}", *numbers
                ),
                figures["missed_because"] or "",
                flush=True,
            )
    return result


def measure_quiet(minutes: float, seed: int) -> Dict[str, Any]:
    """Counts false spots without a laser, per camera."""
    from hard_scenes import quiet

    result = {name: outcome.summary() for name, outcome in quiet(minutes, seed).items()}
    return {
        name: {
            key: figures[key] for key in ("frames", "false_spots", "false_spots_per_hour", "false_at_time_u_v_diameter")
        }
        for name, figures in result.items()
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=200, help="rendered frames to time")
    parser.add_argument(
        "--scenes", nargs="*", metavar="WORD", help="rendered scenes; only those with a WORD in their name"
    )
    parser.add_argument("--without", nargs="+", default=[], metavar="WORD", help="no scenes with a WORD in their name")
    parser.add_argument("--share", type=float, default=1.0, help="of each scene's time, for --scenes")
    parser.add_argument("--quiet", type=float, metavar="MINUTES", help="simulated time without a laser")
    parser.add_argument("--seed", type=int, default=1, help="of textures, noise and, with --quiet, who walks where")
    parser.add_argument(
        "--other", type=Path, help="folder of another version's packages, for --scenes: on the same pictures"
    )
    parser.add_argument(
        "--left-out",
        type=Path,
        metavar="EXAMPLES",
        help="for --scenes: also with classifiers fitted without the scene, by what training.py kept",
    )
    parser.add_argument("--csv", type=Path, help="append the scenes to a table")
    parser.add_argument("--out", type=Path, default=TOP / "out" / "bench" / "spot_detection.json")
    parser.add_argument("--no-times", action="store_true")
    arguments = parser.parse_args()
    if arguments.frames < 10:
        parser.error("--frames must be at least 10")
    cv2.setNumThreads(1)
    result: Dict[str, Any] = {} if arguments.no_times else {"time_per_1080p_frame": measure_time(arguments.frames)}
    timing = result.get("time_per_1080p_frame")
    for name in ("authors_bgr8", "bgr8", "bayer_rggb8") if timing else ():
        print(
            f"{name:14s} {timing[name]['median_ms']:6.2f} ms per 1080p frame (95th percentile {timing[name]['p95_ms']:.2f})"
        )
    if timing:
        print(
            f"faster than the authors' design: {timing['times_faster_bgr8']:.1f} times (bgr8), "
            f"{timing['times_faster_bayer_rggb8']:.1f} times (Bayer)"
        )
    if arguments.scenes is not None:
        result["scenes"] = measure_scenes(
            arguments.scenes,
            arguments.seed,
            arguments.other,
            arguments.left_out,
            arguments.share,
            arguments.without,
            arguments.csv,
        )
    if arguments.quiet:
        result["no_laser"] = measure_quiet(arguments.quiet, arguments.seed)
        for name, figures in result["no_laser"].items():
            print(
                f"no laser, {arguments.quiet:g} minutes, camera {name}: {figures['frames']} frames, {figures['false_spots']} false spots"
            )
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps(result, indent=2) + "\n")
    print(f"written to {arguments.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
