"""Plans who does what in which order; the simulated study and the one with people use the same plan."""

from __future__ import annotations

import zlib
from typing import List, Sequence, Tuple

import numpy as np


def order_runs(number: int, scenarios: Sequence[str], methods: Sequence[str], seed: int) -> List[Tuple[str, str]]:
    """Returns (scenario, method) of one participant's runs, in order: a within-subjects design (paper, Sect. 5.4).

    All scenarios are done with one method, then with the next. Each order of methods comes once in every block of
    participants, so that orders are balanced however many take part; within a block they are random, as is the order of
    scenarios for each method.

    Args:
        number: of the participant, from 1; others change nothing.
    """
    block, place = divmod(number - 1, len(methods))
    first = int(np.random.default_rng([seed, block, zlib.crc32(b"methods")]).permutation(len(methods))[place])
    random = np.random.default_rng([seed, number, zlib.crc32(b"scenarios")])
    return [
        (str(scenario), str(method))
        for method in [*methods[first:], *methods[:first]]
        for scenario in random.permutation(list(scenarios))
    ]
