"""The result of an extraction."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Dict

import numpy as np

from vb_core import sentences


@dataclass(frozen=True)
class BorderChain:
    """A polygonal chain P (paper, Sect. 3).

    Attributes:
        points: (M, 2) float64 [m], M >= 2, in order; a closed chain's first point is not repeated.
        closed: polygon (True) or separating curve (False).
        code: why it is closed or open, and its values.
        length: [m] of the chain, with its closing segment if it is closed.
        gap: [m] between the ends where the drawing left them.
        left_out: (L, 2) [m] drawn spots that belong to no part of the chain.
        left_out_spots: how many these are.
        unseen: [m] the longest piece of the chain between two spots that nobody saw.
    """

    points: np.ndarray
    closed: bool
    code: str = ""
    length: float = 0.0
    gap: float = 0.0
    values: Dict[str, str] = field(default_factory=dict)
    left_out: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)), repr=False, compare=False)
    left_out_spots: int = 0
    unseen: float = 0.0

    @property
    def reason(self) -> str:
        """English sentence that says why it is closed or open."""
        return sentences.translate(self.code, self.values) if self.code else ""
