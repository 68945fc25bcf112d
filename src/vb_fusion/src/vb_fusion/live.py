"""The border so far, kept up to date while somebody draws, within a share of one core."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Optional

import numpy as np

from vb_fusion.collector import Collection
from vb_fusion.extraction import BorderChain, ExtractionError, ExtractionParams, extract_border, extract_seed


@dataclass(frozen=True)
class Candidate:
    """Chain and seed of one interaction, as far as there are any; code and message say what is missing."""

    chain: Optional[BorderChain]
    seed: Optional[np.ndarray]
    chain_code: str = "ok"
    chain_message: str = ""
    seed_code: str = "ok"
    seed_message: str = ""


LIVE_SPOTS = 4000  # the live chain is made of at most this many, evenly chosen


def extract_chain(
    collection: Collection, params: ExtractionParams, limit: Optional[int] = None
) -> BorderChain:
    """The chain of the border spots, with their stamps, cameras and confidences.

    Args:
        limit: the most spots to use, evenly chosen; None for all.

    Raises:
        ExtractionError
    """
    rows = evenly(collection.border, limit) if limit else collection.border
    return extract_border(rows[:, 1:3], params, stamps=rows[:, 0], cameras=rows[:, 4], confidences=rows[:, 3])


def evenly(rows: np.ndarray, limit: int) -> np.ndarray:
    """At most `limit` of the rows, evenly chosen, the first and the last among them."""
    if len(rows) <= limit:
        return rows
    return rows[np.linspace(0, len(rows) - 1, limit).astype(int)] if limit else rows[:0]


def extract_seed_of(collection: Collection) -> np.ndarray:
    """The seed of all seed spots, with the border's as what was seen before.

    Raises:
        ExtractionError
    """
    rows, before = collection.seed, collection.border[:, 1:3]
    return extract_seed(rows[:, 1:3], stamps=rows[:, 0], cameras=rows[:, 4], confidences=rows[:, 3], before=before)


class LiveCandidate:
    """Extracts again when there is something new, and seldom enough to stay within a share of one core.

    Args:
        params: of the extraction.
        share: of one core that live extraction may take.
    """

    def __init__(self, params: ExtractionParams, share: float) -> None:
        self._params = params
        self._share = share
        self._not_before = 0.0
        self._border_total = -1
        self._seed_total = -1
        self.candidate = Candidate(None, None)

    def reset(self) -> None:
        """Starts afresh, for a new interaction."""
        self._not_before = 0.0
        self._border_total = self._seed_total = -1
        self.candidate = Candidate(None, None)

    def update(self, collection: Collection, clock: Callable[[], float], force: bool = False) -> Candidate:
        """The candidate; a new one if there are new spots and it is time.

        Args:
            clock: reads a monotonic clock [s].
            force: it is time, whatever the last extraction cost.
        """
        border_new = collection.border_total != self._border_total
        seed_new = collection.seed_total != self._seed_total
        if not (border_new or seed_new) or (clock() < self._not_before and not force):
            return self.candidate
        started = clock()
        old = self.candidate
        chain, chain_code, chain_message = old.chain, old.chain_code, old.chain_message
        seed, seed_code, seed_message = old.seed, old.seed_code, old.seed_message
        if border_new:
            try:
                chain, chain_code = extract_chain(collection, self._params, LIVE_SPOTS), "ok"
                chain_message = chain.reason
            except ExtractionError as error:
                chain, chain_code, chain_message = None, error.code, error.message
        if seed_new:
            try:
                seed, seed_code, seed_message = extract_seed_of(collection), "ok", ""
            except ExtractionError as error:
                seed, seed_code, seed_message = None, error.code, error.message
        self.candidate = Candidate(chain, seed, chain_code, chain_message, seed_code, seed_message)
        self._border_total, self._seed_total = collection.border_total, collection.seed_total
        finished = clock()
        self._not_before = finished + (finished - started) * (1.0 / self._share - 1.0)
        return self.candidate
