"""Plans the order of each participant's runs, for the simulated study and the one with people alike."""

from __future__ import annotations

import zlib
from typing import List, Sequence, Tuple

import numpy as np


def order_runs(number: int, scenarios: Sequence[str], methods: Sequence[str], seed: int) -> List[Tuple[str, str]]:
    """Returns (scenario, method) of one participant's runs, in order: a within-subjects design (paper, Sect. 5.4).

    All scenarios are done with one method, then with the next. Methods, and the scenarios of each half, are
    counterbalanced by `counterbalance`.

    Args:
        number: the participant's, from 1; the order does not depend on other participants.
    """
    return [
        (scenario, method)
        for half, method in enumerate(counterbalance(number, methods, seed, "methods"))
        for scenario in counterbalance(number, scenarios, seed, f"scenarios {half}")
    ]


def counterbalance(number: int, things: Sequence[str], seed: int, label: str) -> List[str]:
    """Orders things for one participant: each block of as many participants as things gets a random Latin square.

    In every block each thing comes once at each position, so that positions are balanced however many take part.
    """
    block, row = divmod(number - 1, len(things))
    random = np.random.default_rng([seed, block, zlib.crc32(label.encode())])
    first, shifts = random.permutation(list(things)), random.permutation(len(things))
    return [str(thing) for thing in np.roll(first, shifts[row])]
