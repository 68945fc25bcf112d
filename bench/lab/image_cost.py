#!/usr/bin/env python3
"""Measures a detector's processor time per 1080p image, compared with grey decoding and search, in one thread.

    python3 bench/lab/image_cost.py

The images are those of camera_clip.py: all, of which a quarter show a spot, and those with and without a spot.
"""

from __future__ import annotations

import time
from typing import Callable, List

import cv2
import numpy as np
import simplejpeg

from bench.harness import Table, arguments
from bench.lab.camera_clip import DRAWN, FRAMES, RATE, clip, scene
from vb_core.image_format import AnyPicture, Picture
from vb_laser_detect.camera.camera_source import CapturedImage
from vb_laser_detect.detection.projection import FloorProjection, ImageGeometry
from vb_laser_detect.detection.spot_detector import SpotDetector


class Search:
    """Decodes and searches images as a detector does, and records the thread's time."""

    def __init__(self, decode: Callable[[bytes], AnyPicture]) -> None:
        self._decode, self._detector, self._floor_projection = decode, SpotDetector(), FloorProjection()
        self.times: List[float] = []

    def look(self, jpeg: bytes, stamp: float) -> None:
        start = time.thread_time()
        geometry = ImageGeometry(scene().model, self._floor_projection, lambda: scene().pose)
        self._detector.detect(self._decode(jpeg), stamp, geometry)
        self.times.append(1e3 * (time.thread_time() - start))


def gray(jpeg: bytes) -> Picture:
    return Picture(simplejpeg.decode_jpeg(jpeg, "GRAY")[..., 0], "mono")


def main() -> None:
    options = arguments(__doc__).parse_args()
    cv2.setNumThreads(1)
    table, jpegs = Table(options.csv), clip()
    current, baseline = Search(lambda jpeg: CapturedImage(0.0, jpeg).picture()), Search(gray)
    for number in range(2 * FRAMES):
        order = (current, baseline) if number % 2 else (baseline, current)
        for s in order:
            s.look(jpegs[number % FRAMES], number / RATE)
    # the times are summed over each second of images, without the first pass, in which the detectors learn
    seconds = np.array([np.array(s.times[FRAMES:]).reshape(-1, int(RATE)).sum(axis=1) for s in (current, baseline)])
    has_spot = np.isin(np.arange(FRAMES), DRAWN).reshape(-1, int(RATE)).all(axis=1)
    for name, selected in (("all", has_spot | True), ("with a spot", has_spot), ("without", ~has_spot)):
        blocks = seconds[:, selected]
        draws = np.random.default_rng(1).integers(blocks.shape[1], size=(2000, blocks.shape[1]))
        low, high = np.percentile(blocks[0][draws].sum(axis=1) / blocks[1][draws].sum(axis=1), [2.5, 97.5])
        ours_ms, gray_ms = (blocks.mean(axis=1) / RATE).tolist()
        ratio = {"ours_over_gray": ours_ms / gray_ms, "low": float(low), "high": float(high)}
        table.add(images=name, ours_ms=ours_ms, gray_ms=gray_ms, **ratio)


if __name__ == "__main__":
    main()
