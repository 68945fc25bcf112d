#!/usr/bin/env python3
"""How right the spot detector is on labelled clips, in each role that a camera can have.

    bench/detection/clips.py DIR [--roles stationary mobile window] [--as plain jpeg60 ...] [--clips WORD ...]
                            [--left-out EXAMPLES] [--other SRC] [--csv FILE] [--crops DIR]

DIR holds labels.json and clips/. Roles: a camera that stands still; the same pictures as a robot's camera sees them
while it stands; and as a robot sees them that looks around, through a window that pans, tilts and rolls over the
pictures by a few pixels per image. `--as` changes the pictures (see VARIANTS). Detectors know neither focal length nor
pose, and confirm nothing.

All versions see the same pictures in turn: the detector as it comes; with `--left-out`, by examples that
training.py kept, one whose classifier was fitted without the clip (a fourth of all clips is left out at once);
with `--confirmed` the same with confirmation (then only its false spots say something, for most pulses are shorter
than it takes); with `--other`, that of another version's packages. Intervals are Wilson's for 95 %, as if frames
were independent; they are not.

A spot is right within 10 px (of 640 x 480) of a label of its frame. False spots are counted strictly, and without those
within that reach of a label up to 2 frames earlier or later, where a pulse's first or last light is seen; how many of
them are in frames with a pulse that has no label is told too.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
import zlib
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Sequence, Tuple

import cv2
import numpy as np

TOP = Path(__file__).resolve().parents[2]
for package in ("vb_core", "vb_laser_detect"):
    sys.path.insert(0, str(TOP / "src" / package / "src"))

from versions import other_detector  # noqa: E402

from vb_evaluation.result_table import append_rows  # noqa: E402
from vb_evaluation.statistics import proportion  # noqa: E402
from vb_laser_detect.detection.training import fit_without, load_examples  # noqa: E402
from vb_laser_detect.detector import DetectorParams, SpotDetector  # noqa: E402

REACH_PX, FRINGE = 10.0, 2
COUNTED = ("frames", "labels", "found", "shots", "shots_found", "false", "false_off_fringe", "false_on_unlabelled")
ROLES = ("stationary", "mobile", "window")
# frames with pulses that nobody labelled, looked at one by one: what is found there counts as false, and is told apart
# too
UNLABELED = {
    # 115 and 116 fall on a wall that is white already, and light a disc beside it
    "logitech-indoor-tree-green.mp4": (43, 44, 70, 71, 87, 88, 115, 116, 126, 127, 222, 223)
}
Change = Callable[[np.ndarray], np.ndarray]


def scaled(factor: float) -> Change:
    """Returns the picture in another size."""
    return lambda image: cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)


def jpeg(quality: int) -> Change:
    """Returns the picture compressed."""
    flags = [cv2.IMWRITE_JPEG_QUALITY, quality]
    return lambda image: cv2.imdecode(cv2.imencode(".jpg", image, flags)[1], cv2.IMREAD_COLOR)


def levels(white: float) -> Change:
    """Returns the picture of a camera whose brightest value is `white`."""
    return lambda image: cv2.convertScaleAbs(image, alpha=white / 255.0)


def gamma(power: float) -> Change:
    """Returns the picture with another tone curve."""
    table = np.round(255.0 * (np.arange(256) / 255.0) ** power).astype(np.uint8)
    return lambda image: cv2.LUT(image, table)


# name: how a picture changes, how much larger it is, which of its frames are taken
VARIANTS: Dict[str, Tuple[Change, float, int]] = {
    "plain": (lambda image: image, 1.0, 1),
    "white 235": (levels(235), 1.0, 1),
    "white 220": (levels(220), 1.0, 1),
    "white 200": (levels(200), 1.0, 1),
    "jpeg 60": (jpeg(60), 1.0, 1),
    "half size": (scaled(0.5), 0.5, 1),
    "twice the size": (scaled(2.0), 2.0, 1),
    "gamma 1.4": (gamma(1.4), 1.0, 1),
    "half the rate": (lambda image: image, 1.0, 2),
    "grey": (lambda image: cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), 1.0, 1),
    "mirrored": (lambda image: np.ascontiguousarray(image[:, ::-1]), 1.0, 1),
}


def window_at(index: int, width: int, height: int, seed: int) -> np.ndarray:
    """Returns the transform (2, 3) from the picture to a window of four fifths of it, in the frame of this number.

    Pan and tilt swing by a tenth of the picture, at up to 4 px per frame; the roll by 2.5 degrees.
    """
    random = np.random.default_rng(seed)
    phases, periods = random.uniform(0, 2 * math.pi, 3), random.uniform((90, 90, 70), (140, 140, 160))
    swing = np.sin(2 * math.pi * index / periods + phases)
    wide, high = 0.8 * width, 0.8 * height
    angle = math.radians(2.5 * swing[2])
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    middle = np.array([0.5 * width, 0.5 * height]) + swing[:2] * 0.07 * np.array([width, height])
    return np.column_stack([turn, np.array([0.5 * wide, 0.5 * high]) - turn @ middle])


def frames_of(clip: Path, video: dict, role: str, variant: str) -> Iterator[Tuple[float, np.ndarray, List[dict]]]:
    """Yields stamp [s], picture and labels {x, y, event, near} of each frame; near: a label of frames before or after."""
    change, size, step = VARIANTS[variant]
    by_frame: Dict[int, List[dict]] = {}
    for label in video["labels"]:
        by_frame.setdefault(label["frame"], []).append(label)
    capture = cv2.VideoCapture(str(clip))
    rate, seed, index = capture.get(cv2.CAP_PROP_FPS) or 25.0, zlib.crc32(clip.name.encode()), -1
    while True:
        got, image = capture.read()
        index += 1
        if not got:
            return
        if index % step:
            continue
        moved = np.eye(2, 3)
        height, width = image.shape[:2]
        if role == "window":
            moved = window_at(index, width, height, seed)
            width, height = int(0.8 * width), int(0.8 * height)
            image = cv2.warpAffine(image, moved, (width, height), flags=cv2.INTER_CUBIC)
            # a sensor's noise does not move with the scene; it is a frame's own, whichever clips were seen before
            cv2.setRNGSeed(seed % 2**31 + index)
            image = cv2.add(image, cv2.randn(np.empty(image.shape, np.int8), 0, 1.5), dtype=cv2.CV_8U)
        labels = []
        for near in range(-FRINGE, FRINGE + 1):
            for label in by_frame.get(index + near, []):
                x, y = moved @ (label["x"], label["y"], 1.0)
                if variant == "mirrored":
                    x = width - 1 - x
                x, y = (x + 0.5) * size - 0.5, (y + 0.5) * size - 0.5
                # what the window's edge cuts off is neither asked for nor wrong
                inside = 4.0 < x / size < width - 5.0 and 4.0 < y / size < height - 5.0 or role != "window"
                labels.append({"x": x, "y": y, "event": label["event"], "near": near != 0 or not inside})
        yield index / rate, np.ascontiguousarray(change(image)), labels


class Count:
    """What a detector makes of one clip."""

    def __init__(self, detector: Any, reach: float, unlabeled: Sequence[int]) -> None:
        self._detector, self._reach, self._unlabeled = detector, reach, unlabeled
        self.sums = dict.fromkeys(("frames", "labels", "found", "false", "false_off_fringe", "false_on_unlabelled"), 0)
        self._shots, self._hit, self._took = set(), set(), 0.0
        self.errors: List[float] = []
        self.places: List[Tuple[int, float, float, bool]] = []

    def look(self, stamp: float, image: np.ndarray, labels: List[dict], index: int) -> None:
        """Searches a frame and counts."""
        here = [label for label in labels if not label["near"]]
        began = time.thread_time()
        spots = self._detector.detect(image, stamp)
        self._took += time.thread_time() - began
        matched = set()
        for spot in spots:
            distances = [math.hypot(spot.u - label["x"], spot.v - label["y"]) for label in labels]
            best = min((d for d, label in zip(distances, labels) if not label["near"]), default=math.inf)
            if best < self._reach:
                matched.add(
                    min(range(len(here)), key=lambda k: math.hypot(spot.u - here[k]["x"], spot.v - here[k]["y"]))
                )
                self.errors.append(best)
            else:
                fringe = bool(distances) and min(distances) < self._reach
                self.sums["false"] += 1
                self.sums["false_off_fringe"] += not fringe
                self.sums["false_on_unlabelled"] += index in self._unlabeled
                self.places.append((index, round(spot.u, 1), round(spot.v, 1), fringe))
        self.sums["found"] += len(matched)
        self.sums["labels"] += len(here)
        self.sums["frames"] += 1
        self._shots |= {label["event"] for label in here}
        self._hit |= {here[k]["event"] for k in matched}

    def result(self, name: str) -> Dict[str, Any]:
        """Returns the figures."""
        return {
            "clip": name,
            **self.sums,
            "shots": len(self._shots),
            "shots_found": len(self._hit),
            "errors": self.errors,
            "places": self.places,
            "ms": 1e3 * self._took / max(1, self.sums["frames"]),
        }


def measure(folder: Path, name: str, video: dict, role: str, variant: str, detectors: Dict[str, Any]) -> Dict[str, Any]:
    """Measures what detectors make of one clip."""
    reach = REACH_PX * VARIANTS[variant][1] * max(1.0, video["width"] / 640.0)
    counts = {version: Count(detector, reach, UNLABELED.get(name, ())) for version, detector in detectors.items()}
    for number, frame in enumerate(frames_of(folder / "clips" / name, video, role, variant)):
        for count in counts.values():
            count.look(*frame, number * VARIANTS[variant][2])
    return {version: count.result(name) for version, count in counts.items()}


def write_crops(
    clip: Path, places: List[Tuple[int, float, float, bool]], folder: Path, reach: int = 25, around: int = 3
) -> None:
    """Writes one picture per clip: a row per place (frame, u, v), with the frames before and after it, for looking at."""
    capture, images = cv2.VideoCapture(str(clip)), []
    while True:
        got, image = capture.read()
        if not got:
            break
        images.append(image)
    rows = []
    for frame, u, v, _ in places:
        cells = []
        for index in range(int(frame) - around, int(frame) + around + 1):
            image = images[min(max(index, 0), len(images) - 1)]
            cell = cv2.getRectSubPix(image, (2 * reach + 1, 2 * reach + 1), (float(u), float(v)))
            cell = cv2.resize(cell, None, fx=4, fy=4, interpolation=cv2.INTER_NEAREST)
            cells.append(cv2.putText(cell, str(index), (4, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 255, 255)))
        rows.append(np.hstack(cells))
    folder.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(folder / f"{clip.stem}.png"), np.vstack(rows))


def figures(clips: Sequence[Dict[str, Any]]) -> Dict[str, Any]:
    """Computes the figures of one clip, or of several."""
    sums = {key: sum(clip[key] for clip in clips) for key in COUNTED}
    errors = [error for clip in clips for error in clip["errors"]]
    recall, false = proportion(sums["found"], sums["labels"]), proportion(sums["false"], sums["frames"])
    return {
        **sums,
        "recall": round(sums["found"] / max(1, sums["labels"]), 4),
        "recall_low": round(recall.low, 3),
        "recall_high": round(recall.high, 3),
        "false_per_1000": round(1e3 * sums["false"] / max(1, sums["frames"]), 2),
        "false_low": round(1e3 * false.low, 2),
        "false_high": round(1e3 * false.high, 2),
        "median_error_px": round(float(np.median(errors)), 3) if errors else None,
        "ms_per_frame": round(sum(clip["ms"] * clip["frames"] for clip in clips) / max(1, sums["frames"]), 2),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, metavar="DIR")
    parser.add_argument("--roles", nargs="+", default=list(ROLES), choices=ROLES)
    parser.add_argument("--as", nargs="+", default=["plain"], dest="variants", choices=list(VARIANTS) + ["all"])
    parser.add_argument("--clips", nargs="+", default=[""], metavar="WORD", help="only clips with a WORD in their name")
    parser.add_argument("--left-out", type=Path, metavar="EXAMPLES")
    parser.add_argument("--confirmed", action="store_true", help="also with confirmation")
    parser.add_argument("--other", type=Path, metavar="SRC", help="folder of another version's packages")
    parser.add_argument(
        "--csv", type=Path, help="append a row for each role, variant, version and clip, and for all clips"
    )
    parser.add_argument("--crops", type=Path, metavar="DIR", help="pictures of all false spots of a camera that stands")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    videos = sorted(json.loads((given.folder / "labels.json").read_text())["videos"].items())
    judges = (
        fit_without(load_examples(sorted(given.left_out.glob("*.npz"))), [name for name, _ in videos], 4)
        if given.left_out
        else {}
    )
    videos = [(name, video) for name, video in videos if any(word in name for word in given.clips)]
    for variant in VARIANTS if "all" in given.variants else given.variants:
        for role in given.roles:
            preset, clips = "stationary" if role == "stationary" else "mobile", {}
            confirmed = getattr(DetectorParams, preset)()
            at_once = confirmed.replace(confirm_frames=1)
            for name, video in videos:
                detectors = {"as it comes": SpotDetector(at_once)}
                if judges:
                    detectors["left out"] = SpotDetector(at_once, judges[name])
                if given.confirmed:
                    detectors[("left out" if judges else "as it comes") + ", confirmed"] = SpotDetector(
                        confirmed, judges.get(name)
                    )
                if given.other:
                    params, detector = other_detector(given.other)[0]
                    detectors["other"] = detector(getattr(params, preset)(confirm_frames=1))
                for version, c in measure(given.folder, name, video, role, variant, detectors).items():
                    clips.setdefault(version, []).append(c)
                    print(
                        f"  {name if version == 'as it comes' else '    ' + version:46s} frames {c['found']:3d}/{c['labels']:3d} "
                        f"shots {c['shots_found']:2d}/{c['shots']:2d} false {c['false']:3d} ({c['false_off_fringe']:3d}) "
                        f"{c['ms']:.1f} ms {c['places'][:12]}",
                        flush=True,
                    )
                    if (
                        given.crops
                        and c["places"]
                        and role != "window"
                        and variant == "plain"
                        and version == "as it comes"
                    ):
                        write_crops(given.folder / "clips" / name, c["places"], given.crops)
            rows = [
                {"role": role, "pictures": variant, "version": version, "clip": name, **figures(part)}
                for version, counts in clips.items()
                for name, part in [("all", counts)] + [(one["clip"], [one]) for one in counts]
            ]
            for row in rows:
                if row["clip"] == "all":
                    print(json.dumps(row), flush=True)
            if given.csv:
                append_rows(given.csv, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
