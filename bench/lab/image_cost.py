#!/usr/bin/env python3
"""What an image of a 1080p camera costs its detector, beside decoding it to grey and searching it.

python3 bench/lab/image_cost.py                             images as of camera_clip.py, in one thread
"""

from __future__ import annotations

import sys
import time
from typing import Any, Callable, Dict, List

import cv2
import numpy as np
import simplejpeg

from bench.frame import Table, arguments
from bench.lab.camera_clip import FRAMES, RATE, clip, scene
from vb_core.image_format import Picture
from vb_laser_detect.camera.source import Shot
from vb_laser_detect.detection.projection import FloorProjection, ImageGeometry
from vb_laser_detect.detector import SpotDetector


class Search:
    """Decodes and searches images as a detector does, and adds up the thread's time."""

    def __init__(self, decode: Callable[[bytes], Picture]) -> None:
        self._decode, self._detector, self._projector = decode, SpotDetector(), FloorProjection()
        self._model: Any = None
        self.times: List[float] = []

    def look(self, jpeg: bytes, stamp: float) -> None:
        began = time.thread_time()
        picture = self._decode(jpeg)
        if self._model is None:  # a node too keeps the lens of its images' size
            self._model = scene().model.scaled_to(*picture.pixels.shape[1::-1])
        self._detector.detect(picture, stamp, ImageGeometry(self._model, lambda: scene().pose, self._projector))
        self.times.append(1e3 * (time.thread_time() - began))


def gray(jpeg: bytes) -> Picture:
    return Picture(simplejpeg.decode_jpeg(jpeg, "GRAY")[..., 0], "mono")


def cost(half_size: bool) -> Dict[str, Any]:
    """Measures an image's cost in one thread, beside decoding to grey and searching."""
    jpegs, ours, alone = clip(), Search(lambda jpeg: Shot(0.0, jpeg).searched(half_size)[0]), Search(gray)
    for number in range(2 * FRAMES):
        for one in (ours, alone) if number % 2 else (alone, ours):
            one.look(jpegs[number % FRAMES], number / RATE)
    # each second of images by itself, the first lap is for learning
    blocks = np.array([np.array(one.times[FRAMES:]).reshape(-1, int(RATE)).sum(axis=1) for one in (ours, alone)])
    draws = np.random.default_rng(1).integers(blocks.shape[1], size=(2000, blocks.shape[1]))
    low, high = np.percentile(blocks[0][draws].sum(axis=1) / blocks[1][draws].sum(axis=1), [2.5, 97.5])
    return {
        "what": "one thread", "ours_ms": blocks[0].sum() / FRAMES, "gray_ms": blocks[1].sum() / FRAMES,
        "ours_over_gray": blocks[0].sum() / blocks[1].sum(), "low": float(low), "high": float(high),
    }  # fmt: skip


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--half-size", action="store_true", help="search images at half their size")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    Table(given.csv).add(**cost(given.half_size))
    return 0


if __name__ == "__main__":
    sys.exit(main())
