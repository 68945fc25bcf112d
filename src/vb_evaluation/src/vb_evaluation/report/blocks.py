"""The parts of a page: sections of text, figures and tables. A table is both shown and written as CSV."""
from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Dict, List, Sequence, Tuple

from vb_evaluation.statistics import Interval


@dataclass(frozen=True)
class Text:
    """A paragraph, or with several entries a list."""

    words: Tuple[str, ...]
    kind: str = "p"  # p | caveat | list


@dataclass(frozen=True)
class Figure:
    """Images beside each other: (data URI, caption)."""

    images: Sequence[Tuple[str, str]]
    wide: bool = False


@dataclass(frozen=True)
class Grid:
    """A table.

    Attributes:
        name: of its file in tables/.
        columns: key to heading; the keys are the file's columns.
        rows: key to a text, a number, or an Interval, which becomes "estimate [low, high]" with the digits of
            `digits` and three columns in the file.
        folded: whether the page shows it only on demand.
    """

    name: str
    columns: Dict[str, str]
    rows: List[Dict[str, Any]]
    digits: Dict[str, int] = field(default_factory=dict)
    folded: bool = False
    words: str = ""

    def text(self, row: Dict[str, Any], key: str) -> str:
        """A cell as the page shows it."""
        value, digits = row.get(key, ""), self.digits.get(key, 2)
        if isinstance(value, Interval):
            return interval_text(value, digits)
        return _text(value, digits) if isinstance(value, float) else str(value)

    @staticmethod
    def is_text(row: Dict[str, Any], key: str) -> bool:
        """Whether a cell is words, which begin at the left."""
        value = row.get(key, "")
        return isinstance(value, str) and not value.lstrip("+-\N{MINUS SIGN}")[:1].isdigit()

    def plain(self, row: Dict[str, Any]) -> Dict[str, Any]:
        """A row as the file has it."""
        cells: Dict[str, Any] = {}
        for key in self.columns:
            value = row.get(key, "")
            if isinstance(value, Interval):
                parts = {"": value.estimate, "_low": value.low, "_high": value.high}
                cells.update({key + end: _cell(part) for end, part in parts.items()})
            else:
                cells[key] = _cell(value) if isinstance(value, float) else value
        return cells


@dataclass(frozen=True)
class Section:
    """A part of the page with its heading."""

    id: str
    title: str
    blocks: List[Any]


def interval_text(value: Interval, digits: int) -> str:
    """ "2.41 [2.10, 2.80]"; "2.41" without an interval, a dash where nothing is known."""
    if math.isnan(value.estimate):
        return "–"
    if math.isnan(value.low):
        return f"{_text(value.estimate, digits)} [?]"
    return f"{_text(value.estimate, digits)} [{_text(value.low, digits)}, {_text(value.high, digits)}]"


def _text(value: float, digits: int) -> str:
    return "–" if math.isnan(value) else f"{value:.{digits}f}".replace("-", "\N{MINUS SIGN}")


def _cell(value: float) -> str:
    """A number in a file: what floating point adds behind the seventh digit is left out."""
    return "" if math.isnan(value) else f"{value:.7g}"
