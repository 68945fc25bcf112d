"""Stage 3: the samples of the stroke.

The observations, in the order in which they were drawn, become samples a tremor apart; a spot held still is
one sample, however long. A piece drawn again at the end of the stroke is merged into it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree


@dataclass(frozen=True)
class ResampledStroke:
    """Samples along a stroke, in the order in which they were drawn.

    Attributes:
        points: (K, 2) [m].
        trust: (K,) the total weight of the observations in each sample.
        tremor: [m] smaller details are noise.
    """

    points: np.ndarray
    trust: np.ndarray
    tremor: float

    @property
    def weights(self) -> np.ndarray:
        """(K,) [m] length of the line that each sample represents."""
        steps = np.minimum(np.linalg.norm(np.diff(self.points, axis=0), axis=1), 2.0 * self.tremor)
        return 0.5 * (np.append(steps, 0.0) + np.append(0.0, steps)) + 0.1 * self.tremor


def resample_stroke(observations: np.ndarray, trust: np.ndarray, tremor: float) -> ResampledStroke:
    """Resamples observations evenly along the stroke; a piece drawn again at the end is merged.

    Args:
        observations: (N, 2) [m], N >= 3, in order.
        trust: (N,) their weights.
        tremor: [m] distance between samples.
    """
    # a mean over three observations, as two cameras that see the spot in turn do not make a movement
    wide = np.pad(np.column_stack([observations * trust[:, None], trust]), ((1, 1), (0, 0)), mode="edge")
    total = wide[:-2] + wide[1:-1] + wide[2:]
    calm = total[:, :2] / total[:, 2:]
    sample = np.empty(len(calm), dtype=int)
    number, seen, x, y = 0, 0, 0.0, 0.0
    for row, (px, py) in enumerate(calm.tolist()):
        if seen and (px - x / seen) ** 2 + (py - y / seen) ** 2 > tremor**2:
            number, seen, x, y = number + 1, 0, 0.0, 0.0
        seen, x, y = seen + 1, x + px, y + py
        sample[row] = number
    stroke = _means(observations, trust, sample, tremor)
    # the line ends where the spot was seen first and last
    stroke.points[[0, -1]] = calm[[0, -1]]
    return _merge_repeats(stroke)


def _means(points: np.ndarray, trust: np.ndarray, sample: np.ndarray, tremor: float) -> ResampledStroke:
    total = np.bincount(sample, trust)
    places = np.column_stack([np.bincount(sample, trust * axis) / total for axis in points.T])
    return ResampledStroke(places, total, tremor)


def _merge_repeats(stroke: ResampledStroke) -> ResampledStroke:
    """Ends the stroke where it no longer reaches new floor: a line drawn twice is one line, seen twice as often."""
    at = stroke.points
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(at, axis=0), axis=1))])
    earlier, later = cKDTree(at).query_pairs(2.0 * stroke.tremor, output_type="ndarray").T
    # the stroke between them is longer than a mere bend would make it
    again = arc[later] - arc[earlier] > 2.0 * np.linalg.norm(at[later] - at[earlier], axis=1) + stroke.tremor
    new = np.ones(len(at), dtype=bool)
    new[later[again]] = False
    # two samples beside the line may be an overshoot; three are new floor
    run = np.flatnonzero(new[:-2] & new[1:-1] & new[2:])
    kept = int(run[-1]) + 3 if len(run) else len(at)
    if len(at) - kept < 4:
        return stroke  # an end that comes back to the start closes a ring
    nearest = cKDTree(at[:kept]).query(at[kept:])[1]
    return _means(at, stroke.trust, np.concatenate([np.arange(kept), nearest]), stroke.tremor)
