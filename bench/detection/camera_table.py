#!/usr/bin/env python3
"""One row for each kind of camera and images: recall, false spots and errors, in both roles.

    python3 bench/detection/camera_table.py [--other SRC] [--rows WORD ...] [--csv docs/results/detection/table.csv]

Rendered floors with a spot that is drawn across at the same speed per second, 1.5 s without and 4 s (at least 24
images)
with it (large images: .5 s and 1 s), as each detector comes, spots that are given back included. A robot's camera looks
round meanwhile, by up to 3 px per image. With --other another version's packages see the same pictures. The last rows
tell errors on the floor [mm], 2.95 m under the camera, for lenses; the others errors in the image [px].
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import Any, Dict, Iterator, NamedTuple, Optional, Tuple

import cv2
import numpy as np

TOP = Path(__file__).resolve().parents[2]
for package in ("vb_core", "vb_laser_detect"):
    sys.path.insert(0, str(TOP / "src" / package / "src"))
sys.path.insert(0, str(TOP / "src/vb_laser_detect/test"))

from scenes import GREEN, RED, Scene  # noqa: E402
from versions import other_detector  # noqa: E402

from vb_core import geometry  # noqa: E402
from vb_core.camera_model import CameraModel  # noqa: E402
from vb_evaluation.result_table import append_rows  # noqa: E402
from vb_laser_detect.detection.image_format import PixelReader  # noqa: E402
from vb_laser_detect.detection.image_geometry import search  # noqa: E402
from vb_laser_detect.detection.projection import floor_points  # noqa: E402
from vb_laser_detect.detector import DetectorParams, SpotDetector  # noqa: E402

HEIGHT_M, NEAR_PX = 2.95, 5.0


class Row(NamedTuple):
    """One kind of camera.

    Attributes:
        encoding: as in sensor_msgs/Image; empty: bgr8, or bayer_rggb8.
        lens: raw, rectified or fisheye, "" where only places in the image count.
    """

    name: str
    color: Tuple[float, float, float] = GREEN
    bayer: bool = False
    width: int = 640
    height: int = 480
    rate: float = 25.0
    white: float = 255.0
    jpeg: int = 0
    encoding: str = ""
    lens: str = ""


# what a driver would send of an image, by encoding
SENT = {
    "rgb8": lambda image: image[:, :, ::-1].copy(),
    "mono8": lambda image: image[:, :, 1].copy(),
    "mono16": lambda image: image[:, :, 1].astype(np.uint16) * 16,
    "bayer_rggb16": lambda image: image.astype(np.uint16) * 16,
    "yuv422": lambda image: uyvy(image),
}


def uyvy(image: np.ndarray) -> np.ndarray:
    """Converts bgr (H, W, 3) to 4:2:2 (H, W, 2), the luminance second."""
    luminance, *chroma = (plane.astype(int) for plane in cv2.split(cv2.cvtColor(image, cv2.COLOR_BGR2YUV)))
    second = np.empty_like(luminance)
    second[:, ::2], second[:, 1::2] = chroma[0][:, ::2], chroma[1][:, ::2]
    return np.dstack([second, np.clip(16 + luminance * 219 / 255, 0, 255)]).astype(np.uint8)  # video levels


def rows() -> Iterator[Row]:
    """Lists all rows of the table."""
    for bayer in (False, True):
        kind = "Bayer" if bayer else "bgr8"
        for name, color in (("green", GREEN), ("red", RED)):
            yield Row(f"{kind}, {name} laser", color, bayer)
        for white in (240, 224, 212, 200):
            yield Row(f"{kind}, white level {white}", bayer=bayer, white=white)
        for rate in (2, 5, 10, 60):
            yield Row(f"{kind}, {rate} images/s", bayer=bayer, rate=rate)
        for width, height in ((320, 240), (1920, 1080), (3840, 2160)):
            yield Row(f"{kind}, {width} x {height}", bayer=bayer, width=width, height=height)
    for encoding in SENT:
        yield Row(
            f"{encoding} images{' of 12 bits' if encoding.endswith('16') else ''}",
            encoding=encoding,
            bayer="bayer" in encoding,
        )
    yield Row("bgr8, JPEG of quality 60", jpeg=60)
    yield Row("bgr8, JPEG of quality 60, red laser", RED, jpeg=60)
    for lens in ("raw", "rectified", "fisheye"):
        yield Row(f"bgr8, {lens} images of a lens with distortion", lens=lens)


def camera_of(row: Row) -> Optional[CameraModel]:
    """Returns what the node would know of the images."""
    if not row.lens:
        return None
    matrix = CameraModel.ideal(row.width, row.height, 0.6 * row.width).matrix
    distortion = {
        "raw": [-0.33, 0.12, 0.0, 0.0, 0.0],
        "rectified": [0.0] * 5,
        "fisheye": [-0.02, 0.004, -0.001, 0.0002],
    }
    return CameraModel(row.width, row.height, matrix, np.array(distortion[row.lens]), row.lens == "fisheye")


def pictures(row: Row, moving: bool) -> Iterator[Tuple[float, np.ndarray, Optional[Tuple[float, float]]]]:
    """Yields stamp [s], image, and where the spot is [px]."""
    margin = 60 if moving else 0
    size = math.hypot(row.width, row.height) / 800.0
    scene = Scene(row.width + margin, row.height + margin)
    whole, quiet = scene.floor, max(6, int((1.5 if row.width <= 640 else 0.5) * row.rate))
    seconds = 4.0 if row.width <= 640 else 1.0  # large ones take long to render
    for i in range(quiet + max(24, int(seconds * row.rate))):
        t = i / row.rate
        shift = (margin * (0.5 + 0.4 * np.sin(0.12 * i + np.array([0.0, 1.0])))).astype(int)
        floor = np.ascontiguousarray(whole[shift[1] : shift[1] + row.height, shift[0] : shift[0] + row.width])
        spot = None
        if i >= quiet:
            angle = 0.8 * t
            spot = (row.width * (0.5 + 0.33 * math.cos(angle)), row.height * (0.5 + 0.33 * math.sin(angle)))
        image = scene.render(
            [spot] if spot else [], sigma=max(1.3, 2.0 * size), color=row.color, floor=floor, bayer=row.bayer
        )
        image = cv2.convertScaleAbs(image, alpha=row.white / 255.0)
        if row.jpeg:
            image = cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, row.jpeg])[1], cv2.IMREAD_COLOR)
        yield t, SENT[row.encoding](image) if row.encoding else image, spot


def measure(row: Row, role: str, other: Optional[Path]) -> Dict[str, Dict[str, Any]]:
    """Measures the figures of each version."""
    preset = "stationary" if role == "ceiling" else "mobile"
    detectors = {"this": (getattr(DetectorParams, preset), SpotDetector, search)}
    if other is not None:
        (params, detector), find = other_detector(other)
        detectors["other"] = (getattr(params, preset), detector, find)
    made = {version: (detector(params()), find) for version, (params, detector, find) in detectors.items()}
    encoding, reader = row.encoding or ("bayer_rggb8" if row.bayer else "bgr8"), PixelReader()
    counts = {version: {"images": 0, "told": 0, "false": 0, "errors": []} for version in made}
    camera, truth = camera_of(row), {}
    pose = geometry.transform(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, HEIGHT_M))
    for t, image, spot in pictures(row, role == "robot"):
        truth[t] = spot
        for version, (detector, find) in made.items():
            detector.encoding, count = encoding, counts[version]
            # the version before took pixels as they came
            try:
                spots = find(detector, reader.read(image, encoding) if version == "this" else image, t, None)
            except Exception as refused:
                if type(refused).__name__ != "CodedError":
                    raise
                spots = []
            count["images"] += spot is not None
            for at, one in [(t, one) for one in spots] + [
                (earlier.stamp, earlier.spot) for earlier in detector.backfilled
            ]:
                where = truth[at]
                if where is None or math.hypot(one.u - where[0], one.v - where[1]) > NEAR_PX * max(
                    1.0, row.width / 640.0
                ):
                    count["false"] += 1
                    continue
                count["told"] += 1
                ends = np.array([(one.u, one.v), where])
                if camera is not None:
                    ends = 1e3 * floor_points(camera, pose, ends)[:, :2]
                count["errors"].append(float(np.hypot(*(ends[0] - ends[1]))))
    return {
        version: {
            "images": c["images"],
            "recall": round(c["told"] / c["images"], 3),
            "false": c["false"],
            "median_error": round(float(np.median(c["errors"])), 3) if c["errors"] else None,
            "unit": "mm" if row.lens else "px",
        }
        for version, c in counts.items()
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--other", type=Path, metavar="SRC")
    parser.add_argument("--rows", nargs="+", default=[""], metavar="WORD", help="only rows with a WORD in their name")
    parser.add_argument("--csv", type=Path, help="append rows")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    for row, role in ((row, role) for row in rows() for role in ("ceiling", "robot")):
        if not any(word in row.name for word in given.rows) or role == "robot" and row.width > 1920:
            continue
        lines = [
            {"camera": row.name, "role": role, "version": version, **figures}
            for version, figures in measure(row, role, given.other).items()
        ]
        for line in lines:
            print(*line.values(), sep="  ", flush=True)
        if given.csv:
            append_rows(given.csv, lines)
    return 0


if __name__ == "__main__":
    sys.exit(main())
