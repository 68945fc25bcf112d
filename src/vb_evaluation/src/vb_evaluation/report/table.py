"""A report is a list of tables. Each is Markdown, from which the page is made, and a CSV file."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Dict, List, Mapping

import pandas

from vb_evaluation.statistics import Interval, format_number


@dataclass(frozen=True)
class Table:
    """A table of results.

    Attributes:
        name: name of its file in tables/, and its place on the page.
        title: heading of its section.
        text: what the figures mean; paragraphs above the table.
        rows: by heading a text, a number, or an Interval, which is shown as "estimate [low, high]" and has three
            columns in the file. A table without rows is left out.
        digits: by heading; 2 where it names none.
    """

    name: str
    title: str
    text: str
    rows: List[Dict[str, Any]]
    digits: Mapping[str, int] = field(default_factory=dict)

    def markdown(self) -> str:
        """Writes the text and the table in Markdown."""
        headings = list(dict.fromkeys(heading for row in self.rows for heading in row))
        cells = [[self._cell(row, heading) for heading in headings] for row in self.rows]
        rules = []
        for cell in cells[0]:
            is_number = re.match(r"[–−+<.\d]", cell)
            rules.append("---:" if is_number else "---")  # at the right, or at the left
        lines = [f"| {' | '.join(line)} |" for line in (headings, rules, *cells)]
        return "\n".join([self.text, "", *lines]).lstrip()

    def _cell(self, row: Mapping[str, Any], heading: str) -> str:
        value = row.get(heading, "")
        digits = self.digits.get(heading, 2)
        if isinstance(value, Interval):
            return value.text(digits)
        if isinstance(value, float):
            return format_number(value, digits)
        return str(value).replace("|", r"\|").replace("\n", " ")

    def write_csv(self, path: Path) -> None:
        """Writes the rows with all their digits that are no floating-point noise."""
        rows = []
        for row in self.rows:
            cells: Dict[str, Any] = {}
            for heading, value in row.items():
                if isinstance(value, Interval):
                    cells[heading] = value.estimate
                    cells[f"{heading} low"] = value.low
                    cells[f"{heading} high"] = value.high
                else:
                    cells[heading] = value
            rows.append(cells)
        pandas.DataFrame(rows).to_csv(path, index=False, float_format="%.7g", lineterminator="\n")
