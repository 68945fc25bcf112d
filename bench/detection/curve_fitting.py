"""Learns the classifier's curves from examples.

Each feature is cut into ramps between knots, a logistic regression finds the height of each ramp, and the ramps add up to
the curve. Examples are as training.py collects them.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Dict, Iterable, NamedTuple, Tuple

import numpy as np
import pandas
from scipy.optimize import minimize

from bench.detection.clip_frames import is_clip, left_out_with
from vb_laser_detect.detection.features import SpotClassifier

_QUANTILES = (0.01, 0.1, 0.3, 0.6, 0.9, 0.99)  # of spots and of others: where a curve may bend
_WEIGHT = 1500.0  # total weight of the spots of a kind
_FALSE_COSTS = 3.0  # times a missed spot, which the next image shows again
_STRENGTH = 0.3  # inverse strength of the regularisation, which keeps ramps low
# features that speak for a spot; those that do up to a value, and then against it; all others speak against it
_FOR = ("peak", "level", "edge", "chroma_mosaic")
_UP_TO = {"diameter": math.log(0.01)}


def load_examples(files: Iterable[Path]) -> pandas.DataFrame:
    """Loads the examples of several clips and scenes, as training.py collects those of each."""
    parts = [pandas.read_csv(file, index_col=0, float_precision="round_trip") for file in files]
    return pandas.concat([part for part in parts if len(part)])


def fit(examples: pandas.DataFrame) -> SpotClassifier:
    """Fits the curves: a logistic regression over ramps whose signs are fixed, one convex problem with one solution.

    Within a kind (clips; each kind of rendered scene, "kind: name") each example counts alike, a false spot
    as three missed ones; the spots of each kind have the same total weight. Classes must not be balanced within a kind:
    one with few other bright things would weigh each like dozens of spots, and shift its limits into the spots.
    """
    names, truth = examples.columns[:-1], examples.truth.to_numpy()
    columns = examples[names].to_numpy().T
    kinds = np.array([kind_of(group) for group in examples.index])
    weights = np.where(truth, 1.0, _FALSE_COSTS)
    for kind in np.unique(kinds):
        of_kind = kinds == kind
        weights[of_kind] *= _WEIGHT / (np.count_nonzero(of_kind & truth) or np.count_nonzero(of_kind))
    # an unknown feature counts as a usual spot's
    known = [column[truth & ~np.isnan(column)] for column in columns]
    usual = np.array([np.median(column) if len(column) else np.nan for column in known])
    values = np.where(np.isnan(columns.T), usual, columns.T)
    # a feature against a spot counts only beyond a usual spot's value: less of it does not speak for a spot
    against = np.array([name not in _FOR and name not in _UP_TO for name in names])
    values = np.where(against, np.maximum(values, usual), values)
    knots = [_knots(np.where(np.isnan(given), np.nan, x), truth) for given, x in zip(columns, values.T)]
    signs = np.concatenate([_signs(name, x) for name, x in zip(names, knots)] + [[1.0]])
    ramps = [_ramps(column, x) for column, x in zip(values.T, knots)]
    design = np.hstack(ramps + [np.ones((len(truth), 1))]) * signs * np.where(truth, 1.0, -1.0)[:, None]
    pull = np.full(len(signs), 1.0 / _STRENGTH)
    pull[-1] = 0.0

    def loss(heights: np.ndarray) -> Tuple[float, np.ndarray]:
        margins = design @ heights
        slopes = -weights * np.exp(-np.logaddexp(0.0, margins))
        return (
            float(weights @ np.logaddexp(0.0, -margins) + 0.5 * pull @ heights**2),
            design.T @ slopes + pull * heights,
        )

    # a ramp that would go the wrong way, by accident of these examples, stays level
    bounds = [(0.0, None)] * (len(signs) - 1) + [(None, None)]
    found = minimize(
        loss,
        np.zeros(len(signs)),
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": 5000, "maxfun": 10000, "ftol": 0.0, "gtol": 1e-6},
    )
    heights = found.x * signs
    intercept, curves, first = float(heights[-1]), {}, 0
    for name, x, middle in zip(names, knots, usual):
        part = heights[first : first + max(0, len(x) - 1)]
        first += len(part)
        if np.abs(part).sum() < 0.01:
            continue
        y = np.concatenate([[0.0], np.cumsum(part)])
        level = float(np.interp(middle, x, y))
        curves[name] = (x, y - level)
        intercept += level
    return SpotClassifier(curves, intercept)


def kind_of(group: str) -> str:
    """Returns what a clip or scene is by its name: a clip, a clip taken again, or a kind of scene."""
    return group.split(":")[0] if ":" in group else "clip"


def logits(classifier: SpotClassifier, examples: pandas.DataFrame) -> np.ndarray:
    """Returns the classifier's logits (N,) of the examples, from all features."""
    parts = [np.nan_to_num(np.interp(examples[name], *curve)) for name, curve in classifier.curves.items()]
    return classifier.intercept + np.sum(parts, axis=0)


