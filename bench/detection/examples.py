"""Examples for the spot classifier, from images in which the spots are known.

The detector itself proposes and measures; an oracle that knows the truth judges, so that the background adopts what a
right classifier would leave to it. What was measured, and the truth, are the examples.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Dict, Iterable, List, NamedTuple, Optional, Sequence, Tuple, Union

import numpy as np

from vb_core.image_format import Picture
from vb_laser_detect.detection.features import Blob, SpotClassifier
from vb_laser_detect.detection.projection import ImageGeometry
from vb_laser_detect.detector import DetectorParams, SpotDetector


class LabeledFrame(NamedTuple):
    """One image of a clip or scene.

    Attributes:
        spots: (u, v) [px] of those in it.
        unclear: (u, v) [px] of what is neither asked for nor wrong: a pulse's first or last light.
        image: as `SpotDetector.detect` takes it.
        geometry: where its pixels are on the floor, or None.
    """

    stamp: float
    image: Union[np.ndarray, Picture]
    spots: Sequence[Tuple[float, float]]
    unclear: Sequence[Tuple[float, float]] = ()
    geometry: Optional[ImageGeometry] = None


class Examples(NamedTuple):
    """N blobs: features (N, F) with NaN where one says nothing, truth (N,) bool, names of F features, group of each."""

    values: np.ndarray
    truth: np.ndarray
    names: Tuple[str, ...]
    groups: np.ndarray

    def select(self, rows: np.ndarray) -> "Examples":
        """Returns the examples of some rows, (N,) bool."""
        return Examples(self.values[rows], self.truth[rows], self.names, self.groups[rows])

    def exclude(self, *groups: str) -> "Examples":
        """Returns all examples but those of some clips or scenes."""
        return self.select(~np.isin(self.groups, groups))

    @staticmethod
    def join(parts: Sequence["Examples"]) -> "Examples":
        """Joins the examples of several clips and scenes."""
        return Examples(
            np.concatenate([p.values for p in parts]),
            np.concatenate([p.truth for p in parts]),
            parts[0].names,
            np.concatenate([p.groups for p in parts]),
        )


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


def save_examples(examples: Examples, path: Path) -> None:
    """Keeps the examples of one clip or scene; the file is there once it is whole."""
    part = path.with_suffix(".part")
    with part.open("wb") as file:
        np.savez_compressed(
            file, values=examples.values, truth=examples.truth, names=np.array(examples.names), groups=examples.groups
        )
    part.replace(path)


def load_examples(files: Iterable[Path]) -> Examples:
    """Loads the examples of several clips and scenes; inverse of `save_examples` for each."""
    parts = [
        Examples(data["values"], data["truth"], tuple(data["names"].tolist()), data["groups"])
        for data in map(np.load, files)
    ]
    return Examples.join([part for part in parts if len(part.truth)])


def collect(frames: Iterable[LabeledFrame], params: DetectorParams, group: str, reach: float) -> Examples:
    """Collects the examples of one clip or scene.

    Args:
        reach: [px] a blob so near to a spot's place is the spot.
        group: its name; validation leaves whole groups out.
    """
    oracle = Oracle(reach)
    detector = SpotDetector(params, oracle)
    for frame in frames:
        oracle.frame = frame
        detector.detect(frame.image, frame.stamp, frame.geometry)
    names = tuple(oracle.rows[0]) if oracle.rows else ()
    # what OpenCV sums in single precision depends on where its memory begins, far behind these digits
    values = np.round(np.array([list(row.values()) for row in oracle.rows], float), 5)
    return Examples(values, np.array(oracle.truth, bool), names, np.array([group] * len(values)))
