"""Decides whether a blob is a laser spot, by a sum of each feature's contribution.

An additive logistic model. Each feature has a curve, linear between knots, whose value is what it adds to the logarithm
of the odds; it is 0 for a usual spot, so the feature that lowers it most is the reason for a rejection. The curves are
trained by bench/detection/training.py and stored as numbers.
"""

from __future__ import annotations

import json
import math
from functools import lru_cache
from pathlib import Path
from typing import Dict, NamedTuple, Tuple

import numpy as np

from vb_core.errors import CodedError
from vb_laser_detect.detection.features import Blob

VERSION = 1
BUILT_IN = Path(__file__).resolve().parent / "spot_classifier.json"
# features of the surroundings do not count against a spot that is where it was expected; nor does colour, which it has
# shown and other light may now hide
_NOT_AGAINST_EXPECTED = ("darker", "fall", "busy", "chroma_mosaic")


class Classification(NamedTuple):
    """Probability that a blob is a spot, 0 ... 1, and the feature that lowers it most."""

    probability: float
    rejection_reason: str


class SpotClassifier:
    """The curves of all features.

    Args:
        curves: feature to (knots, values), both (K,); values in logits.
        intercept: [logits] of a usual spot.
    """

    def __init__(self, curves: Dict[str, Tuple[np.ndarray, np.ndarray]], intercept: float) -> None:
        self.curves, self.intercept = curves, intercept

    def classify(self, blob: Blob, features: Dict[str, float], expected: bool = False) -> Classification:
        """Weighs a blob's features; one that says nothing (NaN) adds nothing.

        Args:
            blob: itself; the curves do not use it.
            expected: a spot was seen until now, and should be there.

        Returns:
            How likely it is a spot, and the feature that speaks most against it.
        """
        logit, least, reason = self.intercept, math.inf, ""
        for name, value in features.items():
            if name in self.curves and not math.isnan(value):
                part = float(np.interp(value, *self.curves[name]))
                if expected and name in _NOT_AGAINST_EXPECTED:
                    part = max(0.0, part)
                logit += part
                if part < least:
                    least, reason = part, name
        return Classification(1.0 / (1.0 + math.exp(-max(-50.0, min(50.0, logit)))), reason)


@lru_cache(maxsize=None)
def load(path: str = "") -> SpotClassifier:
    """Reads a stored classifier; an empty path means the one that comes with the package.

    Raises:
        CodedError: "bad_classifier" if there is none, or one of another version.
    """
    where = Path(path).expanduser() if path else BUILT_IN
    try:
        document = json.loads(where.read_text(encoding="utf-8"))
        if document["version"] != VERSION:
            raise ValueError(f"version {document['version']}, expected {VERSION}")
        curves = {
            name: (np.array(curve["knots"], float), np.array(curve["values"], float))
            for name, curve in document["curves"].items()
        }
        if any(len(x) != len(y) or len(x) < 2 or not (np.diff(x) > 0).all() for x, y in curves.values()):
            raise ValueError("a curve's knots do not rise")
        return SpotClassifier(curves, float(document["intercept"]))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CodedError("bad_classifier", path=str(where), why=str(error)) from None
