"""Fits the classifier's curves to examples of spots and of other bright things.

Each feature is divided into ramps between knots. A logistic regression fits the height of each ramp, and the sum of the
ramps is the feature's curve in `features.SpotClassifier`. bench/detection/training.py collects the examples.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Sequence, Tuple

import numpy as np
from scipy.optimize import minimize

from vb_laser_detect.detection.features import SpotClassifier

_QUANTILES = (0.01, 0.1, 0.3, 0.6, 0.9, 0.99)  # of spots and of others; a curve may bend there
_STRENGTH = 0.3  # inverse strength of the regularisation, which limits the ramps
# higher values of these features indicate a spot; of those in _UP_TO only up to a value; of all others, no spot
_FOR = ("peak", "level", "edge", "chroma_mosaic")
_UP_TO = {"diameter": math.log(0.01)}


def fit_classifier(
    names: Sequence[str], features: np.ndarray, truth: np.ndarray, weights: np.ndarray
) -> SpotClassifier:
    """Fits the curves by logistic regression over ramps with fixed signs, a convex problem with one solution.

    Args:
        names: the F features' names.
        features: (N, F) of the examples, NaN where unknown.
        truth: (N,) bool, whether each is a spot.
        weights: (N,) of the examples.
    """
    columns = features.T
    # an unknown feature has the value of a usual spot
    known_values = [column[truth & ~np.isnan(column)] for column in columns]
    usual_values = np.array([np.median(known) if len(known) else np.nan for known in known_values])
    values = np.where(np.isnan(columns.T), usual_values, columns.T)
    # a feature that indicates no spot counts only above a usual spot's value, as lower values do not indicate a spot
    against = np.array([name not in _FOR and name not in _UP_TO for name in names])
    values = np.where(against, np.maximum(values, usual_values), values)
    known_only = np.where(np.isnan(columns.T), np.nan, values)
    knots = [_knots(column, truth) for column in known_only.T]
    signs = np.concatenate([_signs(name, x) for name, x in zip(names, knots)] + [[1.0]])
    ramps = [_ramps(column, x) for column, x in zip(values.T, knots)]
    outcomes = np.where(truth, 1.0, -1.0)
    design = np.hstack(ramps + [np.ones((len(truth), 1))]) * signs * outcomes[:, None]
    penalty = np.full(len(signs), 1.0 / _STRENGTH)
    penalty[-1] = 0.0

    def loss(heights: np.ndarray) -> Tuple[float, np.ndarray]:
        margins = design @ heights
        slopes = -weights * np.exp(-np.logaddexp(0.0, margins))
        value = float(weights @ np.logaddexp(0.0, -margins) + 0.5 * penalty @ heights**2)
        return value, design.T @ slopes + penalty * heights

    # a ramp that would have the wrong sign, by chance in these examples, is flat
    bounds = [(0.0, None)] * (len(signs) - 1) + [(None, None)]
    limits = {"maxiter": 5000, "maxfun": 10000, "ftol": 0.0, "gtol": 1e-6}
    solution = minimize(loss, np.zeros(len(signs)), jac=True, method="L-BFGS-B", bounds=bounds, options=limits)
    heights = solution.x * signs
    intercept = float(heights[-1])
    curves = {}
    first = 0
    for name, x, usual_value in zip(names, knots, usual_values):
        ramp_heights = heights[first : first + max(0, len(x) - 1)]
        first += len(ramp_heights)
        if np.abs(ramp_heights).sum() < 0.01:
            continue
        y = np.concatenate([[0.0], np.cumsum(ramp_heights)])
        level = float(np.interp(usual_value, x, y))
        curves[name] = (x, y - level)
        intercept += level
    return SpotClassifier(curves, intercept)


def write_classifier(classifier: SpotClassifier, path: Path, trained_on: str) -> None:
    """Writes a classifier in the format of `features.packaged_classifier`."""
    curves = [
        f'  "{name}": {{"knots": {json.dumps([round(float(v), 3) for v in x])},\n'
        f'    "values": {json.dumps([round(float(v), 2) for v in y])}}}'
        for name, (x, y) in classifier.curves.items()
    ]
    path.write_text(
        f'{{"trained_on": {json.dumps(trained_on)},\n'
        f' "intercept": {round(classifier.intercept, 2)},\n "curves": {{\n' + ",\n".join(curves) + "}}\n",
        encoding="utf-8",
    )


def _signs(name: str, knots: np.ndarray) -> np.ndarray:
    """Returns the permitted sign of each ramp between a feature's knots, (K - 1,)."""
    middles = 0.5 * (knots[1:] + knots[:-1])
    if name in _UP_TO:
        return np.where(middles < _UP_TO[name], 1.0, -1.0)
    return np.full(len(middles), 1.0 if name in _FOR else -1.0)


def _knots(column: np.ndarray, truth: np.ndarray) -> np.ndarray:
    known = ~np.isnan(column)
    if not known.any():
        return np.zeros(0)
    # adds the quantiles of the other values, because most values of some features are 0
    parts = [
        np.quantile(column[rows], _QUANTILES)
        for kind in (True, False)
        for rows in (known & (truth == kind), known & (truth == kind) & (column != 0))
        if rows.any()
    ]
    x = np.unique(np.round(np.concatenate(parts), 3))
    min_distance = 0.03 * (x[-1] - x[0])
    knots = [x[0]]
    for value in x[1:]:
        if value - knots[-1] > max(min_distance, 1e-3):
            knots.append(value)
    return np.array(knots)


def _ramps(column: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Returns each value's position on the ramp between two knots, (N, K - 1) from 0 to 1; 0 if it is unknown."""
    if len(knots) < 2:
        return np.zeros((len(column), 0))
    part = (column[:, None] - knots[None, :-1]) / np.diff(knots)[None]
    return np.nan_to_num(np.clip(part, 0.0, 1.0))
