"""Stage 2: where the pointer really was.

Cameras that see the pointer at the same time disagree: their poses are known to centimetres only. The disagreements
are explained by one offset per stationary camera, and for a camera on a robot, whose localisation comes and goes, by
one offset per second. All offsets are found at once by weighted least squares; stationary cameras are held near zero
far more firmly than mobile ones, so that a robot that is lost does not move the border.
"""
from __future__ import annotations

import numpy as np

from vb_fusion.stroke.observations import LOCALISATION, QUANTUM, TREMBLE, Sights


def without_offsets(seen: Sights) -> Sights:
    """The sights without their cameras' offsets; an offset common to all cameras cannot be known."""
    second = np.where(seen.mobile, np.floor(seen.stamps - seen.stamps.min() + 0.0007) + 1.0, 0.0)
    keys = np.column_stack([seen.cameras, second])
    unique, group = np.unique(keys, axis=0, return_inverse=True)
    group = group.reshape(-1)
    count = len(unique)
    # neighbours in time that two cameras saw at once
    order = np.argsort(seen.stamps, kind="stable")
    pairs = np.vstack([np.column_stack([order[:-step], order[step:]]) for step in (1, 2, 3)])
    apart = seen.points[pairs[:, 0]] - seen.points[pairs[:, 1]]
    pairs, apart = (values[
        (seen.cameras[pairs[:, 0]] != seen.cameras[pairs[:, 1]])
        & (np.diff(seen.stamps[pairs], axis=1)[:, 0] <= QUANTUM)
        & (np.linalg.norm(apart, axis=1) <= 2.0 * LOCALISATION)
    ] for values in (pairs, apart))
    # each equation in units of its deviation: a difference as a hand trembles, an offset as the camera is placed
    trust = (0.5 * TREMBLE) ** -2
    equations = np.diag(np.where(unique[:, 1] > 0.0, LOCALISATION**-2, trust))
    measured = np.zeros((count, 2))
    for ours, theirs, sign in ((0, 1, 1.0), (1, 0, -1.0)):
        a, b = group[pairs[:, ours]], group[pairs[:, theirs]]
        np.add.at(equations, (a, a), trust)
        np.add.at(equations, (a, b), -trust)
        np.add.at(measured, a, sign * trust * apart)
    return seen.moved(seen.points - np.linalg.solve(equations, measured)[group])
