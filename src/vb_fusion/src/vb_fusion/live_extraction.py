"""Keeps the border up to date while a person draws, using at most a share of one core.

Each update runs the final extraction on all spots so far, which takes 0.1 s for five minutes of drawing.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from typing import Callable, Optional, Sequence

import numpy as np

from vb_core.errors import CodedError
from vb_fusion.collector import Collection
from vb_fusion.extraction import BorderChain, ExtractionParams, extract_border
from vb_fusion.seed import Dwell, choose_seed, find_dwells

MAX_SHOWN = 300  # points in a message: enough to see the drawing, cheap to display


@dataclass(frozen=True)
class DrawnBorder:
    """The chain and the seed of one interaction, or for each the error that says why it is missing."""

    chain: Optional[BorderChain] = None
    dwells: Sequence[Dwell] = ()
    chain_error: Optional[CodedError] = None
    seed_error: Optional[CodedError] = None

    @property
    def seed(self) -> Optional[np.ndarray]:
        """(2,) [m] the dwell that `choose_seed` takes for the seed point."""
        return choose_seed(self.dwells).point if self.dwells else None

    @property
    def other_dwell(self) -> Optional[Dwell]:
        """Another place where the pointer dwelt, longer or later, which may have been meant as the seed."""
        if not self.dwells:
            return None
        seed, after, other = choose_seed(self.dwells), False, None
        for dwell in self.dwells:
            if dwell is seed:
                after = True
            elif not dwell.known and (after or dwell.seconds > seed.seconds):
                other = dwell
        return other


def extract_chain(collection: Collection, params: ExtractionParams) -> BorderChain:
    """Extracts the chain from the border spots and all their attributes.

    Raises:
        CodedError
    """
    return extract_border(collection.border[:, 1:3], params, **_get_attributes(collection.border))


def _get_attributes(rows: np.ndarray) -> dict:
    stamps, confidences, cameras, mobile = rows[:, [0, 3, 4, 5]].T
    return {"stamps": stamps, "confidences": confidences, "cameras": cameras.astype(int), "mobile": mobile > 0.0}


def subsample_evenly(rows: np.ndarray, limit: int = MAX_SHOWN) -> np.ndarray:
    """Returns at most `limit` of the rows, evenly spaced, including the first and the last."""
    return rows if len(rows) <= limit else rows[np.linspace(0, len(rows) - 1, limit).astype(int)]


class LiveExtractor:
    """Repeats the extraction when there are new spots, using at most a share of one core.

    Args:
        params: of the extraction.
        share: of one core that live extraction may take.
    """

    def __init__(self, params: ExtractionParams, share: float) -> None:
        self._params = params
        self._share = share
        self._lock = threading.Lock()
        self.reset()

    def reset(self) -> None:
        """Forgets everything, for a new interaction."""
        with self._lock:
            self._not_before = 0.0
            self._border_total = self._seed_total = -1
            self.drawn = DrawnBorder()

    def update(self, collection: Collection, clock: Callable[[], float], force: bool = False) -> DrawnBorder:
        """Returns the border so far, extracted again if there are new spots and it is due. Thread safe.

        Args:
            clock: reads a monotonic clock [s].
            force: whether it is due regardless of what the last extraction cost.
        """
        with self._lock:
            border_new = collection.border_total != self._border_total
            seed_new = collection.seed_total != self._seed_total
            if (border_new or seed_new) and (force or clock() >= self._not_before):
                started = clock()
                try:
                    self._extract(collection, border_new, seed_new)
                finally:  # a failed attempt costs as much
                    finished = clock()
                    self._not_before = finished + (finished - started) * (1.0 / self._share - 1.0)
            return self.drawn

    def _extract(self, collection: Collection, border_new: bool, seed_new: bool) -> None:
        changes = {}
        if border_new:
            try:
                changes.update(chain=extract_chain(collection, self._params), chain_error=None)
            except CodedError as error:
                changes.update(chain=None, chain_error=error)
        if seed_new:
            try:
                rows, before = collection.seed, collection.border[:, 1:3]
                dwells = find_dwells(rows[:, 1:3], before=before, **_get_attributes(rows))
                changes.update(dwells=dwells, seed_error=None)
            except CodedError as error:
                changes.update(dwells=(), seed_error=error)
        self.drawn = replace(self.drawn, **changes)
        self._border_total, self._seed_total = collection.border_total, collection.seed_total
