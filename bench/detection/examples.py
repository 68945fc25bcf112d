"""Examples for the spot classifier, from images in which the spots are known.

The detector itself proposes and measures; an oracle that knows the truth judges, so that the background adopts what a
right classifier would leave to it. What was measured, and the truth, are the examples.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Dict, Iterable, List, Optional, Tuple

import numpy as np
import pandas

from bench.detection.clip_frames import LabeledFrame
from vb_laser_detect.detection.features import Blob, SpotClassifier
from vb_laser_detect.detector import DetectorParams, SpotDetector


class Oracle(SpotClassifier):
    """Stands in for the classifier: answers from the current frame's labels, and records the candidates.

    What is beside a labelled spot is not recorded: in each image it is much the same, and would count many times.
    """

    def __init__(self, reach: float) -> None:
        super().__init__({}, 0.0)
        self.reach = reach
        self.frame: Optional[LabeledFrame] = None
        self.rows: List[Dict[str, float]] = []
        self.truth: List[bool] = []

    def classify(self, blob: Blob, features: Dict[str, float], expected: bool = False) -> Tuple[float, str]:
        """Returns the truth."""
        right = self._near(blob, self.frame.spots)
        if right or not (self.frame.spots or self._near(blob, self.frame.unclear)):
            self.rows.append(dict(features))
            self.truth.append(right)
        return float(right), "known"

    def _near(self, blob: Blob, places: Iterable[Tuple[float, float]]) -> bool:
        return any(math.hypot(blob.u - u, blob.v - v) < self.reach for u, v in places)


def load_examples(files: Iterable[Path]) -> pandas.DataFrame:
    """Loads the examples of several clips and scenes, as `collect` makes those of each."""
    parts = [pandas.read_csv(file, index_col=0, float_precision="round_trip") for file in files]
    return pandas.concat([part for part in parts if len(part)])


def collect(frames: Iterable[LabeledFrame], params: DetectorParams, group: str, reach: float) -> pandas.DataFrame:
    """Collects the examples of one clip or scene.

    Args:
        reach: [px] a blob so near to a spot's place is the spot.
        group: its name; validation leaves whole groups out.

    Returns:
        A row for each blob: its features, NaN where one says nothing, and its truth; the group is the index.
    """
    oracle = Oracle(reach)
    detector = SpotDetector(params, oracle)
    for frame in frames:
        oracle.frame = frame
        detector.detect(frame.image, frame.stamp, frame.geometry)
    # what OpenCV sums in single precision depends on where its memory begins, far behind these digits
    values = np.round(np.array([list(row.values()) for row in oracle.rows], float), 5)
    names = list(oracle.rows[0]) if oracle.rows else None
    return pandas.DataFrame(values, index=[group] * len(values), columns=names).assign(truth=oracle.truth)
