"""What an extraction gives, and the errors it refuses with."""
from __future__ import annotations

from dataclasses import dataclass, field
from typing import Dict

import numpy as np

from vb_core.errors import CodedError


class ExtractionError(CodedError):
    """No chain or no seed can be extracted.

    Codes: "no_spots", "too_few_spots", "no_line", "bad_points", "no_seed".
    """


@dataclass(frozen=True)
class BorderChain:
    """A polygonal chain P (paper, Sect. 3).

    Attributes:
        points: (M, 2) float64 [m], M >= 2, in order; a closed chain's first point is not repeated.
        closed: polygon (True) or separating curve (False).
        reason: one sentence that says why it is closed or open.
        length: [m] of the chain, with its closing segment if it is closed.
        gap: [m] between the ends where the drawing left them.
        stages: the point sets between the stages, for figures: "cluster" (K, 2) and "thinned" (T, 2) [m].
    """

    points: np.ndarray
    closed: bool
    reason: str = ""
    length: float = 0.0
    gap: float = 0.0
    stages: Dict[str, np.ndarray] = field(default_factory=dict, repr=False, compare=False)
