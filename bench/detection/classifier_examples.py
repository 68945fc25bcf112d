"""Examples for the spot classifier: which groups weigh how much, and which are left out together.

training.py collects the examples; `vb_laser_detect.detection.classifier_fitting` fits the curves.
"""

from __future__ import annotations

from pathlib import Path
from typing import Dict, Iterable, NamedTuple, Tuple

import numpy as np
import pandas
from scipy.optimize import minimize

from bench.detection.clip_frames import is_clip, left_out_with
from vb_laser_detect.detection.classifier_fitting import fit_classifier
from vb_laser_detect.detection.features import SpotClassifier

_WEIGHT = 1500.0  # total weight of the spots of a kind
_FALSE_SPOT_COST = 3.0  # relative to the cost of a missed spot, which the next image shows again


def load_examples(files: Iterable[Path]) -> pandas.DataFrame:
    """Loads the examples of several clips and scenes, each collected by training.py."""
    parts = [pandas.read_csv(file, index_col=0, float_precision="round_trip") for file in files]
    return pandas.concat([part for part in parts if len(part)])


def fit(examples: pandas.DataFrame) -> SpotClassifier:
    """Fits a classifier to examples, with a weight for each.

    Clips are one kind of examples, and each kind of rendered scene ("kind: name") is another. The spots of each kind
    have the same total weight. Within a kind all examples weigh the same, except that a false spot counts as three
    missed ones. Classes are not balanced, because one of a few bright objects would then weigh as much as many spots.
    """
    names, truth = examples.columns[:-1], examples.truth.to_numpy()
    kinds = np.array([kind_of(group) for group in examples.index])
    weights = np.where(truth, 1.0, _FALSE_SPOT_COST)
    for kind in np.unique(kinds):
        of_kind = kinds == kind
        weights[of_kind] *= _WEIGHT / (np.count_nonzero(of_kind & truth) or np.count_nonzero(of_kind))
    return fit_classifier(list(names), examples[names].to_numpy(), truth, weights)


def kind_of(group: str) -> str:
    """Returns the kind of a group by its name: a clip, an augmented clip, or a kind of scene."""
    return group.split(":")[0] if ":" in group else "clip"


def logits(classifier: SpotClassifier, examples: pandas.DataFrame) -> np.ndarray:
    """Returns the classifier's logits (N,) for the examples, from all features."""
    parts = [np.nan_to_num(np.interp(examples[name], *curve)) for name, curve in classifier.curves.items()]
    return classifier.intercept + np.sum(parts, axis=0)


class LeftOut(NamedTuple):
    """A classifier fitted without a clip or scene and the groups left out with it.

    Attributes:
        truth, logits: (N,) of the clip's or scene's examples.
    """

    classifier: SpotClassifier
    truth: np.ndarray
    logits: np.ndarray


def leave_out(examples: pandas.DataFrame, only_clips: bool = False) -> Dict[str, LeftOut]:
    """Fits a classifier without each clip or scene and the groups left out with it; see `left_out_with`."""
    classifiers: Dict[Tuple[str, ...], SpotClassifier] = {}
    result = {}
    for group, names in sorted(left_out_with(sorted(set(examples.index))).items()):
        if only_clips and not is_clip(group):
            continue
        excluded = tuple(sorted(names))
        if excluded not in classifiers:
            classifiers[excluded] = fit(examples[~examples.index.isin(excluded)])
        rows = examples[examples.index == group]
        result[group] = LeftOut(classifiers[excluded], rows.truth.to_numpy(), logits(classifiers[excluded], rows))
    return result


def calibrate_classifier(classifier: SpotClassifier, left_out: Iterable[LeftOut]) -> SpotClassifier:
    """Calibrates a classifier's probabilities for unseen cameras and rooms (Platt scaling)."""
    results = list(left_out)
    truth = np.concatenate([result.truth for result in results])
    scores = np.concatenate([result.logits for result in results])

    def loss(scaling: np.ndarray) -> float:
        margins = scaling[0] * scores + scaling[1]
        return float(np.sum(np.logaddexp(0.0, margins) - truth * margins))

    scale, shift = minimize(loss, np.array([1.0, 0.0]), method="Nelder-Mead").x
    curves = {name: (x, scale * y) for name, (x, y) in classifier.curves.items()}
    return SpotClassifier(curves, float(scale * classifier.intercept + shift))


def classifiers_of_clips(folder: Path) -> Dict[str, SpotClassifier]:
    """Fits a calibrated classifier for each clip, to a folder's examples without the clip's camera and room."""
    left_out = leave_out(load_examples(sorted(folder.glob("*.csv"))), only_clips=True)
    return {group: calibrate_classifier(result.classifier, left_out.values()) for group, result in left_out.items()}
