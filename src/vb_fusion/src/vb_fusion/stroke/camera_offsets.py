"""Stage 2: the pointer's positions, corrected for errors of the cameras' poses.

Cameras that see the pointer at the same time disagree, as their poses are known to centimetres only. The disagreements
are modelled by one offset per stationary camera and, since localisation errors change as a robot drives and turns, by
one per second for a camera on a robot. A robot's offset changes little from one second to the next: it is a first-order
autoregressive process. Where the robot alone sees the pointer, its offset is therefore inferred from just before and
after, when other cameras saw the pointer too. All offsets are found together by weighted least squares; those of
stationary cameras are held near zero far more firmly, so that a lost robot does not move the border.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import spsolve

from vb_fusion.stroke.observations import LOCALIZATION_ERROR, TREMOR, Observations, time_bins

# correlation of a robot's error with its error a second later: localisation corrects itself within metres
ERROR_CORRELATION = math.exp(-1.0 / 10.0)


def remove_offsets(seen: Observations) -> Observations:
    """Removes the cameras' offsets from observations; an offset common to all cameras cannot be known.

    An observation is the pointer's position in its time bin plus the offset of its camera. The positions are
    eliminated, which leaves the differences from the mean of the bin.
    """
    bins = time_bins(seen.stamps)
    # unknowns exist only where something was seen: second 0 of each stationary camera, some seconds of each robot's
    second = np.where(seen.mobile, 1 + bins // 10 - bins.min() // 10, 0)
    span = int(second.max()) + 1
    unknowns, index = np.unique(seen.cameras * span + second, return_inverse=True)
    # the observations of a time bin are adjacent
    row = np.cumsum(np.append(0, np.diff(bins) != 0))
    in_bin = csr_matrix((np.ones(len(row)), (row, index)), shape=(int(row[-1]) + 1, len(unknowns)))
    share = diags(1.0 / np.bincount(row)) @ in_bin
    # each equation is divided by its standard deviation: the hand's tremor for differences, the placement error for a
    # camera's offset, and for a robot only the part of its error that is new since the previous second with a spot
    camera, time = np.divmod(unknowns, span)
    again = (np.diff(camera) == 0) & (time[:-1] > 0)
    same = np.where(again, ERROR_CORRELATION ** np.diff(time), 0.0)
    prior_precision = np.where(time > 0, (0.5 * TREMOR / LOCALIZATION_ERROR) ** 2, 1.0)
    prior_precision[1:] /= 1.0 - same**2
    change = diags([np.ones(len(time)), -same], [0, -1])
    equations = diags(np.bincount(index).astype(float)) + change.T @ diags(prior_precision) @ change - in_bin.T @ share
    apart = np.column_stack([np.bincount(index, axis) - share.T @ np.bincount(row, axis) for axis in seen.points.T])
    # rounded to 0.1 mm, so that positions found before stay the same while more is seen
    offsets = np.round(spsolve(equations.tocsc(), apart).reshape(-1, 2), 4)
    return replace(seen, points=seen.points - offsets[index])
