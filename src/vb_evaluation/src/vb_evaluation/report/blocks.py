"""Blocks of a report's section: paragraphs, figures and tables. A table is both shown and written as CSV."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Dict, List, Sequence, Tuple, Union

from vb_evaluation.statistics import Interval, format_number


@dataclass(frozen=True)
class Figure:
    """Images beside each other: (data URI, caption)."""

    images: Sequence[Tuple[str, str]]


# headings other than the capitalised key
HEADINGS = {
    "n": "Pairs",
    "nrs": "Network robot system",
    "p": "exact p",
    "holm": "p (Holm)",
    "z": "Z",
    "r": "r",
    "rank_biserial": "rank-biserial",
    "speedup": "Speed-up",
}


def column_headings(*keys: str, **headings: str) -> Dict[str, str]:
    """Returns a table's columns with their headings: those given here, those of HEADINGS, or the capitalised key."""
    titles = {**HEADINGS, **headings}
    return {key: titles.get(key, key.replace("_", " ").capitalize()) for key in keys}


@dataclass(frozen=True)
class Table:
    """A table of results. The page shows it, and a CSV file has its rows.

    Attributes:
        name: name of the table's file in tables/.
        columns: key to heading; the keys are the file's columns.
        rows: key to a text, a number, or an Interval, which becomes "estimate [low, high]" with the digits of
            `digits` and three columns in the file.
        explanation: what the figures mean, a paragraph below the table.
    """

    name: str
    columns: Dict[str, str]
    rows: List[Dict[str, Any]]
    digits: Dict[str, int] = field(default_factory=dict)
    explanation: str = ""

    def text(self, row: Dict[str, Any], key: str) -> str:
        """Writes a cell as the page shows it."""
        value = row.get(key, "")
        digits = self.digits.get(key, 2)
        if isinstance(value, Interval):
            return value.text(digits)
        return format_number(value, digits) if isinstance(value, float) else str(value)

    def markdown(self) -> str:
        """Writes the table for a Markdown page."""
        lines = [list(self.columns.values()), ["---"] * len(self.columns)]
        lines += [[self.text(row, key) for key in self.columns] for row in self.rows]
        return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)

    @staticmethod
    def is_text(row: Dict[str, Any], key: str) -> bool:
        """Returns whether a cell holds words, which are left-aligned."""
        value = row.get(key, "")
        return isinstance(value, str) and not value.lstrip("+-\N{MINUS SIGN}")[:1].isdigit()

    def csv_row(self, row: Dict[str, Any]) -> Dict[str, Any]:
        """Returns a row as it is written to the file."""
        cells: Dict[str, Any] = {}
        for key in self.columns:
            value = row.get(key, "")
            if isinstance(value, Interval):
                cells.update({key: value.estimate, f"{key}_low": value.low, f"{key}_high": value.high})
            else:
                cells[key] = value
        numbers = {key: cell for key, cell in cells.items() if isinstance(cell, float)}
        # floating-point noise beyond the seventh digit is left out
        cells.update({key: f"{number:.7g}" if math.isfinite(number) else "" for key, number in numbers.items()})
        return cells


Block = Union[str, Figure, Table]  # a paragraph, images, or a table
