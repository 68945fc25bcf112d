"""Learns the classifier's curves from images in which the spots are known.

The detector itself proposes and measures; an oracle that knows the truth judges, so that the background adopts what a
right classifier would leave to it. What was measured, and the truth, are the examples. Each feature is cut into ramps
between knots, a logistic regression (scikit-learn) finds the height of each ramp, and the ramps add up to the curve.
Needs scikit-learn; nothing at run time does.
"""
from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Dict, Iterable, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from vb_laser_detect.detection.classifier import VERSION, SpotClassifier, Verdict
from vb_laser_detect.detector import DetectorParams, SpotDetector
from vb_laser_detect.detection.features import Blob

_QUANTILES = (0.01, 0.1, 0.3, 0.6, 0.9, 0.99)  # of spots and of others: where a curve may bend
_WEIGHT = 2000.0  # of the spots of a kind
_FALSE_COSTS = 10.0  # times a missed spot, which the next image shows again
_STRENGTH = 0.3  # of the fit against the wish for low ramps
# which way a curve may go: more of it speaks for a spot, or against; or for it up to a usual value and then against
_FOR = ("peak", "rise", "level", "compactness", "likeness", "edge", "smallness", "chroma", "chroma_mosaic")
_UP_TO = {"contrast": 0.9, "diameter": math.log(0.01)}


class Frame(NamedTuple):
    """One image of a clip or scene.

    Attributes:
        spots: (u, v) [px] of those in it.
        unclear: (u, v) [px] of what is neither asked for nor wrong: a pulse's first or last light.
        geometry: (to_floor, place_check) for `SpotDetector.look_from`, or None.
    """

    stamp: float
    image: np.ndarray
    spots: Sequence[Tuple[float, float]]
    unclear: Sequence[Tuple[float, float]] = ()
    geometry: Optional[Tuple[Any, Any]] = None


class Examples(NamedTuple):
    """N blobs: features (N, F) with NaN where one says nothing, truth (N,) bool, names of F features, group of each."""

    values: np.ndarray
    truth: np.ndarray
    names: Tuple[str, ...]
    groups: np.ndarray

    def without(self, group: str) -> "Examples":
        """All but those of one clip or scene."""
        rest = self.groups != group
        return Examples(self.values[rest], self.truth[rest], self.names, self.groups[rest])

    @staticmethod
    def joined(parts: Sequence["Examples"]) -> "Examples":
        """All of several."""
        return Examples(np.concatenate([p.values for p in parts]), np.concatenate([p.truth for p in parts]),
                        parts[0].names, np.concatenate([p.groups for p in parts]))


class Oracle(SpotClassifier):
    """Knows where the spots of the current frame are, and notes what it is asked."""

    def __init__(self, reach: float) -> None:
        super().__init__({}, 0.0)
        self.reach = reach
        self.frame: Optional[Frame] = None
        self.rows: List[Dict[str, float]] = []
        self.truth: List[bool] = []

    def judge(self, blob: Optional[Blob], features: Dict[str, float], expected: bool = False) -> Verdict:
        """The truth."""
        if blob is None:
            return Verdict(1.0, "")
        if expected:
            return Verdict(0.0, "known")  # the plain question was noted
        right = self._near(blob, self.frame.spots)
        if right or not self._near(blob, self.frame.unclear):
            self.rows.append(dict(features))
            self.truth.append(right)
        return Verdict(1.0 if right else 0.0, "known")

    def _near(self, blob: Blob, places: Iterable[Tuple[float, float]]) -> bool:
        return any(math.hypot(blob.u - u, blob.v - v) < self.reach for u, v in places)


def save_examples(examples: Examples, path: Path) -> None:
    """Keeps examples, so that scenes need to be rendered once."""
    np.savez_compressed(path, values=examples.values, truth=examples.truth, names=np.array(examples.names),
                        groups=examples.groups)


def load_examples(paths: Sequence[Path]) -> Examples:
    """Examples that were kept in several files."""
    return Examples.joined([Examples(data["values"], data["truth"], tuple(data["names"].tolist()), data["groups"])
                            for data in map(np.load, paths)])


def collect(frames: Iterable[Frame], params: DetectorParams, group: str, reach: float, encoding: str = "") -> Examples:
    """The examples of one clip or scene.

    Args:
        reach: [px] a blob so near to a spot's place is the spot.
        group: its name; validation leaves whole groups out.
    """
    oracle = Oracle(reach)
    detector = SpotDetector(params, oracle)
    detector.encoding = encoding
    for frame in frames:
        oracle.frame = frame
        detector.look_from(*(frame.geometry or (None, None)))
        detector.detect(frame.image, frame.stamp)
    names = tuple(oracle.rows[0]) if oracle.rows else ()
    values = np.array([list(row.values()) for row in oracle.rows], float)
    return Examples(values, np.array(oracle.truth, bool), names, np.array([group] * len(values)))


