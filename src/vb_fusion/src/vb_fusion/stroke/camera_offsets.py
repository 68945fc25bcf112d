"""Stage 2: where the pointer really was.

Cameras that see the pointer at the same time disagree: their poses are known to centimetres only. The disagreements
are explained by one offset per stationary camera, and for a camera on a robot by one per second, since localisation
errs differently as the robot drives and turns. But it errs much the same from one second to the next: a first-order
autoregressive process. So where the robot alone sees the pointer, the offset is what it was beside the other cameras
just before and after. All offsets are found at once by weighted least squares; stationary cameras are held near zero
far more firmly than mobile ones, so that a robot that is lost does not move the border.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import spsolve

from vb_fusion.stroke.observations import LOCALIZATION_ERROR, TREMOR, Observations, time_bins

# share of a robot's error that is the same a second later: localisation corrects itself within metres
ERROR_CORRELATION = math.exp(-1.0 / 10.0)


def remove_offsets(seen: Observations) -> Observations:
    """Removes the cameras' offsets from observations; an offset common to all cameras cannot be known.

    An observation is the pointer's place in its time bin plus the offset of its camera. The places are eliminated: what
    is left are the differences from the mean of the bin.
    """
    cameras = int(seen.cameras.max()) + 1
    moment = time_bins(seen.stamps)
    # unknowns exist only where something was seen
    seconds, index = np.unique(moment[seen.mobile] // 10, return_inverse=True)
    second = np.zeros(len(moment), dtype=int)
    second[seen.mobile] = 1 + index
    offset = second * cameras + seen.cameras
    unknown = (len(seconds) + 1) * cameras
    # the observations of a moment follow one another
    row = np.cumsum(np.append(0, np.diff(moment) != 0))
    in_moment = csr_matrix((np.ones(len(row)), (row, offset)), shape=(int(row[-1]) + 1, unknown))
    share = diags(1.0 / np.bincount(row)) @ in_moment
    # each equation in units of its deviation: a difference as a hand trembles, an offset as the camera is placed
    robots = np.unique(seen.cameras[seen.mobile])
    prior = _prior_weight(unknown, robots + cameras * np.arange(1, unknown // cameras)[:, None], np.diff(seconds))
    equations = diags(np.bincount(offset, minlength=unknown).astype(float)) + prior - in_moment.T @ share
    apart = np.column_stack(
        [np.bincount(offset, axis, unknown) - share.T @ np.bincount(row, axis) for axis in seen.points.T]
    )
    # in tenths of a millimetre: what was placed before stays where it is while more is seen
    found = np.round(spsolve(equations.tocsc(), apart).reshape(-1, 2), 4)
    return replace(seen, points=seen.points - found[offset])


def _prior_weight(unknown: int, seconds: np.ndarray, pauses: np.ndarray) -> csr_matrix:
    """Weighs how firmly offsets are held: near zero, and a robot's near its values of the second before that it saw.

    Args:
        unknown: number of offsets.
        seconds: (S, R) which of them are robots', one row per second.
        pauses: (S - 1,) [s] from one of these seconds to the next.
    """
    before, after = seconds[:-1], seconds[1:]
    prior = (0.5 * TREMOR / LOCALIZATION_ERROR) ** 2
    same = np.broadcast_to(ERROR_CORRELATION ** pauses[:, None], before.shape)
    tie = prior / (1.0 - same**2)  # of an offset to its correlated part of the second before
    held = np.ones(unknown)
    held[seconds[:1]] = prior
    held[after] = tie
    held[before] += tie * same**2
    pairs = csr_matrix(((-tie * same).ravel(), (before.ravel(), after.ravel())), shape=(unknown, unknown))
    return diags(held) + pairs + pairs.T
