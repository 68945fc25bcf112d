#!/usr/bin/env python3
"""Makes one row for each kind of camera, in both roles: encodings, lasers, white levels, rates, sizes, JPEG.

    python3 bench/detection/camera_kinds.py [--other REVISION|SRC] [--rows WORD ...] [--csv FILE]

Rendered floors on which a spot moves equally fast at all rates, 1.5 s without it and 4 s (at least 24 images) with it
(large images: 0.5 s and 1 s); a robot's camera looks around meanwhile, by up to 3 px per image. All versions see the
same pictures, taking turns at each. Times are a thread's own, [ms] per image; on a busy computer only their ratio
to the other version's is meaningful.
"""

from __future__ import annotations

import math
import sys
from typing import Any, Dict, Iterator, List, NamedTuple, Tuple

import cv2
import numpy as np

from bench.detection.finder import Count, Finder, LabeledFrame
from bench.frame import TOP, Table, arguments, share, versions

sys.path.insert(0, str(TOP / "src/vb_laser_detect/test"))
from scenes import GREEN, RED, Scene  # noqa: E402

NEAR_PX = 5.0


def uyvy(image: np.ndarray) -> np.ndarray:
    """Converts bgr (H, W, 3) to 4:2:2 (H, W, 2), the luminance second, in video levels."""
    luminance, *chroma = (plane.astype(int) for plane in cv2.split(cv2.cvtColor(image, cv2.COLOR_BGR2YUV)))
    second = np.empty_like(luminance)
    second[:, ::2], second[:, 1::2] = chroma[0][:, ::2], chroma[1][:, ::2]
    return np.dstack([second, np.clip(16 + luminance * 219 / 255, 0, 255)]).astype(np.uint8)


# converts an image to what a driver sends, by encoding
SENT = {
    "rgb8": lambda image: image[:, :, ::-1].copy(),
    "mono8": lambda image: image[:, :, 1].copy(),
    "mono16": lambda image: image[:, :, 1].astype(np.uint16) * 16,
    "bayer_rggb16": lambda image: image.astype(np.uint16) * 16,
    "yuv422": uyvy,
}


class Kind(NamedTuple):
    """One kind of camera; `encoding` as in SENT."""

    name: str
    color: Tuple[float, float, float] = GREEN
    bayer: bool = False
    size: Tuple[int, int] = (640, 480)
    rate: float = 25.0
    white: float = 255.0
    jpeg: int = 0
    encoding: str = ""


def kinds() -> List[Kind]:
    """Lists all kinds."""
    found = []
    for bayer, kind in ((False, "bgr8"), (True, "Bayer")):
        found += [Kind(f"{kind}, {name} laser", color, bayer) for name, color in (("green", GREEN), ("red", RED))]
        found += [Kind(f"{kind}, white level {white}", bayer=bayer, white=white) for white in (240, 224, 212, 200)]
        found += [Kind(f"{kind}, {rate} images/s", bayer=bayer, rate=rate) for rate in (2, 5, 10, 60)]
        sizes = (320, 240), (1920, 1080), (3840, 2160)
        found += [Kind(f"{kind}, {size[0]} x {size[1]}", bayer=bayer, size=size) for size in sizes]
    found += [Kind(f"{name} images", encoding=name, bayer="bayer" in name) for name in SENT]
    return found + [
        Kind(f"bgr8, JPEG of quality 60, {name}", color, jpeg=60) for name, color in (("green", GREEN), ("red", RED))
    ]


def pictures(kind: Kind, moving: bool) -> Iterator[LabeledFrame]:
    """Yields the images of a camera of a kind."""
    (width, height), margin = kind.size, 60 if moving else 0
    scene, small = Scene(width + margin, height + margin), width <= 640
    quiet = max(6, int((1.5 if small else 0.5) * kind.rate))
    for i in range(quiet + max(24, int((4.0 if small else 1.0) * kind.rate))):
        angle, spots = 0.8 * i / kind.rate, []
        left, top = (margin * (0.5 + 0.4 * np.sin(0.12 * i + np.array([0.0, 1.0])))).astype(int)
        if i >= quiet:
            spots = [(width * (0.5 + 0.33 * math.cos(angle)), height * (0.5 + 0.33 * math.sin(angle)))]
        image = scene.render(
            spots,
            sigma=max(1.3, math.hypot(width, height) / 400.0),
            color=kind.color,
            floor=np.ascontiguousarray(scene.floor[top : top + height, left : left + width]),
            bayer=kind.bayer,
        )
        image = cv2.convertScaleAbs(image, alpha=kind.white / 255.0)
        if kind.jpeg:
            image = cv2.imdecode(
                cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, kind.jpeg])[1], cv2.IMREAD_COLOR
            )
        image = SENT[kind.encoding](image) if kind.encoding else image
        yield LabeledFrame(
            i / kind.rate, image, spots, encoding=kind.encoding or ("bayer_rggb8" if kind.bayer else "bgr8")
        )


def measure(kind: Kind, preset: str, sources: Dict[str, Any]) -> Iterator[Dict[str, Any]]:
    """Yields each version's figures."""
    reach = NEAR_PX * max(1.0, kind.size[0] / 640.0)
    counts = {name: Count(Finder(preset, source), reach) for name, source in sources.items()}
    for number, frame in enumerate(pictures(kind, preset == "mobile")):
        for count in list(counts.values())[:: 2 * (number % 2) - 1]:
            count.look(frame)
    for name, count in counts.items():
        yield {
            "version": name,
            "found": share(len(count.found), count.sums()["labels"]),
            "false": len(count.false),
            "median_error_px": float(np.median(count.errors or [math.nan])),
            "ms": float(np.median(count.ms)),
            "of_other": float(np.median(np.divide(count.ms, counts.get("other", count).ms))),
        }


def main() -> int:
    parser = arguments(__doc__, other=True)
    parser.add_argument("--rows", nargs="+", default=[""], metavar="WORD", help="only rows with a WORD in their name")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    table = Table(given.csv)
    for kind in (kind for kind in kinds() if any(word in kind.name for word in given.rows)):
        for role, preset in (("ceiling", "stationary"), ("robot", "mobile"))[: 1 if kind.size[0] > 1920 else 2]:
            for figures in measure(kind, preset, versions(given)):
                table.add(camera=kind.name, role=role, **figures)
    return 0


if __name__ == "__main__":
    sys.exit(main())
