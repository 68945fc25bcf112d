"""Plans the order of each participant's runs, for the simulated study and the one with people alike."""

from __future__ import annotations

import zlib
from typing import List, Sequence, Tuple

import numpy as np

METHOD_SQUARES = 3  # two methods have blocks of 2, 4 or 6 participants, drawn at random (ICH E9, Sect. 2.3.2)


def order_runs(
    number: int, participants: int, scenarios: Sequence[str], methods: Sequence[str], seed: int
) -> List[Tuple[str, str]]:
    """Returns (scenario, method) of one participant's runs, in order: a within-subjects design (paper, Sect. 5.4).

    All scenarios are done with one method, then with the next. Methods, and the scenarios of each half, are
    counterbalanced by `counterbalance`, methods in such a way that earlier participants' rarely reveal the next one's.

    Args:
        number: the participant's, from 1 to `participants`.
    """
    return [
        (scenario, method)
        for half, method in enumerate(counterbalance(number, participants, methods, seed, "methods", METHOD_SQUARES))
        for scenario in counterbalance(number, participants, scenarios, seed, f"scenarios {half}")
    ]


def counterbalance(
    number: int, participants: int, items: Sequence[str], seed: int, label: str, squares: int = 1
) -> List[str]:
    """Orders items for one participant: blocks of participants get one to `squares` random Latin squares, shuffled.

    In every block each item comes equally often at each position. The last block ends with the last participant, or
    less than a square after, so that all participants are balanced as if each block were one square.
    """
    random = np.random.default_rng([seed, zlib.crc32(label.encode())])
    orders: List[List[str]] = []
    while len(orders) < number:
        squares_left = -(-(participants - len(orders)) // len(items))  # the last one may be incomplete
        firsts = [random.permutation(list(items)) for _ in range(min(random.integers(squares) + 1, squares_left))]
        block = [np.roll(first, shift) for first in firsts for shift in range(len(items))]
        orders += random.permutation(block).tolist()
    return orders[number - 1]
