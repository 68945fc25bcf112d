"""The report's figures as SVG text, drawn without a display."""

from __future__ import annotations

import base64
import io
from typing import Any, Sequence

import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402  (the backend must be chosen before)

from vb_evaluation.report.data import Cell, known  # noqa: E402

# Okabe and Ito's, which colour-blind people can distinguish
BLUE, ORANGE, GREEN, VERMILION, GRAY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#666666"
SKY, PURPLE = "#56B4E9", "#CC79A7"
STATE_COLORS = {"guide": ORANGE, "border": SKY, "seed": GREEN}
# as in the paper: blue and red contours distinguish the methods
METHOD_COLORS = {"nrs": BLUE, "robot_only": VERMILION}
SERIES = (GREEN, PURPLE, ORANGE, GRAY)
WIDTH_IN, PANEL_IN = 7.2, 4.6
PUBLISHED = {"marker": "D", "ms": 7, "color": "white", "mec": "black", "mew": 1.3, "ls": "none"}
_STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#555555",
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "axes.axisbelow": True,
    "svg.fonttype": "path",
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


def color_of(method: str, index: int) -> str:
    """Returns a method's colour, the same everywhere in the report."""
    return METHOD_COLORS.get(method, SERIES[index % len(SERIES)])


def _columns(axis: Any, titles: Sequence[str], label: str) -> None:
    axis.set_xticks(range(len(titles)))
    axis.set_xticklabels(titles)
    axis.grid(axis="x", visible=False)
    axis.set_ylabel(label)


@plt.rc_context(_STYLE)
def time_bars(cells: Sequence[Cell], limit_s: float) -> str:
    """Draws the paper's bars of interaction time, one per method, stacked by state; all scenarios' axes end at `limit_s`."""
    figure, axis = plt.subplots(figsize=(WIDTH_IN, 0.75 + 0.62 * len(cells)))
    for place, cell in enumerate(cells):
        left, color = 0.0, color_of(cell.method, place)
        for state, state_color in STATE_COLORS.items():
            seconds = np.nan_to_num(cell.runs[f"time_{state}_s"].mean())
            axis.barh(place, seconds, left=left, height=0.44, color=state_color, edgecolor="white", linewidth=0.5)
            if seconds > 0.05 * limit_s:
                axis.text(left + seconds / 2, place, f"{seconds:.1f}", ha="center", va="center", fontsize=9)
            left += seconds
        axis.barh(place, left, height=0.44, fill=False, edgecolor=color, linewidth=2)
        axis.plot(
            cell.runs.time_total_s, np.full(len(cell.runs), place + 0.34), "|", ms=6, color=color, alpha=0.8, mew=1.2
        )
    axis.set_yticks(range(len(cells)))
    axis.set_yticklabels([cell.title for cell in cells])
    axis.set_ylim(len(cells) - 0.5, -0.5)
    axis.set_xlabel("interaction time [s]; a stroke is one run")
    axis.set_xlim(0.0, limit_s)
    axis.grid(axis="y", visible=False)
    return _svg(figure)


@plt.rc_context(_STYLE)
def boxes(cells: Sequence[Cell], column: str, label: str, published: bool = False) -> str:
    """Boxplots of a measure by method with every value beside the box; if wanted, the paper's median Jaccard index as a diamond."""
    figure, axis = plt.subplots(figsize=(PANEL_IN, 3.3))
    for place, cell in enumerate(cells):
        color, values = color_of(cell.method, place), known(cell.runs, column)
        if len(values):
            line = {"color": color}
            axis.boxplot(
                [values],
                positions=[place],
                widths=0.36,
                showfliers=False,
                patch_artist=True,
                whiskerprops=line,
                capprops=line,
                boxprops={"facecolor": matplotlib.colors.to_rgba(color, 0.25), "edgecolor": color},
                medianprops={"color": color, "linewidth": 2.2},
            )
            spread = np.linspace(-0.06, 0.06, len(values)) if len(values) > 1 else np.zeros(1)
            axis.plot(place + 0.31 + spread, values, "o", ms=3, color=color, alpha=0.7, mew=0)
        if published and cell.published:
            axis.plot(place - 0.3, cell.published.jaccard[cell.method], **PUBLISHED)
    _columns(axis, [cell.title for cell in cells], label)
    axis.set_xlim(-0.6, len(cells) - 0.4)
    axis.margins(y=0.08)
    return _svg(figure)