def fit(examples: Examples) -> SpotClassifier:
    """Fits the curves. Clips, and each kind of rendered scene ("kind: name"), count alike, however many there are."""
    from sklearn.linear_model import LogisticRegression

    values, truth = examples.values, examples.truth
    weights, kinds = np.zeros(len(truth)), np.array([g.split(":")[0] if ":" in g else "clip" for g in examples.groups])
    for there, share in ((True, 1.0), (False, _FALSE_COSTS)):
        for kind in np.unique(kinds[truth == there]):
            of_kind = (truth == there) & (kinds == kind)
            for group in np.unique(examples.groups[of_kind]):
                rows = of_kind & (examples.groups == group)
                weights[rows] = 1.0 / math.sqrt(rows.sum())  # long ones tell more, but not in proportion
            weights[of_kind] *= share * _WEIGHT / weights[of_kind].sum()
    # where a feature says nothing it counts as a usual spot's
    usual = np.array([np.median(c[truth & ~np.isnan(c)]) if (truth & ~np.isnan(c)).any() else np.nan for c in values.T])
    knots = [_knots(column, truth) for column in values.T]  # where it says something: else most would lie at the usual value
    values = np.where(np.isnan(values), usual, values)
    ramps = [_ramps(column, x) for column, x in zip(values.T, knots)]
    design = np.hstack(ramps)
    signs = np.concatenate([_signs(name, x) for name, x in zip(examples.names, knots)])
    heights, free = np.zeros(len(signs)), np.ones(len(signs), bool)
    while True:
        model = LogisticRegression(C=_STRENGTH, solver="newton-cholesky", max_iter=200)
        model.fit(design[:, free], truth, sample_weight=weights)
        heights[:] = 0.0
        heights[free] = model.coef_[0]
        wrong = heights * signs < 0
        if not wrong.any():
            break
        free &= ~wrong  # a ramp that goes the wrong way is an accident of these examples: it stays level
    intercept, curves, first = float(model.intercept_[0]), {}, 0
    for name, x, middle in zip(examples.names, knots, usual):
        part = heights[first : first + max(0, len(x) - 1)]
        first += len(part)
        if not part.any():
            continue
        y = np.concatenate([[0.0], np.cumsum(part)])
        level = float(np.interp(middle, x, y))
        curves[name] = (x, y - level)
        intercept += level
    return SpotClassifier(curves, intercept)


def logits(classifier: SpotClassifier, examples: Examples) -> np.ndarray:
    """(N,) what the classifier says of each example, from all features."""
    total = np.full(len(examples.truth), classifier.intercept)
    for name, column in zip(examples.names, examples.values.T):
        if name in classifier.curves:
            total += np.where(np.isnan(column), 0.0, np.interp(np.nan_to_num(column), *classifier.curves[name]))
    return total


def validate(examples: Examples) -> List[Tuple[str, np.ndarray, np.ndarray]]:
    """(group, truth, logits) of each group, by classifiers that were fitted without it."""
    result = []
    for group in np.unique(examples.groups):
        out = examples.groups == group
        own = Examples(examples.values[out], examples.truth[out], examples.names, examples.groups[out])
        result.append((str(group), own.truth, logits(fit(examples.without(group)), own)))
    return result


def save(classifier: SpotClassifier, path: Path, trained_on: str) -> None:
    """Writes a classifier; inverse of `classifier.load`."""
    document = {
        "version": VERSION, "trained_on": trained_on, "intercept": round(classifier.intercept, 4),
        "curves": {name: {"knots": [round(float(v), 5) for v in x], "values": [round(float(v), 4) for v in y]}
                   for name, (x, y) in classifier.curves.items()},
    }
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _signs(name: str, knots: np.ndarray) -> np.ndarray:
    """(K - 1,) which way each ramp between a feature's knots may go."""
    middles = 0.5 * (knots[1:] + knots[:-1])
    if name in _UP_TO:
        return np.where(middles < _UP_TO[name], 1.0, -1.0)
    return np.full(len(middles), 1.0 if name in _FOR else -1.0)


def _knots(column: np.ndarray, truth: np.ndarray) -> np.ndarray:
    known = ~np.isnan(column)
    if not known.any():
        return np.zeros(0)
    # most values of some features are 0: what the others are like tells apart too
    parts = [np.quantile(column[rows], _QUANTILES) for kind in (True, False)
             for rows in (known & (truth == kind), known & (truth == kind) & (column != 0)) if rows.any()]
    x = np.unique(np.round(np.concatenate(parts), 5))
    least = 0.03 * (x[-1] - x[0])
    kept = [x[0]]
    for value in x[1:]:
        if value - kept[-1] > max(least, 1e-4):
            kept.append(value)
    return np.array(kept)


def _ramps(column: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """(N, K - 1): how far each value is up the ramp between two knots, 0 ... 1; 0 where nothing is known."""
    if len(knots) < 2:
        return np.zeros((len(column), 0))
    part = (column[:, None] - knots[None, :-1]) / np.diff(knots)[None]
    return np.nan_to_num(np.clip(part, 0.0, 1.0))