class LeftOut(NamedTuple):
    """A classifier fitted without a clip or scene and all that is left out with it, and its logits for these examples.

    Attributes:
        truth, logits: (N,) of its examples.
    """

    judge: SpotClassifier
    truth: np.ndarray
    logits: np.ndarray


def leave_out(examples: pandas.DataFrame, only_clips: bool = False) -> Dict[str, LeftOut]:
    """Fits a classifier without each clip or scene and what is left out with it: see `left_out_with`."""
    judges: Dict[Tuple[str, ...], SpotClassifier] = {}
    found = {}
    for group, out in sorted(left_out_with(sorted(set(examples.index))).items()):
        if only_clips and not is_clip(group):
            continue
        kin = tuple(sorted(out))
        if kin not in judges:
            judges[kin] = fit(examples[~examples.index.isin(kin)])
        own = examples[examples.index == group]
        found[group] = LeftOut(judges[kin], own.truth.to_numpy(), logits(judges[kin], own))
    return found


def calibrate(classifier: SpotClassifier, left_out: Iterable[LeftOut]) -> SpotClassifier:
    """Makes a classifier's probabilities right on average for unseen cameras and rooms (Platt scaling)."""
    truth, judged = (np.concatenate(arrays) for arrays in zip(*((one.truth, one.logits) for one in left_out)))

    def loss(scaling: np.ndarray) -> float:
        margins = scaling[0] * judged + scaling[1]
        return float(np.sum(np.logaddexp(0.0, margins) - truth * margins))

    scale, shift = minimize(loss, np.array([1.0, 0.0]), method="Nelder-Mead").x
    curves = {name: (x, scale * y) for name, (x, y) in classifier.curves.items()}
    return SpotClassifier(curves, float(scale * classifier.intercept + shift))


def judges_of_clips(folder: Path) -> Dict[str, SpotClassifier]:
    """Fits a calibrated classifier for each clip, to the examples of a folder without its camera and its room."""
    left_out = leave_out(load_examples(sorted(folder.glob("*.csv"))), only_clips=True)
    return {group: calibrate(one.judge, left_out.values()) for group, one in left_out.items()}


def save(classifier: SpotClassifier, path: Path, trained_on: str) -> None:
    """Writes a classifier, as `features.packaged_classifier` reads it."""
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
    """Returns which way each ramp between a feature's knots may go, (K - 1,)."""
    middles = 0.5 * (knots[1:] + knots[:-1])
    if name in _UP_TO:
        return np.where(middles < _UP_TO[name], 1.0, -1.0)
    return np.full(len(middles), 1.0 if name in _FOR else -1.0)


def _knots(column: np.ndarray, truth: np.ndarray) -> np.ndarray:
    known = ~np.isnan(column)
    if not known.any():
        return np.zeros(0)
    # most values of some features are 0: the quantiles of the others matter too
    parts = [
        np.quantile(column[rows], _QUANTILES)
        for kind in (True, False)
        for rows in (known & (truth == kind), known & (truth == kind) & (column != 0))
        if rows.any()
    ]
    x = np.unique(np.round(np.concatenate(parts), 3))
    least = 0.03 * (x[-1] - x[0])
    kept = [x[0]]
    for value in x[1:]:
        if value - kept[-1] > max(least, 1e-3):
            kept.append(value)
    return np.array(kept)


def _ramps(column: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Returns how far each value is up the ramp between two knots, (N, K - 1) 0 ... 1; 0 where nothing is known."""
    if len(knots) < 2:
        return np.zeros((len(column), 0))
    part = (column[:, None] - knots[None, :-1]) / np.diff(knots)[None]
    return np.nan_to_num(np.clip(part, 0.0, 1.0))
