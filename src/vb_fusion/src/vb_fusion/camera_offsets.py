"""Stage 2 of extraction.py: the drawn line without the errors of the cameras' poses.

Cameras that see the pointer at the same time disagree, because their poses are known only to centimetres. An
observation is therefore modelled as

    the pointer's position in its time bin + its camera's offset + noise

A stationary camera has one offset. A camera on a robot has one per second, because localisation errors change as the
robot drives and turns. Two kinds of equations determine the offsets:

- All observations of a time bin have the same position. They deviate from the bin's mean only as their offsets do.
- An offset is probably small. A robot's may be larger, but changes little from one second to the next: it is a
  first-order autoregressive process. Where only the robot sees the pointer, its offset is therefore inferred from the
  moments just before and after, in which other cameras saw the pointer too.

An offset that all cameras share cannot be known. A lost robot hardly changes the stationary cameras' offsets.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import diags, identity, spmatrix
from scipy.sparse.linalg import spsolve

from vb_fusion.observations import LOCALIZATION_ERROR, TREMOR, Observations

STATIONARY_OFFSET = TREMOR  # [m] standard deviation of a stationary camera's offset
ROBOT_OFFSET = 2.0 * LOCALIZATION_ERROR  # [m] standard deviation of a robot's offset, which the other cameras decide
CORRELATION_TIME = 10.0  # [s] in which a robot's error becomes another one. It is corrected within metres


def remove_offsets(observations: Observations) -> Observations:
    """Subtracts each camera's offset from its observations, of which there is at least one."""
    bins = observations.time_bins
    # a stationary camera has one offset, that of second 0; a robot has one in each second in which it saw the pointer
    seconds = np.where(observations.mobile, 1 + bins // 10 - bins.min() // 10, 0)
    span = int(seconds.max()) + 1
    keys = observations.cameras * span + seconds
    unknowns, offset_index = np.unique(keys, return_inverse=True)
    bin_index = np.unique(bins, return_inverse=True)[1]
    # 1 in column k of an observation's row if it has offset k, or is in time bin k
    has_offset = identity(len(unknowns), format="csr")[offset_index]
    in_bin = identity(int(bin_index.max()) + 1, format="csr")[bin_index]
    # turns values of the observations into deviations from the mean of their time bin
    averaging = diags(1.0 / np.bincount(bin_index)) @ in_bin.T
    centering = identity(len(bins)) - in_bin @ averaging
    # least squares: centred offsets equal centred positions with an error of TREMOR, and offsets are probably small
    design = centering @ has_offset
    centred = centering @ observations.points
    prior = _offset_precision(unknowns // span, unknowns % span)
    precision = design.T @ design / TREMOR**2 + prior
    offsets = spsolve(precision.tocsc(), design.T @ centred / TREMOR**2).reshape(-1, 2)
    # offsets are rounded to 0.1 mm, so that positions found earlier do not change while more spots are seen
    rounded = np.round(offsets, 4)
    return replace(observations, points=observations.points - rounded[offset_index])


def _offset_precision(cameras: np.ndarray, seconds: np.ndarray) -> spmatrix:
    """Returns the inverse covariance (K, K) [1/m^2] of the offsets of these cameras (K,) in these seconds (K,)."""
    spread = np.where(seconds > 0, ROBOT_OFFSET, STATIONARY_OFFSET)
    is_same_robot = (np.diff(cameras) == 0) & (seconds[:-1] > 0)
    pauses = np.where(is_same_robot, np.diff(seconds), np.inf)
    correlation = np.exp(-pauses / CORRELATION_TIME)
    # what is new in each offset, compared with the robot's previous one, is independent of all others
    new_part = identity(len(cameras)) - diags(correlation, -1)
    new_variance = spread**2 * np.append(1.0, 1.0 - correlation**2)
    new_precision = diags(1.0 / new_variance)
    return new_part.T @ new_precision @ new_part
