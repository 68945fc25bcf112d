"""The border so far, kept up to date while a person draws, within a share of one core.

It is the same extraction as at the end; what was extracted before is kept (resumable_loop.py). The paper's mode cannot
do
that: evenly chosen spots show what it makes of the drawing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Optional

import numpy as np

from vb_core.errors import CodedError
from vb_fusion.extraction import (
    BorderChain,
    ExtractionError,
    ExtractionParams,
    GrowingBorder,
    extract_border,
    extract_seed,
)
from vb_fusion.spots.collector import Collection
from vb_fusion.stroke.observations import make_observations


@dataclass(frozen=True)
class DrawnBorder:
    """Chain and seed of one interaction, as far as there are any; errors say what is missing."""

    chain: Optional[BorderChain] = None
    seed: Optional[np.ndarray] = None
    no_chain: Optional[CodedError] = None
    no_seed: Optional[CodedError] = None


MAX_PAPER_SPOTS = 4000  # which the paper's mode extracts while somebody draws


def extract_chain(collection: Collection, params: ExtractionParams) -> BorderChain:
    """Extracts the chain from all that is known of the border spots.

    Raises:
        ExtractionError
    """
    return extract_border(collection.border[:, 1:3], params, **_get_attributes(collection.border))


def extract_seed_of(collection: Collection) -> np.ndarray:
    """Extracts the seed from all seed spots; the border's spots were seen before.

    Raises:
        ExtractionError
    """
    rows = collection.seed
    return extract_seed(rows[:, 1:3], before=collection.border[:, 1:3], **_get_attributes(rows))


def _get_attributes(rows: np.ndarray) -> dict:
    stamps, confidences, cameras, mobile = rows[:, [0, 3, 4, 5]].T
    return {"stamps": stamps, "confidences": confidences, "cameras": cameras.astype(int), "mobile": mobile > 0.0}


def subsample_evenly(rows: np.ndarray, limit: int) -> np.ndarray:
    """Returns at most `limit` of the rows, evenly chosen, the first and the last among them."""
    if len(rows) <= limit:
        return rows
    return rows[np.linspace(0, len(rows) - 1, limit).astype(int)] if limit else rows[:0]


class LiveExtractor:
    """Extracts again when there are new spots, but within a share of one core.

    Args:
        params: of the extraction.
        share: of one core that live extraction may take.
    """

    def __init__(self, params: ExtractionParams, share: float) -> None:
        self._params = params
        self._share = share
        self.reset()

    def reset(self) -> None:
        """Starts again, for a new interaction."""
        self._not_before = 0.0
        self._seed_total = -1
        self._begin()
        self.candidate = DrawnBorder()

    def update(self, collection: Collection, clock: Callable[[], float], force: bool = False) -> DrawnBorder:
        """Returns the border so far; extracts it again if there are new spots and it is time.

        Args:
            clock: reads a monotonic clock [s].
            force: whether it is time, whatever the last extraction cost.
        """
        border_new = collection.border_total != self._border_total
        seed_new = collection.seed_total != self._seed_total
        if not (border_new or seed_new) or (clock() < self._not_before and not force):
            return self.candidate
        started = clock()
        chain, no_chain = self.candidate.chain, self.candidate.no_chain
        seed, no_seed = self.candidate.seed, self.candidate.no_seed
        if border_new:
            try:
                chain, no_chain = self._chain(collection), None
            except ExtractionError as error:
                chain, no_chain = None, error
            except Exception:
                # begins again: what it keeps may be half done
                self._begin()
                raise
        if seed_new:
            try:
                seed, no_seed = extract_seed_of(collection), None
            except ExtractionError as error:
                seed, no_seed = None, error
        self.candidate = DrawnBorder(chain, seed, no_chain, no_seed)
        self._border_total, self._seed_total = collection.border_total, collection.seed_total
        finished = clock()
        self._not_before = finished + (finished - started) * (1.0 / self._share - 1.0)
        return self.candidate

    def _chain(self, collection: Collection) -> BorderChain:
        rows = collection.border
        if self._params.mode == "paper":
            return extract_border(subsample_evenly(rows, MAX_PAPER_SPOTS)[:, 1:3], self._params)
        began = float(rows[:, 0].min(initial=np.inf))
        if began != self._began:
            self._begin(began)
        # the last rows are the new ones, also after a full collection was thinned
        fresh = rows[max(len(rows) - collection.border_total + max(self._border_total, 0), 0) :]
        self._drawing.add(make_observations(fresh[:, 1:3], **_get_attributes(fresh), began=began))
        return self._drawing.chain()

    def _begin(self, began: float = np.nan) -> None:
        """Forgets the drawing; the next one begins at a stamp [s]."""
        self._drawing, self._began, self._border_total = GrowingBorder(self._params), began, -1
