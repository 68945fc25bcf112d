"""The border so far, kept up to date while somebody draws, within a share of one core."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

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


def extract_chain(collection: Collection, params: ExtractionParams) -> BorderChain:
    """The chain of all border spots, with their stamps, cameras and confidences.

    Raises:
        ExtractionError
    """
    rows = collection.border
    return extract_border(rows[:, 1:3], params, stamps=rows[:, 0], cameras=rows[:, 4], confidences=rows[:, 3])


def extract_seed_of(collection: Collection) -> np.ndarray:
    """The seed of all seed spots.

    Raises:
        ExtractionError
    """
    rows = collection.seed
    return extract_seed(rows[:, 1:3], stamps=rows[:, 0], cameras=rows[:, 4], confidences=rows[:, 3])


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

    def update(self, collection: Collection, now: float, clock) -> Candidate:
        """The candidate; a new one if there are new spots and it is time.

        Args:
            now: [s] of a monotonic clock.
            clock: callable that reads that clock, to measure what an extraction costs.
        """
        border_new = collection.border_total != self._border_total
        seed_new = collection.seed_total != self._seed_total
        if not (border_new or seed_new) or now < self._not_before:
            return self.candidate
        started = clock()
        old = self.candidate
        chain, chain_code, chain_message = old.chain, old.chain_code, old.chain_message
        seed, seed_code, seed_message = old.seed, old.seed_code, old.seed_message
        if border_new:
            try:
                chain, chain_code = extract_chain(collection, self._params), "ok"
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
        cost = clock() - started
        self._not_before = now + cost / self._share
        return self.candidate
