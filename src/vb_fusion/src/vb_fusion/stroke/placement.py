"""Stage 2: where the pointer really was.

Cameras that see the pointer at the same time disagree: their poses are known to centimetres only. The disagreements
are explained by one offset per stationary camera, and for a camera on a robot, whose localisation comes and goes, by
one offset per second. All offsets are found at once by weighted least squares; stationary cameras are held near zero
far more firmly than mobile ones, so that a robot that is lost does not move the border.
"""
from __future__ import annotations

from itertools import combinations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

from vb_fusion.stroke.observations import LOCALISATION, TREMBLE, Sights, moments


def without_offsets(seen: Sights) -> Sights:
    """The sights without their cameras' offsets; an offset common to all cameras cannot be known."""
    cameras, camera = np.unique(seen.cameras, return_inverse=True)
    second = np.where(seen.mobile, moments(seen.stamps) // 10, -1)
    second -= second.min()
    unknown, group = np.unique(second * len(cameras) + camera, return_inverse=True)
    moment = np.unique(moments(seen.stamps), return_inverse=True)[1]
    # what each camera saw in each moment
    shape = (int(moment.max()) + 1, len(cameras))
    place = moment * shape[1] + camera
    total = np.bincount(place, seen.weights, shape[0] * shape[1])
    with np.errstate(invalid="ignore"):
        mean = np.column_stack([np.bincount(place, seen.weights * axis, len(total)) / total for axis in seen.points.T])
    mean = mean.reshape(*shape, 2)
    of = np.zeros(len(total), dtype=np.int64)
    of[place] = group
    of = of.reshape(shape)
    # each equation in units of its deviation: a difference as a hand trembles, an offset as the camera is placed
    trust = (0.5 * TREMBLE) ** -2
    moves = np.zeros(len(unknown), dtype=bool)
    moves[group] = seen.mobile
    every = np.arange(len(unknown))
    rows, columns, values = [every], [every], [np.where(moves, LOCALISATION**-2, trust)]
    measured = np.zeros((len(unknown), 2))
    for one, other in combinations(range(len(cameras)), 2):
        apart = mean[:, one] - mean[:, other]
        both = np.linalg.norm(apart, axis=1) <= 2.0 * LOCALISATION  # false where one of them saw nothing
        ours, theirs, apart = of[both, one], of[both, other], trust * apart[both]
        rows += [ours, theirs, ours, theirs]
        columns += [ours, theirs, theirs, ours]
        values += [np.full(len(ours), sign * trust) for sign in (1.0, 1.0, -1.0, -1.0)]
        for axis in (0, 1):
            measured[:, axis] += np.bincount(ours, apart[:, axis], len(unknown))
            measured[:, axis] -= np.bincount(theirs, apart[:, axis], len(unknown))
    places = tuple(np.concatenate(indices) for indices in (rows, columns))
    equations = coo_matrix((np.concatenate(values), places), shape=(len(unknown), len(unknown))).tocsc()
    # in whole millimetres: what was placed before stays where it is while more is seen
    offsets = np.round(spsolve(equations, measured).reshape(-1, 2), 3)
    return seen.moved(seen.points - offsets[group])
