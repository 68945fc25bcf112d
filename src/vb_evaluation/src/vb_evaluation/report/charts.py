"""The report's figures as SVG text, drawn without a display."""

from __future__ import annotations

import base64
import io
from typing import Any, Sequence

import matplotlib
import numpy as np
import pandas

matplotlib.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402  (the backend must be chosen before)

from vb_evaluation.report.data import Cell, known  # noqa: E402

# Okabe and Ito's, which colour-blind people can distinguish
STATE_COLORS = {"guide": "#E69F00", "border": "#56B4E9", "seed": "#009E73"}
# as in the paper: blue and red contours distinguish the methods
METHOD_COLORS = {"nrs": "#0072B2", "robot_only": "#D55E00"}
OTHER = "#CC79A7"
PUBLISHED = {"marker": "D", "ms": 7, "color": "white", "mec": "black", "mew": 1.3, "ls": "none"}
_STYLE = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "axes.axisbelow": True,
    "svg.hashsalt": "study",
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
}


def _svg(figure: Any) -> str:
    stream = io.BytesIO()
    # no date: the same study gives the same page
    figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    plt.close(figure)
    return data_uri(stream.getvalue(), "image/svg+xml")


def data_uri(content: bytes, kind: str) -> str:
    """Encodes an image to be part of the page."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


@plt.rc_context(_STYLE)
def time_bars(cells: Sequence[Cell], limit_s: float) -> str:
    """Draws the paper's bars of mean interaction time, one per method, stacked by state, and a stroke for each run's total.

    The axes of all scenarios end at `limit_s`.
    """
    means = {cell.title: [cell.runs[f"time_{state}_s"].mean() for state in STATE_COLORS] for cell in cells}
    axis = pandas.DataFrame.from_dict(means, "index", columns=list(STATE_COLORS)).plot.barh(
        stacked=True, color=STATE_COLORS, width=0.44, xlim=(0.0, limit_s), figsize=(7.2, 0.9 + 0.62 * len(cells))
    )
    for place, cell in enumerate(cells):
        totals = cell.runs.time_total_s
        axis.plot(totals, np.full(len(totals), place + 0.34), "|", ms=6, color=METHOD_COLORS.get(cell.method, OTHER))
    axis.invert_yaxis()
    axis.set_xlabel("interaction time [s]; a stroke is one run")
    return _svg(axis.figure)


@plt.rc_context(_STYLE)
def boxes(cells: Sequence[Cell], column: str, label: str, published: bool = False) -> str:
    """Boxplots of a measure by method with every value beside the box; if wanted, the paper's median Jaccard index as a diamond."""
    figure, axis = plt.subplots(figsize=(4.6, 3.3))
    values = [known(cell.runs, column) for cell in cells]
    axis.boxplot(values, widths=0.36, showfliers=False, medianprops={"color": "black", "linewidth": 2.2})
    for place, (cell, found) in enumerate(zip(cells, values), 1):
        color = METHOD_COLORS.get(cell.method, OTHER)
        axis.plot(np.full(len(found), place + 0.31), found, "o", ms=4, color=color, alpha=0.5, mew=0)
        if published and cell.published:
            axis.plot(place - 0.3, cell.published.jaccard[cell.method], **PUBLISHED)
    axis.set_xticks(range(1, len(cells) + 1))
    axis.set_xticklabels([cell.title for cell in cells])
    axis.set_ylabel(label)
    return _svg(figure)
